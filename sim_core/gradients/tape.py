"""A rollout that can be gone through backwards, recorded on the compiled core."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sim_core.core.adjoint import RecordedRollout
from sim_core.core.covers import covers
from sim_core.core.rollout import Chunk, tell, trace_of
from sim_core.errors import ConfigError
from sim_core.gradients.gradient import MEMORY_MB
from sim_core.gradients.scene_settings import SceneSettings
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Frame, Scene
from sim_core.sensing.instants import Instants, read_all
from sim_core.sensing.observe import frame_of
from sim_core.solve.step import NewtonSettings, State
from sim_core.trace import Trace


class Tape:
    """A rollout as recorded. It is gone through as long as the scene is what it was then (:meth:`check_scene`)."""

    trace: Trace
    """The readings."""
    mounts: dict[str, Frame]
    """Frames of the mounts at the start."""
    start: State
    """The state that the first step starts from, internal variables included."""
    end: State
    """The state at the end."""

    def __init__(
        self,
        scene: Scene,
        poses: Mapping[str, PoseTrajectory],
        times: np.ndarray,
        settings: NewtonSettings | None = None,
        memory_mb: float = MEMORY_MB,
        on_step: Callable[[int, int], None] | None = None,
        watch: Callable[[int, Mapping[str, np.ndarray], int], None] | None = None,
        begin: State | None = None,
    ) -> None:
        """Make the rollout at ``times`` [s] ``(n,)``. ``memory_mb``: bound on the steps that are kept; what else there
        is of longer rollouts is made again on the way back, from positions, which are kept; ``watch`` is called with
        the number of each step, the readings after it and how many steps were halved so far, and ends the rollout by
        what it raises. ``begin``: the state in which it begins, which is taken for given: it does not follow poses.
        Raises ``ConvergenceError``, and ``ConfigError`` where the compiled core does not cover the
        scene."""
        if (lack := covers(scene)) is not None:
            raise ConfigError(
                f"This rollout has no gradient on the way back: {lack[0].lower()}{lack[1:]}",
                "Install what it names, or take differences of rollouts.",
            )
        self._settings = SceneSettings(scene)
        self.scene, times = scene, np.asarray(times, dtype=float)
        tracks = {name: trajectory.sample(times) for name, trajectory in poses.items()}
        self.commanded = [{n: frame_of(p[k], q[k]) for n, (p, q) in tracks.items()} for k in range(len(times))]
        self.rollout = rollout = RecordedRollout(
            scene, poses, times, settings or NewtonSettings(), int(min(1e6 * memory_mb, 2.0**62))
        )
        self.observer = rollout.observer
        self._loads: list[np.ndarray] = []
        self._moments: list[list[np.ndarray]] = []
        readings: list[dict[str, np.ndarray]] = []
        halvings = 0

        def take(chunk: Chunk) -> None:
            nonlocal halvings
            readings.append(read_all(rollout.observer, scene.rig, chunk.at))
            self._loads.append(chunk.at.force[:, rollout.bearing])
            self._moments.append([moment.copy() for _, moment in chunk.at.moments])
            for row, k in enumerate(range(max(chunk.steps.start, 0), chunk.steps.stop)):
                if watch is not None and k:
                    halvings += max(0, rollout.reports[k - 1].parts - 1)
                    watch(k, {c: v[row] for c, v in readings[-1].items()}, halvings)
            tell(scene, rollout, chunk, on_step)

        take(rollout.settle() if begin is None else rollout.begin(begin))
        self.mounts = rollout.frames(0)
        self.start = rollout.state_now(0.0)
        for chunk in rollout.run():
            take(chunk)
        self.end = rollout.state_now(float(times[-1] - times[0]))
        self.trace = trace_of(rollout, {c: np.concatenate([r[c] for r in readings]) for c in readings[0]}, [])

    def check_scene(self) -> None:
        """Raise ``ConfigError`` if the scene is another one than that of the rollout."""
        self._settings.check(self.scene)

    def instants(self, span: slice) -> Instants:
        """The states at some instants in a row."""
        rollout, nodes = self.rollout, len(self.scene.rest)
        whole = rollout.positions(span)
        places = {
            name: (rollout.places[span, m, :3], rollout.places[span, m, 3:].reshape(-1, 3, 3))
            for m, name in enumerate(rollout.mounts)
        }
        for k, name in enumerate(self.scene.compliant):
            places[name] = places[name][0] + whole[:, nodes + k], places[name][1]
        x = whole[:, :nodes]
        force = np.zeros_like(x)
        force[:, rollout.bearing] = self._at(self._loads, span)
        moments = [self._at([m[k] for m in self._moments], span) for k in range(len(rollout.contacts))]
        return Instants(places, x, force, [(t.body_node, m) for t, m in zip(rollout.contacts, moments, strict=True)])

    @staticmethod
    def _at(parts: list[np.ndarray], span: slice) -> np.ndarray:
        """Some rows of what was made in parts."""
        found, first = [], 0
        for part in parts:
            found.append(part[max(span.start - first, 0) : max(span.stop - first, 0)])
            first += len(part)
        return np.concatenate(found)
