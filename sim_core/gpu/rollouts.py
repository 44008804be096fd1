"""Many rollouts of one rig on a GPU, each with numbers of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.batch import Variant
from sim_core.core.record import contacts_of
from sim_core.gpu.engine import Device, Gpu, Outcome, Run
from sim_core.gpu.variants import problem_of
from sim_core.rigs import Rig, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.sensing.instants import Instants, read_all
from sim_core.sensing.observe import Observer
from sim_core.solve.report import NewtonSettings

__all__ = ["Rollouts", "rollouts"]


@dataclass(frozen=True)
class Rollouts:
    """What ``n`` rollouts came to.

    ``times``: of the steps [s] ``(t,)``. ``made``: steps that each made ``(n,)``, -1 where it found no rest at its
    start; ``converged``: whether these are all ``(n,)``. ``iterations``, ``factorisations``: of each step
    ``(n, t - 1)``. ``positions``: of the nodes at the end of the last step that was made [m] ``(n, nodes, 3)``.
    ``outputs``: readings by channel at all times ``(n, t, ...)``, nan from the first step on that was not made; empty
    where none were asked for."""

    times: np.ndarray
    made: np.ndarray
    converged: np.ndarray
    iterations: np.ndarray
    factorisations: np.ndarray
    positions: np.ndarray
    outputs: dict[str, np.ndarray]


def rollouts(
    rig: Rig,
    variants: Sequence[Variant],
    poses: Mapping[str, PoseTrajectory] | Sequence[Mapping[str, PoseTrajectory]],
    times: np.ndarray,
    *,
    readings: bool = False,
    settings: NewtonSettings | None = None,
    device: Device | None = None,
    on_variant: Callable[[int, int], None] | None = None,
) -> Rollouts:
    """Roll out the ``variants`` of a rig from rest along ``poses`` of its end effectors, of all or of each, at
    ``times`` [s] ``(t,)``: one thread block a rollout, all steps in one launch.

    ``readings``: of all sensors and cameras at all times. ``device``: by default the first GPU. ``on_variant(done,
    total)`` is called as variants are laid out. A rollout that fails does not end the others, and what one comes to
    does not depend on the others. Raises ``ConfigError`` where there is no GPU, or where the rig is not for one.
    """
    device = device or Gpu()
    problem = problem_of(rig, variants, poses, times, settings, on_variant)
    count = len(problem.times) - 1
    found = Run(problem, device).steps(0, count, every=1 if readings else None)
    outputs = _read(rig, variants, problem.places, found) if readings else {}
    return Rollouts(
        problem.times,
        found.made,
        ~found.failed,
        found.counts["iterations"],
        found.counts["factorisations"],
        found.last,
        outputs,
    )


def _read(rig: Rig, variants: Sequence[Variant], places: np.ndarray, found: Outcome) -> dict[str, np.ndarray]:
    """Readings of all rollouts, of each at the instants that it came to."""
    assert found.x is not None and found.force is not None and found.moment is not None
    scene, outputs = build_scene(rig), dict[str, np.ndarray]()
    nodes = [term.body_node for term in contacts_of(scene)]
    for k, variant in enumerate(variants):
        scene.use(with_parameters(rig, variant))
        there, came = places[min(k, len(places) - 1)], slice(0, found.made[k] + 1)
        if not found.x[k, came].size:
            continue
        mounts = {
            name: (there[came, m, :3], there[came, m, 3:].reshape(-1, 3, 3)) for m, name in enumerate(scene.start)
        }
        moments = [(node, found.moment[k, came, c]) for c, node in enumerate(nodes)]
        at = Instants(mounts, found.x[k, came], found.force[k, came], moments)
        for channel, values in read_all(Observer(scene), scene.rig, at).items():
            table = outputs.setdefault(channel, np.full((len(variants), len(there), *values.shape[1:]), np.nan))
            table[k, came] = values
    return outputs
