"""Where markers are on a sheet, from the first frame of a recording.

Pins and stickers are put on anew for each recording. The sheet is brought to rest between its clamps as
they stand at the first frame that shows any marker, its mesh is projected into the picture, and each marker belongs to
the triangle that it is seen on. A sheet that lies over itself in the picture has no such triangle that is
sure; the one with the marker deepest inside is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim_core.errors import ConfigError, RecordingError
from sim_core.geometry import sheets
from sim_core.rigs import Rig, Sight, marker_positions
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import Scene, build_scene
from sim_core.scene.assembly import world_pose
from sim_core.scene.scene import Frame
from sim_core.sensing.camera import project
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation
from sysid.fit.runs import Measured
from sysid.streams import total_delay

Places = dict[str, tuple[Sight, ...]]


def placed_sights(
    rig: Rig, poses: Mapping[str, PoseTrajectory], measured: Sequence[Measured]
) -> tuple[Places, tuple[str, ...]]:
    """What each camera sees with the markers where the recording first shows them; notes on those it lacks.

    Only cameras with points that are ``placed: first_frame`` are in the result. Raises ``RecordingError``
    when a marker is not seen on its sheet.
    """
    wanted = {
        name: m
        for m in measured
        for name, camera in rig.cameras.items()
        if m.channel == name and any(s.points.placed == "first_frame" for s in camera.sees)
    }
    if not wanted:
        return {}, ()
    scene = build_scene(rig)
    simulation = Simulation(scene)
    notes: list[str] = []
    out: Places = {}
    for name, m in wanted.items():
        shown = int(np.argmax(np.isfinite(m.values).any(axis=1)))
        when = float(m.t[shown]) - total_delay(rig, name, m.kind)
        frames: dict[str, Frame] = {}
        for mount, trajectory in poses.items():
            frames[mount] = frame_of(*trajectory.at(when))
        simulation.reset(frames)
        first = m.values[shown].reshape(-1, 2)
        start, sights = 0, []
        for sight in rig.cameras[name].sees:
            here = first[start : start + sight.points.count]
            start += sight.points.count
            if sight.points.placed == "first_frame":
                sight = _placed(scene, rig, name, sight, here, simulation.frames, notes)
            sights.append(sight)
        out[name] = tuple(sights)
    return out, tuple(notes)


def _placed(
    scene: Scene,
    rig: Rig,
    camera: str,
    sight: Sight,
    pixels: np.ndarray,
    frames: Mapping[str, Frame],
    notes: list[str],
) -> Sight:
    """One sight with its points at ``pixels`` ``(n, 2)``; a point that is not seen stays where it was."""
    body = scene.bodies[sight.body]
    assert isinstance(body.mesh, sheets.SheetMesh)
    local, ids = marker_positions(sight.points, rig.bodies[sight.body])  # type: ignore[arg-type]
    lens = rig.cameras[camera]
    origin, rotation = lens.truly(*world_pose(lens.pose, frames[lens.mount]))
    picture = project(lens, rotation.inv().apply(scene.system.x[body.nodes] - origin))
    seen = sheets.SheetMesh(np.column_stack([picture, np.zeros(len(picture))]), body.mesh.triangles)
    for k, (marker, pixel) in enumerate(zip(ids, pixels, strict=True)):
        if not np.isfinite(pixel).all():
            notes.append(f"{camera}: marker {marker} is not in the first frame; it stays as the rig places it.")
            continue
        try:
            triangle, weights = sheets.locate(seen, pixel[None])
        except ConfigError:
            low, high = np.nanmin(picture, axis=0), np.nanmax(picture, axis=0)
            raise RecordingError(
                f"{camera}: marker {marker} is first seen at {pixel.round(1).tolist()} px, but {sight.body} "
                f"reaches from {low.round(1).tolist()} to {high.round(1).tolist()} px there.",
                "Correct the size or the pose of the sheet, or the scale and the origin of the camera.",
            ) from None
        local[k] = weights[0] @ body.mesh.nodes[body.mesh.triangles[triangle[0]]]
    positions = tuple((float(x), float(y), float(z)) for x, y, z in local)
    return sight.model_copy(update={"points": sight.points.model_copy(update={"positions_m": positions})})
