"""A rollout that can be gone through backwards: the steps that were made, kept or made again from checkpoints.

The times of a rollout are cut into about sqrt(T) segments. Where one begins the state is kept, and the search for
contact starts afresh, so that a segment made again is the same to the last bit. Of the steps are kept, within a bound
on memory:

* the states, as long as those of a whole segment find room; other segments are made again when their turn comes,
* how they are linearised (:class:`sim_core.gradients.step.LinearStep`, and the readings' derivatives), as long as
  there is room for the states of all that is still to come; other steps are linearised when their turn comes.

A segment that is made again is linearised as it is made. The least memory is that of O(sqrt(T)) steps. The way to the
first equilibrium is linearised with the rest, where there is room.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sim_core.commands import driven_frames
from sim_core.errors import ConfigError
from sim_core.gradients.initial_equilibrium import linearised, with_inertia
from sim_core.gradients.step import LinearStep
from sim_core.gradients.step_record import Made, size_of_state
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Frame, Scene
from sim_core.sensing.observe import Sensed, frame_of
from sim_core.simulate import Simulation, Trace
from sim_core.solve.hessian_store import Keeper
from sim_core.solve.step import NewtonSettings, State, StepReport

MEMORY_MB = 1024.0
"""Bound on what the steps that are kept may take, where none is given."""


@dataclass
class Interval:
    """All that was done between two times of the rollout. ``middles``: frames halfway between two others, in the order
    in which they were made: (middle, start, end). ``sensed``: derivatives of the readings at its end, if kept."""

    made: list[Made] = field(default_factory=list)
    middles: list[tuple[Mapping[str, Frame], Mapping[str, Frame], Mapping[str, Frame]]] = field(default_factory=list)
    sensed: dict[str, Sensed] | None = None

    def forget(self) -> None:
        """Keep the states alone."""
        self.made = [replace(m, linear=None) for m in self.made]
        self.sensed = None

    def state_bytes(self) -> int:
        """Memory of the states."""
        return sum(m.state_bytes() for m in self.made)

    def size_bytes(self) -> int:
        """Memory of the steps and the derivatives of readings."""
        return sum(m.size_bytes() for m in self.made) + sum(s.size_bytes() for s in (self.sensed or {}).values())


@dataclass(frozen=True)
class Checkpoint:
    """Where a segment begins. ``frames``: of the mounts; ``unknowns``: of the system."""

    state: State
    frames: dict[str, Frame]
    unknowns: np.ndarray


class Recorder(Simulation):
    """A simulation that writes down the steps that it makes. ``linearising``: and linearises them."""

    def __init__(self, scene: Scene, settings: NewtonSettings | None = None, factors: bool = False) -> None:
        self.interval = Interval()
        self.linearising = False
        self.keeper = Keeper(scene.system, factors)
        self._open: list[tuple[Mapping[str, Frame], Mapping[str, Frame]]] = []
        super().__init__(scene, settings)

    def _step(self, start: Mapping[str, Frame], end: Mapping[str, Frame], dt: float, halvings: int) -> StepReport:
        if self._open and end is not self._open[-1][1]:
            self.interval.middles.append((end, *self._open[-1]))
        self._open.append((start, end))
        try:
            return super()._step(start, end, dt, halvings)
        finally:
            self._open.pop()

    def _advance(self, end: Mapping[str, Frame], dt: float) -> StepReport:
        before = self.state
        report = super()._advance(end, dt)
        linear = LinearStep(self.scene, self.keeper, before, self.state, dt) if self.linearising else None
        self.interval.made.append(Made(before, self.state, dt, end, self.scene.system.unknowns(), linear))
        return report

    def sense(self) -> None:
        """Write down the derivatives of the readings now."""
        self.interval.sensed = self.observer.linearise(self.scene.rig, self.actual_frames(), self.observer.kinds)

    def checkpoint(self) -> Checkpoint:
        """Where the simulation stands; contact is looked for afresh from here on."""
        self.scene.system.forget()
        return Checkpoint(self.state, dict(self.frames), self.scene.system.unknowns())

    def go_to(self, point: Checkpoint) -> None:
        """Stand where a checkpoint was made."""
        system = self.scene.system
        system.forget()
        self.state, self.frames = point.state, dict(point.frames)
        system.x[:] = point.state.x
        system.set_targets(self.scene.targets(self.frames))
        system.set_unknowns(point.unknowns)


def backwards(intervals: Sequence[Interval]) -> Iterator[Made]:
    """All steps, the last one first."""
    return (made for interval in reversed(intervals) for made in reversed(interval.made))


class Tape:
    """A rollout of a ``system`` as recorded. ``trace``: its readings; ``segments``: first time of each; ``kept_bytes``,
    ``most_bytes``: what is kept of its steps, and the most that there was of them at a time. It is gone through as long
    as the scene is what it was then (:meth:`check_scene`)."""

    def __init__(
        self,
        scene: Scene,
        poses: Mapping[str, PoseTrajectory],
        times: np.ndarray,
        settings: NewtonSettings | None = None,
        memory_mb: float = MEMORY_MB,
        on_step: Callable[[int, int], None] | None = None,
        factors: bool = False,
        watch: Callable[[int, Mapping[str, np.ndarray], int], None] | None = None,
    ) -> None:
        """Make the rollout. ``memory_mb``: bound on the steps that are kept; ``factors``: let their factorisations be
        kept too, which pays from six to ten losses on; ``watch`` is called with the number of each step, the readings
        after it and how many steps were halved so far, and ends the rollout by what it raises. Raises
        ``ConvergenceError``."""
        self.scene, self.system = scene, scene.system
        self._set_to = _set_to(scene)
        self._times = np.asarray(times, dtype=float)
        tracks = {name: trajectory.sample(times) for name, trajectory in poses.items()}
        self.commanded = [{n: frame_of(p[k], q[k]) for n, (p, q) in tracks.items()} for k in range(len(times))]
        """Commanded frames of the end effectors at all times."""
        self._frames = driven_frames(scene.rig, self.commanded, self._times)
        self._simulation = simulation = Recorder(scene, settings, factors)
        count = len(times) - 1
        length = max(1, math.ceil(math.sqrt(count)))
        self.segments = range(0, count, length)
        self._points: list[Checkpoint] = []
        self._kept: dict[int, list[Interval]] = {}
        self._bound = 1e6 * memory_mb
        self.kept_bytes = self.most_bytes = 0
        scene.system.forget()
        simulation.reset(self._frames[0])
        self.mounts = dict(simulation.frames)
        self.settling, self.start = simulation.settling, simulation.state
        self.start_unknowns = scene.system.unknowns()
        readings, reports = [simulation.read()], []
        self.start_sensed: dict[str, Sensed] | None = None
        """Derivatives of the readings at the first equilibrium, if kept."""
        self._way: list[tuple[Made, LinearStep]] | None = None
        if self.settling:
            self._keep_way()
        for first in self.segments:
            self._points.append(simulation.checkpoint())
            intervals: list[Interval] = []
            size = last = 0
            for k in range(first, min(first + length, count)):
                interval, report = self._make(k, self._affords(size + last, count - k))
                intervals.append(interval)
                last = interval.size_bytes()
                size += last
                reports.append(report)
                readings.append(simulation.read())
                if watch is not None:
                    watch(k + 1, readings[-1], simulation.halvings)
                if on_step is not None:
                    on_step(k + 1, count)
            self.most_bytes = max(self.most_bytes, self.kept_bytes + size)
            for interval in reversed(intervals):
                if self.kept_bytes + size <= self._bound:
                    break
                size -= interval.size_bytes() - interval.state_bytes()
                interval.forget()
            if self.kept_bytes + size <= self._bound:
                self._kept[first] = intervals
                self.kept_bytes += size
        outputs = {c: np.stack([r[c] for r in readings]) for c in readings[0]}
        self.observer = observer = simulation.observer
        self.trace = Trace(self._times, outputs, observer.kinds, observer.ids, tuple(reports))
        self.end = simulation.state
        """The state at the end, internal variables included."""

    def check_scene(self) -> None:
        """Raise ``ConfigError`` if the scene is another one than that of the rollout."""
        for what, now in _set_to(self.scene).items():
            if now != self._set_to[what]:
                raise ConfigError(
                    f"The scene was given {what} since the rollout was recorded.",
                    "Record it again, or take its gradient before.",
                )

    def _keep_way(self) -> None:
        """Linearise the way to the first equilibrium, and keep that if there is room."""
        simulation = self._simulation
        point = simulation.checkpoint()
        simulation.sense()
        sensed = simulation.interval.sensed or {}
        size = sum(s.size_bytes() for s in sensed.values())
        way = []
        with closing(self.way()) as steps:
            for made, linear in steps:
                size += made.size_bytes()
                if not self._affords(size, len(self._times)):
                    break
                way.append((made, linear))
            else:
                self._way, self.start_sensed = way, sensed
                self.kept_bytes = self.most_bytes = size
        simulation.go_to(point)

    def way(self) -> Generator[tuple[Made, LinearStep], None, None]:
        """The steps that the first equilibrium depends on, the last one first. While one is there the system has
        inertia if the step had."""
        if self._way is None:
            yield from linearised(self.scene, self.keeper, self.settling, self.mounts, backwards=True)
            return
        for made, linear in self._way:
            with with_inertia(self.system, linear.inertia):
                yield made, linear

    def _affords(self, size: int, left: int) -> bool:
        """Whether there is room to linearise one more step beside a segment of ``size`` [B], that step included, and
        for the states of the ``left`` steps to come, unknowns and growing internal variables included."""
        return self.kept_bytes + size + 2 * left * size_of_state(self.start) <= self._bound

    @property
    def memory_mb(self) -> float:
        """What checkpoints and steps take at the most [MB], beside the factorisations of three steps at a time."""
        return 1e-6 * (self.most_bytes + sum(size_of_state(p.state) for p in self._points))

    def intervals(self, first: int) -> list[Interval]:
        """The steps of the segment that begins at time number ``first``, made again unless they were kept."""
        if first in self._kept:
            return self._kept[first]
        self._simulation.go_to(self._points[self.segments.index(first)])
        last = min(first + self.segments.step, len(self._times) - 1)
        intervals = [self._make(k, True)[0] for k in range(first, last)]
        self.most_bytes = max(self.most_bytes, self.kept_bytes + sum(i.size_bytes() for i in intervals))
        return intervals

    def kept_before(self, first: int) -> Iterator[Made]:
        """Steps before the segment that begins at time number ``first``, backwards, as long as they were kept."""
        for earlier in reversed(self.segments[: self.segments.index(first)]):
            if earlier not in self._kept:
                return
            yield from backwards(self._kept[earlier])

    def everything(self) -> Iterator[Interval]:
        """What was done, from the start on, in one segment after the other."""
        for first in self.segments:
            yield from self.intervals(first)

    @property
    def keeper(self) -> Keeper:
        """Keeps the Hessians of steps that are linearised."""
        return self._simulation.keeper

    def _make(self, k: int, linearising: bool) -> tuple[Interval, StepReport]:
        simulation = self._simulation
        simulation.interval, simulation.linearising = Interval(), linearising
        report = simulation.step(self._frames[k + 1], float(self._times[k + 1] - self._times[k]))
        if linearising:
            simulation.sense()
        return simulation.interval, report


def _set_to(scene: Scene) -> dict[str, Any]:
    """What a rollout depends on that can be changed in a scene, by the words for a change of it."""
    system = scene.system
    return {
        "another shape at rest": system,
        "another rig": scene.rig,
        "other fields": scene.fields.changes,
        "other loads": system.loads.tobytes(),
        "other gravity": system.gravity.tobytes(),
    }
