"""Which topics of a recording belong to which part of a rig, and rigs with less to measure."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from sim_core.errors import ConfigError, nearest_match
from sim_core.rigs import EndEffector, Rig
from sysid.recording import EETopics, SensorTopic, TopicNames
from sysid.recording.joints import JointTopics


def topics_of(rig: Rig, available: Iterable[str]) -> tuple[TopicNames, tuple[str, ...]]:
    """The topic map for reading a recording of a rig, and the rig's topics that the recording lacks.

    A stream that the recording lacks is left out of the map; what is needed, the reader says. What another topic stands
    for (commanded poses next to measured ones, images next to tracks) or the rig itself says (intrinsics) is not
    missed. ``available``: topics of the recording. Names of the rig match in any namespace.
    """
    present = ["/" + topic.strip("/") for topic in available]
    missing: list[str] = []

    def found(topic: str) -> str | None:
        return topic.strip("~") if any(name.endswith("/" + topic.strip("~/")) for name in present) else None

    poses = {}
    for name, effector in rig.end_effectors.items():
        topics = effector.topics
        current, target = found(topics.current_pose), found(topics.target_pose)
        if topics.tf is not None or topics.joints is not None:
            current = None
        elif not current:
            missing.append(topics.current_pose)
        if current or target or topics.tf or topics.joints:
            poses[name] = EETopics(
                current_pose=current,
                target_pose=target,
                tf=topics.tf,
                joints=joints_of(effector),
                length_unit=topics.length_unit,
                quaternion_order=topics.quaternion_order,
            )
    wrenches: dict[str, SensorTopic] = {}
    markers: dict[str, SensorTopic] = {}
    for name, sensor in rig.sensors.items():
        topic = found(sensor.topic)
        if topic is None:
            missing.append(sensor.topic)
            continue
        group = wrenches if sensor.type == "wrench" else markers
        group[name] = SensorTopic(topic=topic, length_unit=sensor.length_unit)
    tracks: dict[str, str] = {}
    infos: dict[str, str] = {}
    images: dict[str, str] = {}
    for name, camera in rig.cameras.items():
        for streams, named in (
            (tracks, camera.topics.marker_tracks),
            (infos, camera.topics.camera_info),
            (images, camera.topics.image),
        ):
            topic = found(named)
            if topic is not None:
                streams[name] = topic
        if name not in tracks:
            missing.append(camera.topics.marker_tracks)
    names = TopicNames(
        ee=poses,
        wrench=wrenches,
        markers=markers,
        tracks=tracks,
        camera_info=infos,
        images=images,
        time=rig.recording_clock,
        columns=rig.table_columns,
    )
    return names, tuple(missing)


def joints_of(effector: EndEffector) -> JointTopics | None:
    """Where the joints of an end effector are recorded, None where its pose is a topic of its own."""
    named = effector.topics.joints
    if named is None:
        return None
    return JointTopics(
        topic=named.topic,
        base=named.base or effector.base_frame,
        tip=named.tip,
        urdf=named.urdf,
        description=named.description,
        angle_unit=named.angle_unit,
        length_unit=named.length_unit,
        max_gap_s=effector.topics.max_gap_s,
    )


def without(rig: Rig, names: Collection[str]) -> Rig:
    """The rig as if it did not have these sensors and cameras. Raises ``ConfigError``."""
    known = [*rig.sensors, *rig.cameras]
    for name in names:
        if name not in known:
            raise ConfigError(
                f"The rig {rig.name!r} has no sensor or camera {name!r} to leave out.", nearest_match(name, known)
            )
    if known and set(known) <= set(names):
        raise ConfigError(f"Nothing that the rig {rig.name!r} measures is left.", "Leave out less.")
    return rig.model_copy(
        update={
            "sensors": {name: sensor for name, sensor in rig.sensors.items() if name not in names},
            "cameras": {name: camera for name, camera in rig.cameras.items() if name not in names},
        }
    )
