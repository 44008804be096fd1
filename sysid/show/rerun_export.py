"""A subject as a recording of rerun (extra ``rerun``): what a simulation does and what was measured, on one time line.

world/bodies/NAME                 surfaces of bodies
world/hands/NAME                  frames of mounts
world/cameras/NAME                optical frames
world/markers/NAME/{simulated,measured}    markers in the world [m]
pictures/NAME/{simulated,measured}         points that a camera sees [px]
wrenches/NAME/{force,torque}/{simulated,measured}    [N], [N m], x y z
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sim_core.errors import ConfigError
from sim_core.postprocess.layout import within
from sim_core.rigs import WORLD, MarkerSensor, OrthographicCamera
from sysid.show.style import MARKER, MEASURED, body_colours, rgb
from sysid.show.subject import Subject

TIMELINE = "time"
"""Time since the start of the recording [s]."""

RADIUS = 0.006
"""Radius of markers as a share of the extent of what is simulated."""

COLOURS = {"simulated": MARKER, "measured": MEASURED}


def check_rrd(path: Path) -> None:
    """Whether a recording of rerun can be written there. Raises ``ConfigError``."""
    try:
        import rerun  # noqa: F401
    except ImportError:
        raise ConfigError(
            "A recording of rerun needs rerun-sdk, which is missing.",
            "Install it (pip install 'thinshell_ros[rerun]').",
        ) from None
    if path.suffix != ".rrd":
        raise ConfigError(f"The name {path} does not end with .rrd.", f"Write {path.with_suffix('.rrd')}.")
    if path.exists():
        raise ConfigError(f"{path} exists already.", "Choose another name, or move it away first.")
    if not path.absolute().parent.is_dir():
        raise ConfigError(f"There is no folder {path.absolute().parent}.", "Make it first.")


def write_rrd(subject: Subject, path: Path) -> None:
    """Write a subject to a new ``.rrd`` file.

    Raises:
        ConfigError: rerun-sdk is missing, or the file cannot be written.
    """
    check_rrd(path)
    import rerun as rr

    stream = rr.RecordingStream("thinshell", recording_id=subject.title)
    try:
        stream.save(path, default_blueprint=_views(subject))
    except RuntimeError as error:
        raise ConfigError(f"{path} cannot be written: {error}.", "Name a file in a folder of your own.") from None
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    extent = float(np.ptp(subject.states.positions.reshape(-1, 3), axis=0).max())
    for name, camera in subject.rig.cameras.items():
        if not isinstance(camera, OrthographicCamera):
            stream.log(
                f"world/cameras/{name}",
                rr.Pinhole(
                    resolution=[camera.width_px, camera.height_px], focal_length=[camera.fx_px, camera.fy_px],
                    principal_point=[camera.cx_px, camera.cy_px], image_plane_distance=0.3 * extent,
                ),
                static=True,
            )  # fmt: skip
    for step, time in enumerate(subject.times):
        stream.set_time(TIMELINE, duration=float(time))
        _log_world(stream, subject, step, RADIUS * extent)
        _log_readings(stream, subject, step)
    stream.flush()
    stream.disconnect()


def _views(subject: Subject) -> Any:
    """The scene on the left, and on the right a plot of each wrench and the picture of each camera."""
    import rerun.blueprint as rrb

    plots: list[Any] = [
        rrb.TimeSeriesView(origin=f"wrenches/{name}/force", name=f"{name}: force [N]") for name in subject.wrenches
    ]
    plots += [rrb.Spatial2DView(origin=f"pictures/{name}", name=name) for name in subject.tracks]
    scene = rrb.Spatial3DView(origin="world", name=subject.title)
    return rrb.Blueprint(rrb.Horizontal(scene, rrb.Vertical(*plots), column_shares=[2, 1]) if plots else scene)


def _log_world(stream: Any, subject: Subject, step: int, radius: float) -> None:
    import rerun as rr

    x, frames = subject.states.positions[step], subject.frames[step]
    colours = body_colours(subject.skins)
    for surface in subject.skins:
        mesh = rr.Mesh3D(
            vertex_positions=surface.vertices(subject.layout, x, frames),
            triangle_indices=surface.triangles,
            albedo_factor=_bytes(colours[surface.body]),
        )
        stream.log(f"world/bodies/{surface.body}", mesh)
    placed = {f"hands/{name}": frame for name, frame in frames.items() if name != WORLD}
    placed |= {f"cameras/{name}": subject.layout.camera_frame(c, frames) for name, c in subject.rig.cameras.items()}
    for name, (origin, rotation) in placed.items():
        stream.log(f"world/{name}", rr.Transform3D(translation=origin, quaternion=rotation.as_quat()))
    for name, marks in subject.markers.items():
        shown = {"simulated": marks.positions(x)}
        if marks.measured is not None:
            shown["measured"] = _in_world(subject, name, step)
        for kind, points in shown.items():
            there = points[np.isfinite(points).all(axis=1)]
            stream.log(f"world/markers/{name}/{kind}", rr.Points3D(there, radii=radius, colors=_bytes(COLOURS[kind])))


def _in_world(subject: Subject, name: str, step: int) -> np.ndarray:
    """Measured markers of a sensor in the world [m] ``(m, 3)``."""
    sensor, marks = subject.rig.sensors[name], subject.markers[name]
    assert isinstance(sensor, MarkerSensor) and marks.measured is not None
    body = subject.layout.body_frame(sensor.body, subject.frames[step])
    origin, rotation = within(body, (sensor.pose.position(), sensor.pose.rotation()))
    return np.asarray(origin + rotation.apply(marks.measured[step]))


def _log_readings(stream: Any, subject: Subject, step: int) -> None:
    import rerun as rr

    for kind, wrenches in (("simulated", subject.wrenches), ("measured", subject.measured_wrenches)):
        for name, values in wrenches.items():
            if np.isfinite(values[step]).all():
                stream.log(f"wrenches/{name}/force/{kind}", rr.Scalars(values[step, :3]))
                stream.log(f"wrenches/{name}/torque/{kind}", rr.Scalars(values[step, 3:]))
    for name, marks in subject.tracks.items():
        shown = {"simulated": subject.pixels(name, step)}
        if marks.measured is not None:
            shown["measured"] = marks.measured[step]
        for kind, points in shown.items():
            there = points[np.isfinite(points).all(axis=1)]
            stream.log(f"pictures/{name}/{kind}", rr.Points2D(there, radii=2.0, colors=_bytes(COLOURS[kind])))


def _bytes(colour: str) -> list[int]:
    return [round(255.0 * float(part)) for part in rgb(colour)]
