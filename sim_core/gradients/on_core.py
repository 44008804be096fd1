"""Derivatives of a rollout along parameters on the compiled core, which carries them beside the state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sim_core.core.record import NumberSlopes
from sim_core.core.rollout import Chunk, CoreRollout, tell, trace_of
from sim_core.gradients.boundary_motion import start_along
from sim_core.gradients.camera_gradients import Imaging
from sim_core.gradients.directions import Direction, command_motions, motions, slopes, together
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.carriage import start_state
from sim_core.scene.scene import Scene
from sim_core.sensing.instants import before_cameras, differentiate_all, read_all
from sim_core.sensing.observe import frame_of
from sim_core.simulation import NodePath, Trace
from sim_core.solve.report import NewtonSettings


def tangent_compiled(
    scene: Scene,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    along: Sequence[Direction],
    on_step: Callable[[int, int], None] | None,
    settings: NewtonSettings | None,
    *,
    keep_path: bool,
    beside: NodePath | None,
) -> tuple[Trace, dict[str, np.ndarray]] | None:
    """As :func:`sim_core.gradients.tangent.simulate_tangent`, on the core; None where surfaces or edges touch at rest,
    where its columns have not been compared with the launched path's."""
    count = len(along)
    moving = _motions(scene, poses, times, along)
    numbers = NumberSlopes(*slopes(scene, along))
    rollout = CoreRollout(scene, poses, times, settings or NewtonSettings(), numbers, moving)
    frames = rollout.frames(0)
    imaging = Imaging(along)
    parts: list[dict[str, np.ndarray]] = []
    changes: list[dict[str, np.ndarray]] = []
    path: list[np.ndarray] = []

    def take(chunk: Chunk) -> None:
        assert chunk.along is not None
        readings = read_all(rollout.observer, scene.rig, chunk.at)
        parts.append(readings)
        changes.append(differentiate_all(rollout.observer, scene.rig, chunk.at, chunk.along, readings))
        imaging.take_all(scene.rig, lambda rig: before_cameras(rollout.observer, rig, chunk.at))
        if keep_path:
            path.append(chunk.at.x)
        tell(scene, rollout, chunk, on_step)

    x, _, rotations = start_along(scene, frames, moving[0], start_state(scene, frames), count)
    rest = rollout.settle((x, rotations))
    if rollout.surfaces_touch:
        return None
    take(rest)
    for chunk in rollout.run(beside):
        take(chunk)
    outputs = {c: np.concatenate([p[c] for p in parts]) for c in parts[0]}
    found = {c: np.concatenate([s[c] for s in changes]) for c in outputs}
    for channel, derivatives in found.items():
        for k, slope in imaging.slopes(channel).items():
            derivatives[..., k] += slope
    return trace_of(rollout, outputs, path), found


def _motions(
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
