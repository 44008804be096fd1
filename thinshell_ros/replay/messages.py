"""Trajectories to and from ``trajectory_msgs/MultiDOFJointTrajectory``. Needs the message packages, not rclpy."""

from __future__ import annotations

from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Quaternion, Transform, Twist, Vector3
from nav_msgs.msg import Path
from scipy.spatial.transform import Rotation
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from sim_core.errors import ConfigError
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.rigs.yamlfile import validate
from sim_core.trajectories import Trajectory
from thinshell_ros import messages
from thinshell_ros.poses import Floats, Pose

VELOCITY_S = 1e-3
"""Half the interval [s] of the central differences that velocities are taken from."""

PATH_POSES = 1000
"""Poses of a path for viewers, at most."""


def to_message(trajectory: Trajectory) -> MultiDOFJointTrajectory:
    """The poses of all end effectors as transforms of joints of their names, with velocities in the base frame.

    What the message has no place for is left out: rig, limits, predictions, gripper closings.

    Raises:
        ConfigError: the end effectors have different base frames, and the message has one.
    """
    frames = {path.frame_id for path in trajectory.end_effectors.values()}
    if len(frames) > 1:
        raise ConfigError(
            f"The end effectors have the base frames {', '.join(sorted(frames))}, and the message has one frame.",
            "Transform the poses into one frame, or send one message for each.",
        )
    times = trajectory.times_s
    tracks = [(path.sample(times), _velocities(path, times)) for path in trajectory.poses().values()]
    message = MultiDOFJointTrajectory(header=messages.header(0, frames.pop()))
    message.joint_names = list(trajectory.end_effectors)
    for row, time in enumerate(times):
        transforms = [_transform(positions[row], turns[row]) for (positions, turns), _ in tracks]
        twists = [Twist(linear=_vector(v[row]), angular=_vector(w[row])) for _, (v, w) in tracks]
        seconds, rest = divmod(round(float(time) * 1e9), 1_000_000_000)
        message.points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=transforms, velocities=twists, time_from_start=Duration(sec=seconds, nanosec=rest)
            )
        )
    return message


def from_message(message: Any) -> Trajectory:
    """A trajectory of joints that are end effectors; velocities and accelerations of the message are not used.

    Raises:
        ConfigError: something in the message does not fit.
    """
    names = list(message.joint_names)
    points = list(message.points)
    if len(set(names)) < len(names):
        raise ConfigError(f"The message names a joint twice: {', '.join(names)}.", "Name each end effector once.")
    for row, point in enumerate(points):
        if len(point.transforms) != len(names):
            raise ConfigError(
                f"Point {row} of the message has {len(point.transforms)} transforms for {len(names)} joints.",
                "Give one transform for each joint in each point.",
            )
    effectors = {}
    for column, name in enumerate(names):
        transforms = [point.transforms[column] for point in points]
        places, turns = [t.translation for t in transforms], [t.rotation for t in transforms]
        effectors[name] = {
            "frame_id": message.header.frame_id,
            "positions_m": np.reshape([[p.x, p.y, p.z] for p in places], (-1, 3)),
            "quaternions_xyzw": np.reshape([[q.x, q.y, q.z, q.w] for q in turns], (-1, 4)),
            **({} if len(names) == 1 else {f"{kind}_topic": f"{name}/{kind}_pose" for kind in ("target", "current")}),
        }
    times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in points]
    return validate(Trajectory, {"times_s": times, "end_effectors": effectors}, "The message")


def path_of(stamp_ns: int, frame_id: str, path: PoseTrajectory) -> Path:
    """A path for viewers."""
    times = path.times[:: max(1, -(-len(path.times) // PATH_POSES))]
    positions, quaternions = path.sample(times)
    poses = [
        messages.pose(stamp_ns, frame_id, Pose(position, quaternion))
        for position, quaternion in zip(positions, quaternions, strict=True)
    ]
    return Path(header=messages.header(stamp_ns, frame_id), poses=poses)


def _velocities(path: PoseTrajectory, times: Floats) -> tuple[Floats, Floats]:
    """Linear [m/s] and angular [rad/s] velocities in the base frame, each ``(n, 3)``."""
    before = np.clip(times - VELOCITY_S, times[0], times[-1])
    after = np.clip(times + VELOCITY_S, times[0], times[-1])
    (start, first), (end, last) = path.sample(before), path.sample(after)
    spans = (after - before)[:, None]
    turns = (Rotation.from_quat(last) * Rotation.from_quat(first).inv()).as_rotvec()
    return (end - start) / spans, np.asarray(turns / spans)


def _transform(position: Floats, quaternion: Floats) -> Transform:
    x, y, z, w = map(float, quaternion)
    return Transform(translation=_vector(position), rotation=Quaternion(x=x, y=y, z=z, w=w))


def _vector(values: Floats) -> Vector3:
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)
