"""Run a scene under end-effector motion and record what its sensors would read."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sim_core.commands import driven_frames
from sim_core.core.rollout import Chunk, CoreRollout, tell, trace_of
from sim_core.permanent_state import PermanentState
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Scene
from sim_core.sensing.instants import read_all
from sim_core.sensing.observe import frame_of
from sim_core.solve.step import NewtonSettings
from sim_core.state_history import StateRecorder
from sim_core.stepping import Simulation
from sim_core.trace import NodePath, Trace, between, interpolate, step_times

__all__ = [
    "NodePath",
    "Simulation",
    "Trace",
    "between",
    "interpolate",
    "run",
    "simulate",
    "step_times",
]


def simulate(
    scene: Scene,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    on_step: Callable[[int, int], None] | None = None,
    settings: NewtonSettings | None = None,
    *,
    keep_states: bool = False,
    keep_path: bool = False,
    warm_start: NodePath | None = None,
    left: PermanentState | None = None,
) -> Trace:
    """Drive the scene along ``poses`` (by end effector) and read every channel at ``times`` [s] ``(n,)``.

    ``on_step(done, total)`` is called after each step. ``keep_states``: the trace has :attr:`Trace.states`, which take
    48 bytes a node and instant and 24 more for each declared contact, ``keep_path``: :attr:`Trace.path` alone, 24 bytes
    a node and instant. ``warm_start``: the path of a similar rollout, from which steps begin. ``left``: what an earlier
    rollout has left of the bodies. Raises ``ConvergenceError`` when a step does not converge even in small parts.
    """
    rollout = CoreRollout(scene, poses, times, settings or NewtonSettings(), keep_states=keep_states)
    parts, path = [], []

    def take(chunk: Chunk) -> None:
        parts.append(read_all(rollout.observer, scene.rig, chunk.at))
        if keep_path:
            path.append(chunk.at.x)
        rollout.remember(chunk.steps.stop - 1)
        tell(scene, rollout, chunk, on_step)

    take(rollout.settle(left=left))
    for chunk in rollout.run(warm_start):
        take(chunk)
    return trace_of(rollout, {c: np.concatenate([p[c] for p in parts]) for c in parts[0]}, path)


def run(
    simulation: Simulation,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    on_step: Callable[[int, int], None] | None = None,
    on_reset: Callable[[], None] | None = None,
    *,
    keep_states: bool = False,
    keep_path: bool = False,
) -> Trace:
    """As :func:`sim_core.simulate.simulate`, with a simulation at hand, which is reset first; then ``on_reset`` is
    called. ``times`` [s] ``(n,)``: instants of the steps."""
    tracks = {name: trajectory.sample(times) for name, trajectory in poses.items()}

    commanded = [{name: frame_of(p[k], q[k]) for name, (p, q) in tracks.items()} for k in range(len(times))]
    frames = driven_frames(simulation.scene.rig, commanded, times)
    simulation.reset(frames[0])
    if on_reset is not None:
        on_reset()
    recorder = StateRecorder(simulation.scene) if keep_states else None

    def record() -> None:
        if recorder is not None:
            recorder.take(simulation.state, simulation.actual_frames(), simulation.contact_forces())

    readings = [simulation.read()]
    path = [simulation.state.x]
    record()
    reports = []
    for k in range(1, len(times)):
        reports.append(simulation.step(frames[k], float(times[k] - times[k - 1])))
        readings.append(simulation.read())
        if keep_path:
            path.append(simulation.state.x)
        record()
        if on_step is not None:
            on_step(k, len(times) - 1)
    outputs = {c: np.stack([r[c] for r in readings]) for c in readings[0]}
    states = None if recorder is None else recorder.history()
    kept = NodePath(times, np.stack(path)) if keep_path else None
    left = simulation.permanent_state()
    least = tuple(simulation.least_volumes.values())
    observer = simulation.observer
    return Trace(times, outputs, observer.kinds, observer.ids, tuple(reports), states, kept, left, least)
