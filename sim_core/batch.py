"""Many rollouts of one rig side by side: on threads, one a core, each with numbers of its own.

What a rollout gives does not depend on the others, on their order or on the number of threads, to the bit.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sim_core.errors import ConfigError, ConvergenceError
from sim_core.rigs import Rig, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.kept import KeptScenes
from sim_core.simulate import Trace, simulate
from sim_core.threads import worker_threads

__all__ = ["Variant", "poses_of_each", "rollouts"]

Variant = Mapping[str, float]
"""Values of parameters by their names, as :func:`sim_core.rigs.with_parameters` takes them."""


def rollouts(
    rig: Rig,
    variants: Sequence[Variant],
    poses: Mapping[str, PoseTrajectory] | Sequence[Mapping[str, PoseTrajectory]],
    times: np.ndarray,
    *,
    refine: int = 1,
    workers: int | None = None,
    on_done: Callable[[int, int], None] | None = None,
) -> list[Trace | ConvergenceError]:
    """Roll out the ``variants`` of a rig from rest along ``poses`` of its end effectors, of all or of each, at
    ``times`` [s] ``(t,)``: in their order the trace of each, or why there is none, which does not end the others.

    ``refine``: factor on cells in each direction; ``workers``: threads (default: one a core). ``on_done(done, total)``
    is called as each arrives in that order. Raises ``ConfigError`` for variants and poses that are not as many, and
    for numbers that the rig cannot have.
    """
    each, scenes = poses_of_each(variants, poses), threading.local()

    def rollout(variant: Variant, tracks: Mapping[str, PoseTrajectory]) -> Trace | ConvergenceError:
        if not hasattr(scenes, "own"):
            scenes.own = KeptScenes()
        kept: KeptScenes = scenes.own
        try:
            return simulate(kept.of(with_parameters(rig, variant), refine), tracks, times)
        except ConvergenceError as error:
            return error

    found: list[Trace | ConvergenceError] = []
    with worker_threads(min(workers or os.cpu_count() or 1, max(1, len(variants)))) as threads:
        for future in [threads.submit(rollout, *given) for given in zip(variants, each, strict=True)]:
            found.append(future.result())
            if on_done is not None:
                on_done(len(found), len(variants))
    return found


def poses_of_each(
    variants: Sequence[Variant], poses: Mapping[str, PoseTrajectory] | Sequence[Mapping[str, PoseTrajectory]]
) -> list[Mapping[str, PoseTrajectory]]:
    """The poses along which each of the variants is rolled out. Raises ``ConfigError`` where they are not as many."""
    each = [poses] * len(variants) if isinstance(poses, Mapping) else list(poses)
    if len(each) != len(variants):
        raise ConfigError(
            f"There are {len(variants)} variants and poses for {len(each)} of them.",
            "Give poses for all of them, or one mapping of poses for all.",
        )
    return each
