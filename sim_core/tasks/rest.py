"""The state from which a task begins: all is at rest, as it is where a person has put it and waits.

Bodies of a rig are where its file puts them, a little above what they are to lie on. They are let go with the hands
held still, in steps that grow longer: backward Euler takes the energy of what swings in few of those.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim_core.errors import ConfigError, ConvergenceError
from sim_core.scene.carriage import start_state
from sim_core.scene.scene import Frame, Scene
from sim_core.simulate import Simulation
from sim_core.solve.state import State

REST_M_S = 1e-6
"""At rest is what would take 10 s to move by the 10 um that are the noise of a marker."""

GROWTH, LONGEST_S = 1.5, 0.1
"""Of the steps, from each to the next, and their longest."""

PATIENCE_S = 10.0
"""What has not come to rest by then will not."""


def resting_state(
    scene: Scene, frames: Mapping[str, Frame], step_s: float, holds: Sequence[Mapping[str, Frame]]
) -> State:
    """The state at rest with the hands at ``frames``, or where ``holds`` bring them, steps of ``step_s`` [s] from there
    on; free bodies have the velocities that the rig gives them.

    Raises ``ConfigError`` where nothing comes to rest.
    """
    simulation = Simulation(scene)
    simulation.reset(frames)
    simulation.state = replace(simulation.state, v=np.zeros_like(simulation.state.v))
    at = frames
    try:
        for at in holds:
            simulation.step(at, step_s)
        dt = step_s
        while simulation.state.t < PATIENCE_S:
            before = simulation.state.x
            simulation.step(at, dt)
            if np.abs(simulation.state.x - before).max() < REST_M_S * dt:
                state = simulation.state
                return replace(state, t=0.0, v=start_state(scene, {**scene.start, **frames})[1], past=None)
            dt = min(GROWTH * dt, LONGEST_S)
    except ConvergenceError as error:
        raise _restless(scene, simulation.state, f"after {simulation.state.t:.2f} s a step fails") from error
    raise _restless(scene, simulation.state, f"{PATIENCE_S:g} s were not enough")


def _restless(scene: Scene, state: State, words: str) -> ConfigError:
    speeds = {name: np.linalg.norm(state.v[body.nodes], axis=1).max(initial=0.0) for name, body in scene.bodies.items()}
    fastest = max(speeds, key=lambda name: float(speeds[name]))
    return ConfigError(
        f"Nothing comes to rest where the rig {scene.rig.name!r} begins: {words}, and {fastest} moves at "
        f"{1e3 * speeds[fastest]:.3g} mm/s.",
        "Put it where it stays, or, where hands are to hold it, say 'begins: held' in the task.",
    )
