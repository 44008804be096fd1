"""A bag on disk to a ``Recording``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from sim_core.errors import RecordingError
from sysid.recording import clouds, poses, sensors
from sysid.recording.bag import Bag, open_bag
from sysid.recording.events import event_topics, read_events, with_one_zero
from sysid.recording.files import sha256
from sysid.recording.images import ImageStream
from sysid.recording.joints import description_topics, joint_series
from sysid.recording.message_types import JOINTS
from sysid.recording.messages import Series, read_series
from sysid.recording.notes import Notes, plural
from sysid.recording.recording import FileRecord, Provenance, Recording
from sysid.recording.streams import CameraInfo, PoseStream
from sysid.recording.tf import tf_series, tf_topics
from sysid.recording.topics import EETopics, TopicNames, camera_info_topic, resolve, sensor_topic

_CONTENT: dict[str, Callable[[Any], Any]] = {
    "current_pose": poses.pose_content,
    "target_pose": poses.pose_content,
    "wrench": sensors.wrench_content,
    "markers": clouds.marker_content,
    "tracks": clouds.track_content,
    "images": lambda message: None,
}
_MEASUREMENTS = ("wrench", "markers", "tracks", "images")


def read_recording(path: str | Path, topics: TopicNames | None = None, *, need_pose: bool = True) -> Recording:
    """Read a recording that follows the bag contract, or that ``topics`` maps onto it.

    Args:
        path: a rosbag2 directory, a directory of splits, one .mcap, .db3 or .bag file, or tables (.csv).
        topics: the rig's topic names; None finds the names of the contract in any namespace.
        need_pose: refuse a recording without the pose of an end effector.

    Returns:
        The recording; its ``notes`` say what was repaired or assumed.

    Raises:
        RecordingError: the recording cannot be read, or does not hold what is needed.
    """
    names = TopicNames() if topics is None else topics
    notes = Notes()
    bag = open_bag(Path(path), notes, names.columns)
    roles = _roles(names, bag, notes)
    by_tf = {name: ee.tf for name, ee in names.ee.items() if ee.tf is not None}
    by_joints = {name: ee.joints for name, ee in names.ee.items() if ee.joints is not None}
    joints = resolve("joints", {name: one.topic for name, one in by_joints.items()}, bag.topics, notes)
    _check_needed(bag, roles, need_pose and not (by_tf or by_joints))
    series = {
        (role, name): _series(role, name, topic, names, bag, notes)
        for role, found in roles.items()
        for name, topic in found.items()
    }
    for name, (base, child) in by_tf.items():
        series[("current_pose", name)] = tf_series(bag, base, child, names.time, notes)
    for name, chain in by_joints.items():
        series[("current_pose", name)] = joint_series(bag, joints[name], chain, names.time, notes)
    _refuse_latched_only(bag, series)
    t0_ns = min(int(one.times_ns[0]) for one in series.values())
    _note_clocks(series, t0_ns, notes)

    def of(role: str) -> dict[str, Series]:
        return {name: one for (r, name), one in series.items() if r == role}

    calibrations = _camera_topics(names, bag, roles, notes)
    cameras = {
        camera: None if topic is None else _calibration(topic, bag, topics is not None, notes)
        for camera, topic in calibrations.items()
    }
    targets = {name: poses.pose_stream(s, names.ee[name], t0_ns, notes) for name, s in of("target_pose").items()}
    measured = {
        name: poses.pose_stream(s, _as_computed(names.ee[name]), t0_ns, notes) for name, s in of("current_pose").items()
    }
    events = read_events(bag, t0_ns, names.time, notes)
    wrenches, tared = {}, {}
    for name, one in of("wrench").items():
        stream = sensors.wrench_stream(one, sensor_topic(names.wrench[name]), t0_ns, notes)
        wrenches[name], tared[name] = with_one_zero(stream, events, notes)
    recording = Recording(
        poses=_inputs(names, measured, targets, notes),
        target_poses=targets,
        wrenches=wrenches,
        markers={
            name: clouds.marker_stream(s, sensor_topic(names.markers[name]), t0_ns, notes)
            for name, s in of("markers").items()
        },
        tracks={name: clouds.track_stream(s, cameras[name], t0_ns, notes) for name, s in of("tracks").items()},
        images=_images(
            of("images"), bag, cameras, t0_ns, any(roles[role] for role in ("wrench", "markers", "tracks")), notes
        ),
        notes=(),
        provenance=_provenance(bag, t0_ns),
        events=events,
        tared=tared,
    )
    used = {topic for found in roles.values() for topic in found.values()}
    used |= {topic for topic in calibrations.values() if topic}
    used |= set(tf_topics(bag)) if by_tf else set()
    used |= {*joints.values(), *(topic for one in by_joints.values() for topic in description_topics(bag, one))}
    used |= set(event_topics(bag))
    _note_unused(bag, used, notes)
    return replace(recording, notes=notes.collected())


def _as_computed(declared: EETopics) -> EETopics:
    """What is declared of a measured pose: one that joints tell is in m and x y z w, whatever commanded poses are."""
    return declared if declared.joints is None else replace(declared, length_unit="m", quaternion_order="xyzw")


def _roles(names: TopicNames, bag: Bag, notes: Notes) -> dict[str, dict[str, str]]:
    """Return topic by name for every role but camera_info."""
    wanted: dict[str, Mapping[str, str | None]] = {
        "current_pose": {name: ee.current_pose for name, ee in names.ee.items() if not (ee.tf or ee.joints)},
        "target_pose": {name: ee.target_pose for name, ee in names.ee.items()},
        "wrench": {name: sensor_topic(value).topic for name, value in names.wrench.items()},
        "markers": {name: sensor_topic(value).topic for name, value in names.markers.items()},
        "tracks": names.tracks,
        "images": names.images,
    }
    return _without_unneeded({role: _resolved(role, topics, bag, notes) for role, topics in wanted.items()}, bag, notes)


def _resolved(role: str, topics: Mapping[str, str | None], bag: Bag, notes: Notes) -> dict[str, str]:
    """Topic by name; images of a type that cannot be read are left out where the rig has something else to say."""
    try:
        return resolve(role, topics, bag.topics, notes)
    except RecordingError as error:
        if role != "images" or not any(topics.values()):
            raise
        notes.warning("images", f"not used: {error.problem}")
        return {}


def _without_unneeded(roles: dict[str, dict[str, str]], bag: Bag, notes: Notes) -> dict[str, dict[str, str]]:
    """Roles without topics that hold no message and are not needed: images, and commanded poses where there are
    measured ones."""
    kept = {role: dict(found) for role, found in roles.items()}
    for role, name, topic in [(r, n, t) for r, found in roles.items() for n, t in found.items()]:
        spare = role == "images" or (role == "target_pose" and name in roles["current_pose"])
        if spare and not bag.topics[topic].count:
            notes.warning(topic, f"holds no message: not used for {role}")
            del kept[role][name]
    return kept


def _calibration(topic: str, bag: Bag, of_rig: bool, notes: Notes) -> CameraInfo | None:
    """What a camera_info says; with a rig, which has intrinsics of its own, one that cannot be used is left out."""
    try:
        return sensors.read_camera_info(topic, bag.messages(topic), notes)
    except RecordingError as error:
        if not of_rig:
            raise
        notes.warning(topic, f"not compared with the rig: {error.problem}")
        return None


def _images(
    series: Mapping[str, Series],
    bag: Bag,
    cameras: Mapping[str, CameraInfo | None],
    t0_ns: int,
    optional: bool,
    notes: Notes,
) -> dict[str, ImageStream]:
    """Image streams by camera. ``optional``: there are other measurements, so that images that cannot be decoded are no
    reason to stop."""
    found = {}
    for name, one in series.items():
        try:
            found[name] = sensors.image_stream(one, bag.topics[one.topic].msgtypes[0], cameras[name], t0_ns, notes)
        except RecordingError as error:
            if not optional:
                raise
            notes.warning(one.topic, f"not used: {error.problem}")
    return found


def _check_needed(bag: Bag, roles: Mapping[str, Mapping[str, str]], need_pose: bool) -> None:
    listing = ", ".join(f"{t.name} ({' or '.join(t.msgtypes)}, {t.count})" for t in bag.topics.values())
    if not any(roles[role] for role in _MEASUREMENTS):
        raise RecordingError(
            f"{bag.path} holds no measurement: no wrench, markers, marker_tracks or image topic was found.",
            f"Name the topics in the rig (--rig). Topics in the recording: {listing}.",
        )
    if need_pose and not (roles["current_pose"] or roles["target_pose"]):
        joints = any(topic.msgtypes == (JOINTS,) for topic in bag.topics.values())
        remedy = "Name the links that its joints move in the rig, as `topics.joints: {base: LINK, tip: LINK}`"
        raise RecordingError(
            f"{bag.path} holds no pose of an end effector: no current_pose or target_pose topic was found.",
            f"{remedy if joints else 'Name the topic in the rig, in `topics`'} of the end effector. Topics in the "
            f"recording: {listing}.",
        )


def _series(role: str, name: str, topic: str, names: TopicNames, bag: Bag, notes: Notes) -> Series:
    frame_id = None
    if role.endswith("_pose"):
        frame_id = names.ee[name].frame_id
    elif role == "wrench":
        frame_id = sensor_topic(names.wrench[name]).frame_id
    elif role == "markers":
        frame_id = sensor_topic(names.markers[name]).frame_id
    info = bag.topics[topic]
    if not info.count:
        raise RecordingError(
            f"Topic {topic} ({role}) has no messages.", "Record it, or take out of the rig what publishes it."
        )
    series = read_series(topic, info.msgtypes[0], bag.messages(topic), _CONTENT[role], frame_id, names.time, notes,
        framed=not bag.of_tables,
    )  # fmt: skip
    if len(series.rows) == 1:
        notes.warning(topic, "a single message (latched?): taken as constant")
    return series


def _refuse_latched_only(bag: Bag, series: Mapping[tuple[str, str], Series]) -> None:
    if all(len(one.rows) == 1 for one in series.values()):
        listing = ", ".join(sorted(one.topic for one in series.values()))
        raise RecordingError(
            f"{bag.path} holds a single message of each topic ({listing}): latched states, no motion.",
            "Record while the rig moves and the sensors publish.",
        )


def _note_clocks(series: Mapping[tuple[str, str], Series], t0_ns: int, notes: Notes) -> None:
    """Say which streams do not overlap in time with the poses: their clocks cannot agree."""
    pose = next((one for (role, _), one in series.items() if role.endswith("_pose")), None)
    for (role, _), one in series.items():
        if pose is None or role.endswith("_pose"):
            continue
        if one.times_ns[0] > pose.times_ns[-1] or one.times_ns[-1] < pose.times_ns[0]:
            apart = 1e-9 * float(one.times_ns[0] - pose.times_ns[0])
            notes.warning(
                one.topic,
                f"starts {apart:.6g} s after {pose.topic} and never overlaps it: the clocks differ; "
                "`recording_clock: log` in the rig uses the recorder's clock for all",
            )


def _inputs(
    names: TopicNames, measured: dict[str, PoseStream], targets: dict[str, PoseStream], notes: Notes
) -> dict[str, PoseStream]:
    """Return the pose to use as input of each end effector."""
    inputs = {}
    for name in names.ee:
        if name in measured:
            inputs[name] = measured[name]
            if name in targets:
                poses.check_pair(measured[name], targets[name], names.ee[name], notes)
        elif name in targets:
            inputs[name] = targets[name]
            notes.warning(
                targets[name].topic,
                "no measured pose: the commanded pose is the input, which differs from it where the robot lags",
            )
    return inputs


def _camera_topics(
    names: TopicNames, bag: Bag, roles: Mapping[str, Mapping[str, str]], notes: Notes
) -> dict[str, str | None]:
    """Return the camera_info topic of every camera with tracks or images."""
    cameras = list(dict.fromkeys([*roles["tracks"], *roles["images"]]))
    found: dict[str, str | None] = {}
    for camera in cameras:
        siblings = [roles[role][camera] for role in ("tracks", "images") if camera in roles[role]]
        topic = camera_info_topic(camera, names.camera_info, siblings, len(cameras) == 1, bag.topics, notes)
        found[camera] = topic if topic is not None and bag.topics[topic].count else None
        if found[camera] is None and not bag.of_tables:
            notes.warning(siblings[0], f"no camera_info for camera {camera!r}: not calibrated")
    return found


def _provenance(bag: Bag, t0_ns: int) -> Provenance:
    first = min(int(index.log_ns.min()) for index in bag.files if len(index.log_ns))
    last = max(int(index.log_ns.max()) for index in bag.files if len(index.log_ns))
    return Provenance(
        path=str(bag.path),
        files=tuple(FileRecord(index.path.name, sha256(index.path), index.path.stat().st_size) for index in bag.files),
        message_counts={name: topic.count for name, topic in bag.topics.items()},
        topic_types={name: " | ".join(topic.msgtypes) for name, topic in bag.topics.items()},
        duration=(last - first) * 1e-9,
        storage="+".join(sorted({index.storage for index in bag.files})),
        compression=bag.compression,
        t0_ns=t0_ns,
    )


def _note_unused(bag: Bag, used: set[str], notes: Notes) -> None:
    unused = [f"{t.name} ({' | '.join(t.msgtypes)})" for t in bag.topics.values() if t.name not in used]
    if unused:
        notes.info(bag.path.name, f"{plural(len(unused), 'topic')} not used: {', '.join(unused)}")
