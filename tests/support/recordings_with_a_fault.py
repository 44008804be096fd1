"""Recordings that are sound but for one thing, made of the project's own example."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import PinholeCamera, config_folder, load_rig
from sysid.recording import RecordingWriter, read_recording

RIG = "card_press"
SOUND = config_folder().parent / "bags" / "press_post"
START_NS = 10**9


@dataclass
class Press:
    """The example as arrays that may be changed: a pose, a wrench, markers of the gel, tracks of the card."""

    pose: SimpleNamespace
    wrench: SimpleNamespace
    markers: SimpleNamespace
    tracks: SimpleNamespace
    info: SimpleNamespace
    late: dict[str, Callable[[np.ndarray], np.ndarray]] = field(default_factory=dict)
    pictures: list[bytes | np.ndarray] = field(default_factory=list)

    @property
    def still(self) -> slice:
        """Readings of the wrench in a rest that is added at the end."""
        return slice(int(np.searchsorted(self.wrench.t, 5.4)), len(self.wrench.t))


def press() -> Press:
    """The example with a rest of 2 s, with noise as before it, behind it."""
    read = read_recording(SOUND)
    (pose,), (wrench,) = read.poses.values(), read.wrenches.values()
    (markers,), (tracks,) = read.markers.values(), read.tracks.values()
    draw = np.random.default_rng(7)

    def longer(t: np.ndarray, values: np.ndarray, sigma: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        step = float(np.median(np.diff(t)))
        count = int(2.0 / step)
        more = values[-1] + sigma * draw.standard_normal((count, *values.shape[1:]))
        return np.concatenate([t, t[-1] + step * np.arange(1, count + 1)]), np.concatenate([values, more])

    camera = load_rig(RIG).cameras["outside"]
    assert isinstance(camera, PinholeCamera)
    t_pose, position = longer(pose.t, pose.position, 0.0)
    t_wrench, values = longer(wrench.t, np.hstack([wrench.force, wrench.torque]), np.repeat([0.002, 1e-5], 3))
    t_markers, places = longer(markers.t, markers.position, 1e-5)
    t_tracks, uv = longer(tracks.t, tracks.uv, 0.1)
    return Press(
        SimpleNamespace(t=t_pose, position=position, quaternion=np.tile([0.0, 0.0, 0.0, 1.0], (len(t_pose), 1))),
        SimpleNamespace(t=t_wrench, values=values, frame=wrench.frame_id),
        SimpleNamespace(t=t_markers, places=places, rest=markers.rest, ids=markers.ids),
        SimpleNamespace(t=t_tracks, uv=uv, ids=tracks.ids),
        SimpleNamespace(K=camera.matrix(), D=np.zeros(5), model="plumb_bob", size=(1280, 720)),
    )


def write(p: Press, path: Path) -> Path:
    """A bag of it. ``late``: by topic, the time of recording [s] of what is stamped at a time [s]."""
    with RecordingWriter(path) as bag:

        def stamped(topic: str, t: float) -> int:
            return START_NS + round(1e9 * float(t))

        def recorded(topic: str, t: float) -> None:
            if topic in p.late:
                log_ns = START_NS + round(1e9 * float(p.late[topic](np.array([t]))[0]))
                bag._index[-1] = (log_ns, *bag._index[-1][1:])

        for t, position, quaternion in zip(p.pose.t, p.pose.position, p.pose.quaternion, strict=True):
            bag.pose("current_pose", stamped("current_pose", t), position, quaternion, "base_link")
            recorded("current_pose", t)
        for t, row in zip(p.wrench.t, p.wrench.values, strict=True):
            bag.wrench("tactile/left/wrench", stamped("wrench", t), row[:3], row[3:], p.wrench.frame)
            recorded("wrench", t)
        rests = np.broadcast_to(p.markers.rest, p.markers.places.shape)
        for t, places, rest in zip(p.markers.t, p.markers.places, rests, strict=True):
            bag.markers("tactile/left/markers", stamped("markers", t), places, rest, p.markers.ids, "tactile_left_gel")
        for t, uv in zip(p.tracks.t, p.tracks.uv, strict=True):
            sure = np.ones(len(p.tracks.ids))
            bag.tracks("outside/marker_tracks", stamped("tracks", t), uv, p.tracks.ids, sure, "outside_optical_frame")
        i = p.info
        bag.camera_info("outside/camera_info", START_NS, i.K, i.D, i.model, *i.size, "outside_optical_frame")
        for k, picture in enumerate(p.pictures):
            bag.image_compressed("outside/image/compressed", START_NS + k * 10**8, picture, "outside_optical_frame")
    return path


# What a recording contradicts of the rig.


def inches(p: Press) -> None:
    p.pose.position /= 0.0254


def inverted(p: Press) -> None:
    """Of a hand that starts turned by 90 degrees; the rig says so (:data:`TURNED`)."""
    p.pose.quaternion[:] = Rotation.from_euler("z", -90.0, degrees=True).as_quat()


def wrong_order(p: Press) -> None:
    x, y, z, w = Rotation.from_euler("z", 90.0, degrees=True).as_quat()
    p.pose.quaternion[:] = [w, x, y, z]


def degrees(p: Press) -> None:
    turn = np.degrees(0.3 * np.sin(2.0 * np.pi * 0.5 * p.pose.t))
    p.pose.quaternion = Rotation.from_rotvec(turn[:, None] * [0.0, 0.0, 1.0]).as_quat()


def gram_force(p: Press) -> None:
    p.wrench.values[:, :3] *= 101.97


def newton_millimetres(p: Press) -> None:
    p.wrench.values[:, 3:] *= 1000.0


def other_frame(p: Press) -> None:
    p.wrench.frame = "ft_sensor"


def binned(p: Press) -> None:
    p.info.size = (640, 360)


def other_lens(p: Press) -> None:
    p.info.K = p.info.K * np.array([[1.3, 1.0, 1.0], [1.0, 1.3, 1.0], [1.0, 1.0, 1.0]])


def fisheye(p: Press) -> None:
    p.info.model, p.info.D = "equidistant", np.array([0.1, 0.01, 0.0, 0.0])


def by_columns(p: Press) -> None:
    """A grid of 9 x 3 that counts along its other axis."""
    p.tracks.uv = p.tracks.uv.reshape(-1, 9, 3, 2).swapaxes(1, 2).reshape(p.tracks.uv.shape)


def flipped(p: Press) -> None:
    p.tracks.uv = [1279.0, 0.0] - p.tracks.uv * [1.0, -1.0]


def numbered_from_one(p: Press) -> None:
    p.tracks.ids = p.tracks.ids + 1


def slow(p: Press) -> None:
    p.wrench.t, p.wrench.values = p.wrench.t[::10], p.wrench.values[::10]


def markers_in_inches(p: Press) -> None:
    p.markers.places, p.markers.rest = p.markers.places / 0.0254, p.markers.rest / 0.0254


def far_start(p: Press) -> None:
    p.pose.position += [1.2, 0.0, 0.4]


# What a recording contradicts of itself.


def two_sources(p: Press) -> None:
    again = p.pose.t + 0.003
    p.pose.t = np.column_stack([p.pose.t, again]).ravel()
    p.pose.position = np.stack([p.pose.position, p.pose.position + [4e-4, 0.0, 0.0]], axis=1).reshape(-1, 3)
    p.pose.quaternion = np.repeat(p.pose.quaternion, 2, axis=0)


def lost_as_minus_one(p: Press) -> None:
    p.tracks.uv[np.random.default_rng(1).random(p.tracks.uv.shape[:2]) < 0.05] = -1.0


def held_when_lost(p: Press) -> None:
    for column in (3, 11, 17):
        p.tracks.uv[60:75, column] = p.tracks.uv[59, column]


def stuck(p: Press) -> None:
    p.wrench.values[120:200] = p.wrench.values[119]


def saturated(p: Press) -> None:
    column = p.wrench.values[:, 2]
    end = 0.6 * np.abs(column).max()
    p.wrench.values[:, 2] = np.clip(column, -end, end)


def exchanged(p: Press) -> None:
    p.tracks.uv[80:, [4, 5]] = p.tracks.uv[80:, [5, 4]]


def renumbered(p: Press) -> None:
    p.tracks.uv[90:] = np.roll(p.tracks.uv[90:], 1, axis=1)


def merged(p: Press) -> None:
    p.tracks.uv[50:90, 7] = p.tracks.uv[50:90, 8]


def jumping_pose(p: Press) -> None:
    p.pose.position[[100, 333]] += [0.0, 0.03, 0.0]


def tared(p: Press) -> None:
    """Pressed at rest, and set to zero there."""
    rest = p.still
    half = (rest.start + rest.stop) // 2
    p.wrench.values[rest.start : half] += [0.0, 0.0, -2.0, 0.01, 0.0, 0.0]
    mean = p.wrench.values[half:].mean(axis=0)
    p.wrench.values[half:] -= mean


def clock_set(p: Press) -> None:
    p.late["wrench"] = lambda t: t + 0.002 + 0.4 * (t > 3.0)


def clock_too_fast(p: Press) -> None:
    p.late["wrench"] = lambda t: t * (1.0 - 0.005)


def coarse(p: Press) -> None:
    p.wrench.values[:, :3] = np.round(p.wrench.values[:, :3] / 0.5) * 0.5


def dark(p: Press) -> None:
    p.pictures = [np.zeros((720, 1280), dtype=np.uint8)] * 3


def broken_picture(p: Press) -> None:
    scene = np.random.default_rng(2).integers(0, 255, (720, 1280)).astype(np.uint8)
    p.pictures = [b"\x89PNG but no more", scene, scene]


def _twice(t: np.ndarray) -> np.ndarray:
    """Times with another one halfway to the next."""
    return np.column_stack([t, t + 0.5 * np.median(np.diff(t))]).ravel()


def tracks_twice(p: Press) -> None:
    p.tracks.t, p.tracks.uv = _twice(p.tracks.t), np.repeat(p.tracks.uv, 2, axis=0)


def markers_twice(p: Press) -> None:
    p.markers.t, p.markers.places = _twice(p.markers.t), np.repeat(p.markers.places, 2, axis=0)


def wrench_twice(p: Press) -> None:
    p.wrench.t, p.wrench.values = _twice(p.wrench.t), np.repeat(p.wrench.values, 2, axis=0)


def poses_twice(p: Press) -> None:
    p.pose.t, p.pose.position = _twice(p.pose.t), np.repeat(p.pose.position, 2, axis=0)
    p.pose.quaternion = np.repeat(p.pose.quaternion, 2, axis=0)


def pictures_in_centiseconds(p: Press) -> None:
    p.tracks.t = np.round(p.tracks.t, 2)


def wrench_in_steps(p: Press) -> None:
    p.wrench.t = 0.04 * np.round(p.wrench.t / 0.04)


def places_at_rest(p: Press) -> None:
    """x, y, z as at rest, and the displacements in addition."""
    p.markers.places, p.markers.rest = (
        np.broadcast_to(p.markers.rest, p.markers.places.shape).copy(),
        2.0 * p.markers.rest - p.markers.places,
    )


def zeroed_displacements(p: Press) -> None:
    rests = np.broadcast_to(p.markers.rest, p.markers.places.shape).copy()
    half = int(np.searchsorted(p.markers.t, 2.5))
    rests[half:] = p.markers.places[half]
    p.markers.rest = rests


def tared_in_motion(p: Press) -> None:
    """Set to zero while it rubs on the post."""
    at = int(np.argmax(np.abs(p.wrench.values[:, 0])))
    p.wrench.values[at:] -= p.wrench.values[at].copy()


TURNED = Rotation.from_euler("z", 90.0, degrees=True)
"""How the hand starts by the rig that :func:`inverted` and :func:`wrong_order` are compared with."""

FAULTS: dict[str, tuple[Callable[[Press], None], ...]] = {
    "length_unit": (inches,),
    "quaternion_order": (wrong_order, inverted),
    "angle_unit": (degrees,),
    "force_unit": (gram_force,),
    "torque_unit": (newton_millimetres,),
    "frame": (other_frame,),
    "picture_size": (binned,),
    "focal_length": (other_lens,),
    "camera_model": (fisheye,),
    "marker_order": (by_columns,),
    "mirrored": (flipped,),
    "marker_numbers": (numbered_from_one,),
    "rate": (slow,),
    "marker_scale": (markers_in_inches,),
    "start_position": (far_start,),
    "two_publishers": (two_sources,),
    "lost_as_a_place": (lost_as_minus_one,),
    "lost_and_repeated": (held_when_lost,),
    "frozen": (stuck,),
    "clipped": (saturated,),
    "markers_exchanged": (exchanged,),
    "markers_renumbered": (renumbered,),
    "markers_coincide": (merged,),
    "pose_spike": (jumping_pose,),
    "tare": (tared, tared_in_motion),
    "clock_step": (clock_set,),
    "clock_drift": (clock_too_fast,),
    "coarse_steps": (coarse,),
    "repeated": (tracks_twice, markers_twice, wrench_twice, poses_twice),
    "coarse_stamps": (pictures_in_centiseconds, wrench_in_steps),
    "markers_at_rest": (places_at_rest,),
    "displacements_zeroed": (zeroed_displacements,),
    "blank_pictures": (dark,),
    "broken_pictures": (broken_picture,),
}
"""Recordings with one thing wrong, by the name of the finding that it is."""
