"""Run a scene under end-effector motion and record what its sensors would read."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sim_core.core.covers import covers
from sim_core.core.rollout import simulate_compiled
from sim_core.permanent_state import PermanentState
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Scene
from sim_core.simulation import (
    NodePath,
    Settling,
    Simulation,
    Trace,
    interpolate,
    midway,
    run,
    settle,
    step_times,
)
from sim_core.solve.step import NewtonSettings

__all__ = [
    "NodePath",
    "Settling",
    "Simulation",
    "Trace",
    "interpolate",
    "midway",
    "run",
    "settle",
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
    beside: NodePath | None = None,
    left: PermanentState | None = None,
) -> Trace:
    """Drive the scene along ``poses`` (by end effector) and read every channel at ``times`` [s] ``(n,)``.

    ``on_step(done, total)`` is called after each step. ``keep_states``: the trace has :attr:`Trace.states`, which take
    48 bytes a node and instant and 24 more for each declared contact, ``keep_path``: :attr:`Trace.path` alone, 24 bytes
    a node and instant. ``beside``: the path of a rollout near by, from which steps begin. ``left``: what an earlier
    rollout has left of the bodies. Raises ``ConvergenceError`` when a step does not converge even in small parts.
    """
    if covers(scene, keep_states=keep_states, left=left) is None:
        return simulate_compiled(scene, poses, times, on_step, settings, keep_path=keep_path, beside=beside)
    simulation = Simulation(scene, settings, left=left)
    simulation.beside = beside
    return run(simulation, poses, times, on_step, keep_states=keep_states, keep_path=keep_path)
