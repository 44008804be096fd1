"""Recordings of the same bodies in their order: what a sheet or a gel keeps of one is there when the next begins.

Recordings that are given together are taken to show the same bodies, in the order of their stamps. Nothing of this
matters but for laws with internal variables that last (:mod:`sim_core.permanent_state`). The motion of the earlier
recordings, and of a recording before the part of it that is looked at, is then simulated first, on the steps of the
rig. What a recording has for itself (``--per-bag``) is taken to hold before it, too. Where any of these overlap in time
they show different bodies, or were simulated, and none of them counts.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from sim_core.effects import effect_by_name, split_key
from sim_core.effects.hooks import ClockMap, ReadingMap
from sim_core.gradients import Direction, simulate_tangent
from sim_core.gradients.amendments import Amendment
from sim_core.gradients.frozen_path import let_remember
from sim_core.permanent_state import PermanentState, lasting
from sim_core.rigs import Rig
from sim_core.scene import Scene
from sim_core.simulate import simulate, step_times
from sysid.observations.observations import Run
from sysid.settings.model import MODEL


def earlier_motion(whole: Iterable[Run], run: Run) -> tuple[Run, ...]:
    """Motion, without readings, of the ``whole`` recordings that came before a run, in their order, and of its own
    recording before it where it is a part of one."""
    span = run.span_ns
    if span is None:
        return ()
    dated = [(r.span_ns, r) for r in whole if r.span_ns is not None]
    others = sorted((d for d in dated if d[1].path != run.path and d[0][0] < span[1]), key=lambda d: d[0][0])
    ends = [0, *(end for (_, end), _ in others)]
    begins = [*(begin for (begin, _), _ in others), span[0]]
    if any(begin < end for begin, end in zip(begins, ends, strict=True)):
        return ()
    before = [r for _, r in others]
    if run.since > 0.0:
        before += [replace(r, end=run.since) for _, r in dated if r.path == run.path]
    return tuple(replace(r, measured=(), firsts={}, notes=(), counted=(), changes={}) for r in before)


class LeftBefore:
    """What the recordings before a run have left in the bodies of a rig, kept from one evaluation to the next."""

    def __init__(self) -> None:
        self._known: OrderedDict[object, PermanentState | None] = OrderedDict()

    def of(self, scene: Scene, run: Run, dt: float, refine: int) -> PermanentState | None:
        """By the numbers that a ``scene`` has, simulated with steps of ``dt`` [s]; None where nothing lasts, or nothing
        came before. ``refine``: of the scene, to tell it from others."""
        if not run.earlier or not lasting(scene):
            return None

        def rollout(before: Run, left: PermanentState | None) -> PermanentState | None:
            return simulate(scene, before.poses, step_times(0.0, before.end, dt), left=left).left

        with _mechanics_alone(scene):
            return self._in_turn(run, (_numbers(scene.given), refine, dt), rollout)

    def along(
        self, scene: Scene, run: Run, dt: float, refine: int, along: Sequence[Direction]
    ) -> PermanentState | None:
        """The same with derivatives along directions."""
        if not run.earlier or not lasting(scene):
            return None
        ways = [replace(d, low=_mechanics(d.low), high=_mechanics(d.high)) for d in along]
        # A delay of a clock moves nothing, and what is kept serves recordings with delays of their own.
        moving = [k for k, d in enumerate(ways) if _numbers(d.low) != _numbers(d.high)]
        common = [ways[k] for k in moving]
        ends = tuple((d.name, d.width, _numbers(d.low), _numbers(d.high)) for d in common)

        def rollout(before: Run, left: PermanentState | None) -> PermanentState | None:
            times = step_times(0.0, before.end, dt)
            return simulate_tangent(scene, before.poses, times, common, left=left)[0].left

        with _mechanics_alone(scene):
            left = self._in_turn(run, (_numbers(scene.given), refine, dt, ends), rollout)
        return None if left is None else left.along(np.array(moving, dtype=int), len(along))

    def _in_turn(
        self, run: Run, key: object, rollout: Callable[[Run, PermanentState | None], PermanentState | None]
    ) -> PermanentState | None:
        """The recordings before a run, each after the one before it; those that are known are not simulated again."""
        left = None
        for before in run.earlier:
            key = (key, before.path, before.since, before.end)
            if key not in self._known:
                if len(self._known) >= MODEL.kept_states:
                    self._known.popitem(last=False)
                self._known[key] = rollout(before, left)
            self._known.move_to_end(key)
            left = self._known[key]
        return left


def frozen_before(scene: Scene, run: Run, dt: float, amendments: Sequence[Amendment]) -> None:
    """Let laws that last begin a run with what they leave along the frozen paths of the recordings before, of steps of
    ``dt`` [s]. On the path of a body that never yielded, a residual curvature above the yield curvature yields in
    reverse."""
    last = [a for a in amendments if a.lasting]
    if not run.earlier or not last:
        return
    left = None
    with _mechanics_alone(scene):
        for before in run.earlier:
            left = let_remember(scene, before.poses, step_times(0.0, before.end, dt), last, left).left


def _mechanics(rig: Rig) -> Rig:
    """The rig without what sensors and clocks alone make of a motion."""
    kept = {
        k: v for k, v in rig.effects.items() if not isinstance(effect_by_name(split_key(k)[0]), ReadingMap | ClockMap)
    }
    return rig if len(kept) == len(rig.effects) else rig.model_copy(update={"effects": kept})


@contextmanager
def _mechanics_alone(scene: Scene) -> Iterator[None]:
    """The scene with the mechanics of its rig, then as it was, also where a rollout fails."""
    rig = scene.given
    scene.use(_mechanics(rig))
    try:
        yield
    finally:
        scene.use(rig)


def _numbers(rig: Rig) -> str:
    """All that bodies move by."""
    return repr(rig.model_dump(exclude={"sensors", "cameras"}))
