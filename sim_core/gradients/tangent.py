"""Forward sensitivities of a rollout with respect to parameters, through the implicit steps.

Each step is linearised where it ended and carries the derivative of the state along every parameter: one factorisation
a step, one back-substitution a parameter, in the core, together with the state
(:file:`sim_core/core/include/rollout.hpp`). The derivatives are those of the discrete rollout, exact but for round-off
and for the slopes of the parameters themselves. Offsets of end effectors move what follows them, in every step and at
the start (:mod:`sim_core.gradients.boundary_motion`).

Where the true derivative jumps (a contact made or lost within the step, the onset of yield, a point that has just
begun to press) it is that of the branch that the rollout took. A number of zero (friction, a share) is differentiated
to the side of more of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sim_core.core.mounts import mount_row
from sim_core.core.rollout import Chunk, CoreRollout, Slopes, tell, trace_of
from sim_core.core.slopes import NumberSlopes
from sim_core.gradients.boundary_motion import put_left, start_along
from sim_core.gradients.camera_gradients import Imaging
from sim_core.gradients.directions import Direction, checked, command_motions, motions, slopes, together
from sim_core.permanent_state import PermanentState
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.carriage import start_state
from sim_core.scene.offset import with_offsets
from sim_core.scene.scene import Frame, Scene
from sim_core.sensing.instants import before_cameras, differentiate_all, read_all
from sim_core.sensing.observe import frame_of
from sim_core.solve.report import NewtonSettings
from sim_core.trace import NodePath, Trace


def simulate_tangent(
    scene: Scene,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    along: Sequence[Direction],
    on_step: Callable[[int, int], None] | None = None,
    settings: NewtonSettings | None = None,
    *,
    keep_path: bool = False,
    warm_start: NodePath | None = None,
    left: PermanentState | None = None,
) -> tuple[Trace, dict[str, np.ndarray]]:
    """Trace of a rollout at ``times`` [s] and the derivatives of every channel, ``(n_times, ..., n_parameters)``, in
    the unit of the channel over that of the parameter. Raises ``ConfigError`` where ``along`` has something else than
    directions. ``keep_path``, ``warm_start``, ``left``: as of :func:`sim_core.simulate.simulate`; what was left has
    derivatives along the same directions."""
    along = checked(along)
    moving = boundary_motions(scene, poses, times, along)
    numbers = NumberSlopes(*slopes(scene, along))
    rollout = CoreRollout(scene, poses, times, settings or NewtonSettings(), numbers, moving)
    start = start_of(rollout, moving[0], len(along), left)
    return differentiated(rollout, along, start, on_step, keep_path=keep_path, warm_start=warm_start, left=left)


def tangent_at_rest(scene: Scene, frames: Mapping[str, Frame], along: Sequence[Direction]) -> dict[str, np.ndarray]:
    """Derivatives of every channel ``(..., n_parameters)`` at rest with the mounts at ``frames``, nominal; others are
    where the scene starts."""
    moved = motions(scene.rig, along)
    numbers = NumberSlopes(*slopes(scene, along))
    rollout = CoreRollout(scene, {}, np.zeros(1), NewtonSettings(), numbers, [moved])
    rollout.places = mount_row(with_offsets(scene.rig, {**scene.start, **frames}))[None]
    start = start_of(rollout, moved, len(along))
    found = differentiated(rollout, along, start, None, keep_path=False, warm_start=None)[1]
    return {channel: derivatives[0] for channel, derivatives in found.items()}


def start_of(
    rollout: CoreRollout, moved: Mapping[str, np.ndarray], count: int, left: PermanentState | None = None
) -> Slopes:
    """Derivatives of where bodies are put, where mounts move by ``count`` parameters as ``moved``. ``left``: what an
    earlier rollout has left of them."""
    scene, frames = rollout.scene, rollout.frames(0)
    x, v, rotations = start_along(scene, frames, moved, start_state(scene, frames, left), count)
    if left is not None:
        put_left(scene, frames, left, x)
    return x, v, rotations


def differentiated(
    rollout: CoreRollout,
    along: Sequence[Direction],
    start: Slopes,
    on_step: Callable[[int, int], None] | None,
    *,
    keep_path: bool,
    warm_start: NodePath | None,
    left: PermanentState | None = None,
) -> tuple[Trace, dict[str, np.ndarray]]:
    """Make a rollout, and read its trace and derivatives."""
    scene, imaging = rollout.scene, Imaging(along)
    parts: list[dict[str, np.ndarray]] = []
    changes: list[dict[str, np.ndarray]] = []
    path: list[np.ndarray] = []

    def take(chunk: Chunk) -> None:
        readings = read_all(rollout.observer, scene.rig, chunk.at)
        parts.append(readings)
        if chunk.along is None:
            changes.append({c: np.zeros((*value.shape, 0)) for c, value in readings.items()})
        else:
            changes.append(differentiate_all(rollout.observer, scene.rig, chunk.at, chunk.along, readings))
        imaging.take_all(scene.rig, lambda rig: before_cameras(rollout.observer, rig, chunk.at))
        if keep_path:
            path.append(chunk.at.x)
        tell(scene, rollout, chunk, on_step)

    take(rollout.settle(start if along else None, left))
    for chunk in rollout.run(warm_start):
        take(chunk)
    outputs = {c: np.concatenate([p[c] for p in parts]) for c in parts[0]}
    found = {c: np.concatenate([s[c] for s in changes]) for c in outputs}
    for channel, derivatives in found.items():
        for k, slope in imaging.slopes(channel).items():
            derivatives[..., k] += slope
    return trace_of(rollout, outputs, path), found


def boundary_motions(
    scene: Scene, poses: Mapping[str, PoseTrajectory], times: np.ndarray, along: Sequence[Direction]
) -> list[Mapping[str, np.ndarray]]:
    """Motions of the mounts by the parameters, at all times or, one, all the time."""
    offsets = motions(scene.rig, along)
    if all(d.low.effects == d.high.effects for d in along):
        return [offsets]
    tracks = {name: trajectory.sample(times) for name, trajectory in poses.items()}
    commanded = [{n: frame_of(p[k], q[k]) for n, (p, q) in tracks.items()} for k in range(len(times))]
    moving = command_motions(scene.rig, along, commanded, times)
    return [together(offsets, moved) for moved in moving] if moving else [offsets]
