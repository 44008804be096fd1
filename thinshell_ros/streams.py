"""What a rig publishes, subscribes to and records: topics, frames, rates, noise. No ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sim_core.contact_wrenches import contact_topic
from sim_core.errors import ConfigError
from sim_core.rigs import MarkerSensor, OrthographicCamera, Rig, Rigid, WrenchSensor

EVENT_TOPIC = "events"
"""Topic of what happens to the readings of a rig: tares, resets, time that stamps leave out."""

Kind = Literal["pose", "wrench", "contact", "markers", "tracks", "mesh"]
"""``contact``: force and torque of a contact, and ``mesh``: where the surface of a body is, which no sensor reads:
without noise and never tared."""


@dataclass(frozen=True)
class Channel:
    """One stream of readings.

    ``name``: of the end effector, sensor, contact or camera. ``latency_s``: a reading of the state at time t is
    stamped t + latency; effects of the rig may add to it. ``noise``: standard deviation of each
    component, in the reading's units, broadcast against it.
    """

    name: str
    kind: Kind
    topic: str
    frame_id: str
    rate_hz: float
    latency_s: float = 0.0
    noise: NDArray[np.float64] | float = 0.0


def channels_of(
    rig: Rig, pose_rate_hz: float, base_frame: str = "", contact_forces: bool = False, mesh_rate_hz: float = 0.0
) -> dict[str, Channel]:
    """The streams of a rig by name: current poses, then sensors, then cameras, then contacts, then meshes.

    ``base_frame``: used in place of the rig's, if not empty. ``contact_forces``: whether contacts are streams, too, at
    the rate of the poses and in their frame; ``mesh_rate_hz``: of the surfaces of bodies that deform or move freely,
    in that frame, 0 for none.
    """
    channels: dict[str, Channel] = {}
    for name, effector in rig.end_effectors.items():
        if effector.topics.length_unit == "mm" or effector.topics.quaternion_order == "wxyz":
            raise ConfigError(
                f"The rig {rig.name!r} declares other pose units than m and x y z w for {name!r}.",
                "Live topics carry m and x y z w: leave length_unit and quaternion_order out of the rig.",
            )
        frame = base_frame or effector.base_frame
        channels[name] = Channel(name, "pose", effector.topics.current_pose, frame, pose_rate_hz)
    for name, sensor in rig.sensors.items():
        if sensor.length_unit == "mm":
            raise ConfigError(
                f"The rig {rig.name!r} declares mm for the readings of {name!r}.",
                "Live topics carry m: leave length_unit out of the rig.",
            )
        frame = sensor.frame_id or name
        common = (sensor.topic, frame, sensor.rate_hz, sensor.latency_s)
        if isinstance(sensor, WrenchSensor):
            spread = np.array([sensor.noise.force_n] * 3 + [sensor.noise.torque_nm] * 3)
            channels[name] = Channel(name, "wrench", *common, spread)
        else:
            channels[name] = Channel(name, "markers", *common, sensor.noise.position_m)
    for name, camera in rig.cameras.items():
        channels[name] = Channel(
            name,
            "tracks",
            camera.topics.marker_tracks,
            camera.frame_id or name,
            camera.rate_hz,
            camera.latency_s,
            camera.noise.position_px,
        )
    frame = base_frame or next((e.base_frame for e in rig.end_effectors.values()), "base_link")
    for contact in rig.contacts if contact_forces else ():
        if len(set(contact.between)) == 2:
            channels[contact.name] = Channel(contact.name, "contact", contact_topic(contact.name), frame, pose_rate_hz)
    for name, body in rig.bodies.items() if mesh_rate_hz else ():
        if not isinstance(body, Rigid):
            topic = mesh_topic(name)
            channels[topic] = Channel(topic, "mesh", topic, frame, mesh_rate_hz)
    return channels


def mesh_topic(body: str) -> str:
    """Topic of the surface of a body."""
    return f"mesh/{body}"


def twist_topic(target_pose: str) -> str:
    """Topic of the commanded velocities of an end effector, next to that of its commanded poses."""
    place, slash, name = target_pose.rpartition("/")
    return f"{place}{slash}{'target_twist' if name == 'target_pose' else f'{name}_twist'}"


def rest_topic(channel: Channel) -> str:
    """Topic of the rest state of a marker channel."""
    return f"{channel.topic}_rest"


@dataclass(frozen=True)
class RecordedTopic:
    """A topic to record. ``expected``: its absence is worth a warning."""

    name: str
    expected: bool = True


def topics_to_record(rig: Rig) -> list[RecordedTopic]:
    """All topics of a rig: what the contract needs is expected; rest states and images are taken along."""
    topics: list[RecordedTopic] = []
    for effector in rig.end_effectors.values():
        joints = effector.topics.joints
        topics += [
            RecordedTopic(effector.topics.target_pose),
            RecordedTopic(effector.topics.current_pose, expected=joints is None),
        ]
        if joints is not None:
            topics += [RecordedTopic(joints.topic), RecordedTopic(joints.description, expected=joints.urdf is None)]
    for sensor in rig.sensors.values():
        topics.append(RecordedTopic(sensor.topic))
        if isinstance(sensor, MarkerSensor):
            topics.append(RecordedTopic(f"{sensor.topic}_rest", expected=False))
    for camera in rig.cameras.values():
        topics.append(RecordedTopic(camera.topics.marker_tracks))
        calibrated = not isinstance(camera, OrthographicCamera)
        topics.append(RecordedTopic(camera.topics.camera_info, expected=calibrated))
        topics.append(RecordedTopic(camera.topics.image, expected=False))
    topics.append(RecordedTopic(EVENT_TOPIC, expected=False))
    return topics
