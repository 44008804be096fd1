"""A rollout that can be gone through backwards: the steps that were made, kept or made again from checkpoints.

The times of a rollout are cut into about sqrt(T) segments. Where one begins the state is kept, and the search for
contact starts afresh, so that a segment made again is the same to the last bit. The steps of a segment are
kept too as long as all of them together stay within a bound on memory; beyond it only one segment at a time is, and
the memory is that of O(sqrt(T)) states. No Hessian is kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Frame, Scene
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation, Trace
from sim_core.solve.step import NewtonSettings, State, StepReport

MEMORY_MB = 1024.0
"""Bound on what the steps that are kept may take, where none is given."""


@dataclass(frozen=True)
class Made:
    """One step without subdivision: from ``before`` to ``after`` in ``dt`` [s]; at its end the mounts are at
    ``frames`` and the system has the ``unknowns``."""

    before: State
    after: State
    dt: float
    frames: Mapping[str, Frame]
    unknowns: np.ndarray


@dataclass
class Interval:
    """All that was done between two times of the rollout. ``middles``: frames halfway between two others, in the order
    in which they were made: (middle, start, end)."""

    made: list[Made] = field(default_factory=list)
    middles: list[tuple[Mapping[str, Frame], Mapping[str, Frame], Mapping[str, Frame]]] = field(default_factory=list)

    def size_bytes(self) -> int:
        """Memory of the steps; each shares its first state with the one before."""
        return sum(_bytes(m.after) + m.unknowns.nbytes for m in self.made)


@dataclass(frozen=True)
class Checkpoint:
    """Where a segment begins. ``frames``: of the mounts; ``unknowns``: of the system."""

    state: State
    frames: dict[str, Frame]
    unknowns: np.ndarray


class Recorder(Simulation):
    """A simulation that writes down the steps that it makes."""

    def __init__(self, scene: Scene, settings: NewtonSettings | None = None) -> None:
        self.interval = Interval()
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
        self.interval.made.append(Made(before, self.state, dt, end, self.scene.system.unknowns()))
        return report

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


class Tape:
    """A rollout as recorded. ``trace``: its readings; ``segments``: first time of each."""

    def __init__(
        self,
        scene: Scene,
        poses: Mapping[str, PoseTrajectory],
        times: np.ndarray,
        settings: NewtonSettings | None = None,
        memory_mb: float = MEMORY_MB,
        on_step: Callable[[int, int], None] | None = None,
    ) -> None:
        """Make the rollout. ``memory_mb``: bound on the steps that are kept. Raises ``ConvergenceError``."""
        self.scene = scene
        self._times = np.asarray(times, dtype=float)
        tracks = {name: trajectory.sample(times) for name, trajectory in poses.items()}
        self._frames = [{n: frame_of(p[k], q[k]) for n, (p, q) in tracks.items()} for k in range(len(times))]
        self._simulation = simulation = Recorder(scene, settings)
        count = len(times) - 1
        length = max(1, math.ceil(math.sqrt(count)))
        self.segments = range(0, count, length)
        self._points: list[Checkpoint] = []
        self._kept: dict[int, list[Interval]] = {}
        self.kept_bytes = self.most_bytes = 0
        self.sizes_bytes: list[int] = []  # of what was done between two times, kept or not
        scene.system.forget()
        simulation.reset(self._frames[0])
        self.mounts = dict(simulation.frames)
        self.settled_from, self.start = simulation.settled_from, simulation.state
        self.start_unknowns = scene.system.unknowns()
        readings, reports = [simulation.read()], []
        for first in self.segments:
            self._points.append(simulation.checkpoint())
            intervals = []
            for k in range(first, min(first + length, count)):
                interval, report = self._make(k)
                intervals.append(interval)
                reports.append(report)
                readings.append(simulation.read())
                if on_step is not None:
                    on_step(k + 1, count)
            size = sum(i.size_bytes() for i in intervals)
            self.sizes_bytes += [i.size_bytes() for i in intervals]
            self.most_bytes = max(self.most_bytes, self.kept_bytes + size)
            if self.kept_bytes + size <= 1e6 * memory_mb:
                self._kept[first] = intervals
                self.kept_bytes += size
        outputs = {c: np.stack([r[c] for r in readings]) for c in readings[0]}
        self.observer = observer = simulation.observer
        self.trace = Trace(self._times, outputs, observer.kinds, observer.ids, tuple(reports))

    @property
    def memory_mb(self) -> float:
        """What checkpoints and steps take at the most [MB]."""
        return 1e-6 * (self.most_bytes + sum(_bytes(p.state) for p in self._points))

    def intervals(self, first: int) -> list[Interval]:
        """The steps of the segment that begins at time number ``first``, made again unless they were kept."""
        if first in self._kept:
            return self._kept[first]
        self._simulation.go_to(self._points[list(self.segments).index(first)])
        last = min(first + self.segments.step, len(self._times) - 1)
        return [self._make(k)[0] for k in range(first, last)]

    def _make(self, k: int) -> tuple[Interval, StepReport]:
        simulation = self._simulation
        simulation.interval = Interval()
        report = simulation.step(self._frames[k + 1], float(self._times[k + 1] - self._times[k]))
        return simulation.interval, report


def _bytes(state: State) -> int:
    internals = sum(a.nbytes for term in state.internals.values() for a in term.values())
    return state.x.nbytes + state.v.nbytes + internals
