"""How large a rig is, and where its markers are, before anything moves or sags."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim_core.rigs import MarkerSensor, Rig, Rigid, marker_positions
from sim_core.rigs.bodies import WORLD
from sim_core.sensing.camera import project
from sysid.recording import Recording

if TYPE_CHECKING:
    from sim_core.scene.scene import Frame


def extent_of(rig: Rig) -> float:
    """Largest distance [m] between bodies, starts of end effectors and frames of sensors, at least 0.05 m."""
    places = [np.zeros(3)] if not rig.end_effectors else []
    for effector in rig.end_effectors.values():
        places.append(np.array(effector.start.position_m))
    frames = _starts(rig)
    for body in rig.bodies.values():
        places.append(body.pose.within(frames[getattr(body, "mount", WORLD) or WORLD])[0])
    for sensor in rig.sensors.values():
        places.append(np.array(sensor.pose.position_m))
    points = np.array(places)
    return max(0.05, float(np.linalg.norm(np.ptp(points, axis=0))))


def expected_markers(rig: Rig, name: str, recording: Recording) -> np.ndarray | None:
    """Where the rig has the markers of a sensor [m] ``(m, 3)`` or camera [px] ``(m, 2)``, undeformed, when the end
    effectors are at their first poses; None where that is not in the rig (``placed: first_frame``)."""
    from scipy.spatial.transform import Rotation

    frames = _starts(rig)
    for effector, stream in recording.poses.items():
        if effector in frames and len(stream):
            frames[effector] = stream.position[0], Rotation.from_quat(stream.quaternion[0])
    bodies = {n: b for n, b in rig.bodies.items() if not isinstance(b, Rigid)}
    if name in rig.sensors:
        sensor = rig.sensors[name]
        assert isinstance(sensor, MarkerSensor)
        local = marker_positions(sensor.points, bodies[sensor.body])[0]
        return np.asarray(sensor.pose.rotation().inv().apply(local - np.array(sensor.pose.position_m)))
    camera = rig.cameras[name]
    if any(sight.points.placed == "first_frame" for sight in camera.sees):
        return None
    origin, rotation = camera.truly(*camera.pose.within(frames[camera.mount]))
    seen = []
    for sight in camera.sees:
        body = bodies[sight.body]
        local = marker_positions(sight.points, body)[0]
        at, turn = body.pose.within(frames[getattr(body, "mount", WORLD) or WORLD])
        seen.append(project(camera, rotation.inv().apply(turn.apply(local) + at - origin)))
    return np.vstack(seen)


def on_body(rig: Rig, name: str) -> np.ndarray | None:
    """Where the markers that a camera sees are on their body, undeformed, in its own frame [m] ``(m, 3)``; None where
    they are on several."""
    sights = rig.cameras[name].sees
    body = rig.bodies[sights[0].body] if len(sights) == 1 else None
    return None if body is None or isinstance(body, Rigid) else marker_positions(sights[0].points, body)[0]


def _starts(rig: Rig) -> dict[str, Frame]:
    """Frames of the mounts at the start."""
    from scipy.spatial.transform import Rotation

    frames: dict[str, Frame] = {WORLD: (np.zeros(3), Rotation.identity())}
    for name, effector in rig.end_effectors.items():
        frames[name] = (np.array(effector.start.position_m), effector.start.rotation())
    return frames
