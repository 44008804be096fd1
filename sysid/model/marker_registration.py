"""Where markers are on a sheet, from the first frame of a recording.

Pins and stickers are put on anew for each recording. The sheet is brought to rest between its clamps as
they stand at the first frame that shows any marker, its mesh is projected into the picture, and each marker belongs to
the triangle that it is seen on. A sheet that lies over itself in the picture has no such triangle that is
sure; the one with the marker deepest inside is taken.

Where that is depends on the rig: with a scale of the camera that is 1 % larger, markers are 1 % further apart on the
sheet. So markers are placed by the rig of each prediction, and derivatives of predictions have their share of it. Of a
marker that is seen at u0 and is at the place p on the sheet, with g(p, theta) what the camera would see of it at rest,

    g(p, theta) = u0:    dp/dtheta = -(dg/dp)^-1 dg/dtheta
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim_core.errors import ConfigError, RecordingError
from sim_core.geometry import sheets
from sim_core.gradients import Direction
from sim_core.gradients.tangent import tangent_at_rest
from sim_core.rigs import Rig, Sight, track_ids
from sim_core.rigs.bodies import Rigid
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import Scene
from sim_core.scene.scene import Frame
from sim_core.sensing.camera import project
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation
from sysid.model.sensor_streams import total_delay
from sysid.observations.observations import FirstFrame, Measured
from sysid.settings.model import MODEL

FirstFrames = Mapping[str, FirstFrame]
"""By camera."""


def first_frames(
    rig: Rig, poses: Mapping[str, PoseTrajectory], measured: Sequence[Measured]
) -> tuple[dict[str, FirstFrame], tuple[str, ...]]:
    """The first frame of each camera with points that are ``placed: first_frame``; notes on markers that it lacks."""
    found: dict[str, FirstFrame] = {}
    notes = []
    bodies = {n: b for n, b in rig.bodies.items() if not isinstance(b, Rigid)}
    for m in measured:
        if m.channel not in rig.cameras or not _placing(rig.cameras[m.channel].sees):
            continue
        shown = int(np.argmax(np.isfinite(m.values).any(axis=1)))
        pixels, t = m.values[shown].reshape(-1, 2), float(m.t[shown])
        about = {name: _about(trajectory, t) for name, trajectory in poses.items()}
        found[m.channel] = FirstFrame(t, pixels, about)
        ids, start = track_ids(rig.cameras[m.channel], bodies), 0
        for sight in rig.cameras[m.channel].sees:
            own = slice(start, start + sight.points.count)
            start = own.stop
            if sight.points.placed == "first_frame":
                notes += [
                    f"{m.channel}: marker {marker} is not in the first frame; it stays as the rig places it."
                    for marker in ids[own][~np.isfinite(pixels[own]).all(axis=1)]
                ]
    return found, tuple(notes)


def placed(scene: Scene, firsts: FirstFrames) -> Rig:
    """The rig of a scene with the markers where the recording first shows them, by that rig.

    Raises ``RecordingError`` when a marker is not seen on its sheet.
    """
    rig = scene.rig
    if not firsts:
        return scene.given
    simulation = Simulation(scene)
    cameras = dict(scene.given.cameras)
    for name, first in firsts.items():
        simulation.reset(_frames(rig, name, first))
        sights = list(rig.cameras[name].sees)
        for index, sight, rows, pixels in _seen(rig, name, first):
            positions = np.array(sight.points.positions_m)
            for row, (corners, weights, _) in zip(rows, _under(simulation, name, sight, rows, pixels), strict=True):
                positions[row] = weights @ corners
            sights[index] = _with_positions(sight, positions)
        cameras[name] = cameras[name].model_copy(update={"sees": tuple(sights)})
    return scene.given.model_copy(update={"cameras": cameras})


def placed_along(scene: Scene, firsts: FirstFrames, along: Sequence[Direction]) -> list[Direction]:
    """Directions from the rig of a scene, which is :func:`placed`, with what they change in the places of markers."""
    if not firsts or not along:
        return list(along)
    simulation = Simulation(scene)
    shifts: list[dict[str, dict[int, np.ndarray]]] = [{} for _ in along]
    for name, first in firsts.items():
        frames = _frames(scene.rig, name, first)
        simulation.reset(frames)
        at_once = np.nan_to_num(tangent_at_rest(scene, frames, along)[name])
        by_pixel = {
            (index, row): slope
            for index, sight, rows, pixels in _seen(scene.rig, name, first)
            for row, (_, _, slope) in zip(rows, _under(simulation, name, sight, rows, pixels), strict=True)
        }
        counts = [sight.points.count for sight in scene.rig.cameras[name].sees]
        start = np.cumsum([0, *counts])
        for k, direction in enumerate(along):
            seen = at_once[..., k] + _later(simulation, name, first, direction)
            moved = {index: np.zeros((counts[index], 3)) for index, _ in by_pixel}
            for (index, row), slope in by_pixel.items():
                moved[index][row] = -slope @ seen[start[index] + row]
            shifts[k][name] = {index: shift for index, shift in moved.items() if shift.any()}
    return [
        replace(d, low=_shifted(d.low, shift, -0.5 * d.width), high=_shifted(d.high, shift, 0.5 * d.width))
        for d, shift in zip(along, shifts, strict=True)
    ]


def _placing(sees: Sequence[Sight]) -> bool:
    return any(sight.points.placed == "first_frame" for sight in sees)


def _about(trajectory: PoseTrajectory, t: float) -> PoseTrajectory:
    """The poses near a time, at least one."""
    first = max(0, int(np.searchsorted(trajectory.times, t - MODEL.registration_reach_s, side="right")) - 1)
    last = int(np.searchsorted(trajectory.times, t + MODEL.registration_reach_s)) + 1
    near = slice(min(first, len(trajectory.times) - 1), last)
    return trajectory.part(near)


def _frames(rig: Rig, name: str, first: FirstFrame) -> dict[str, Frame]:
    """Where the end effectors were commanded to be when a camera took its first frame, by the latency of a rig."""
    when = first.t - total_delay(rig, name, "tracks")
    return {mount: frame_of(*trajectory.at(when)) for mount, trajectory in first.poses.items()}


def _seen(rig: Rig, name: str, first: FirstFrame) -> list[tuple[int, Sight, np.ndarray, np.ndarray]]:
    """Sights of a camera that its first frame places: number, sight, which of its points are there ``(k,)``, and their
    pixels ``(k, 2)``."""
    found, start = [], 0
    for index, sight in enumerate(rig.cameras[name].sees):
        here = first.pixels[start : start + sight.points.count]
        start += sight.points.count
        if sight.points.placed == "first_frame":
            rows = np.flatnonzero(np.isfinite(here).all(axis=1))
            found.append((index, sight, rows, here[rows]))
    return found


def _under(
    simulation: Simulation, name: str, sight: Sight, rows: np.ndarray, pixels: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The triangle of a sheet that is seen at each of ``pixels`` ``(k, 2)``: its corners on the sheet [m] ``(3, 3)``,
    the weights of the place on them ``(3,)``, and the derivative of the place by the pixel [m/px] ``(3, 2)``."""
    scene = simulation.scene
    body, lens = scene.bodies[sight.body], scene.rig.cameras[name]
    assert isinstance(body.layout, sheets.SheetMesh)
    frames = simulation.actual_frames()
    origin, rotation = lens.truly(*lens.pose.within(frames[lens.mount]))
    picture = project(lens, rotation.inv().apply(simulation.state.x[body.nodes] - origin))
    flat = sheets.SheetMesh(np.column_stack([picture, np.zeros(len(picture))]), body.layout.triangles)
    found = []
    for row, pixel in zip(rows, pixels, strict=True):
        try:
            triangle, weights = sheets.locate(flat, pixel[None])
        except ConfigError:
            low, high = np.nanmin(picture, axis=0), np.nanmax(picture, axis=0)
            marker = row if sight.points.ids is None else sight.points.ids[row]
            raise RecordingError(
                f"{name}: marker {marker} is first seen at {pixel.round(1).tolist()} px, but {sight.body} "
                f"reaches from {low.round(1).tolist()} to {high.round(1).tolist()} px there.",
                "Correct the size or the pose of the sheet, or the scale and the origin of the camera.",
            ) from None
        corners = body.layout.triangles[triangle[0]]
        local, shown = body.layout.nodes[corners], picture[corners]
        found.append((local, weights[0], (local[1:] - local[0]).T @ np.linalg.inv((shown[1:] - shown[0]).T)))
    return found


def _later(simulation: Simulation, name: str, first: FirstFrame, direction: Direction) -> np.ndarray:
    """Derivatives of what a camera sees first ``(n, 2)`` by what a parameter changes in the instant that it shows."""
    ends = [_frames(rig, name, first) for rig in (direction.high, direction.low)]
    seen = np.zeros(simulation.read()[name].shape)
    if all(_alike(ends[0][mount], ends[1][mount]) for mount in ends[0]):
        return seen
    for sign, frames in zip((1.0, -1.0), ends, strict=True):
        simulation.reset(frames)
        seen += sign * simulation.read()[name]
    return np.nan_to_num(seen / direction.width)


def _alike(a: Frame, b: Frame) -> bool:
    return bool(np.array_equal(a[0], b[0]) and np.array_equal(a[1].as_quat(), b[1].as_quat()))


def _with_positions(sight: Sight, positions: np.ndarray) -> Sight:
    """One sight with its points at positions on the body [m] ``(n, 3)``."""
    listed = tuple((float(x), float(y), float(z)) for x, y, z in positions)
    return sight.model_copy(update={"points": sight.points.model_copy(update={"positions_m": listed})})


def _shifted(rig: Rig, shifts: Mapping[str, Mapping[int, np.ndarray]], by: float) -> Rig:
    """The rig with points shifted by a multiple of ``shifts`` [m] ``(n, 3)``, by camera and number of the sight."""
    cameras = dict(rig.cameras)
    for name, shift in shifts.items():
        sights = list(cameras[name].sees)
        for index, moved in shift.items():
            sights[index] = _with_positions(sights[index], np.array(sights[index].points.positions_m) + by * moved)
        cameras[name] = cameras[name].model_copy(update={"sees": tuple(sights)})
    return rig.model_copy(update={"cameras": cameras})
