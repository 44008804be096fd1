"""Which topic plays which role: what a rig declares, and what is found by itself."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, TypeAlias

from sim_core.errors import RecordingError, nearest_match
from sysid.recording.bag import TopicInfo
from sysid.recording.joints import JointTopics
from sysid.recording.message_types import CAMERA_INFO, ROLES
from sysid.recording.notes import Notes
from sysid.recording.times import TimeSource

LengthUnit = Literal["m", "mm"]
QuaternionOrder = Literal["xyzw", "wxyz"]


@dataclass(frozen=True, kw_only=True)
class EETopics:
    """Pose topics of one end effector.

    Attributes:
        current_pose: measured pose; None looks for ``.../current_pose``.
        target_pose: commanded pose; None looks for ``.../target_pose``.
        tf: parent and child frame whose transform is the measured pose, in place of a topic of its own.
        joints: joints by whose positions a URDF tells the measured pose, likewise.
        frame_id: the frame that the poses must be in; None accepts the one found.
        length_unit: unit of the positions. None means metres and refuses what cannot be metres.
        quaternion_order: order of the four numbers in x, y, z, w. None means x y z w and refuses what
            is likely w-first.
    """

    current_pose: str | None = None
    target_pose: str | None = None
    tf: tuple[str, str] | None = None
    joints: JointTopics | None = None
    frame_id: str | None = None
    length_unit: LengthUnit | None = None
    quaternion_order: QuaternionOrder | None = None


@dataclass(frozen=True, kw_only=True)
class SensorTopic:
    """Topic of a wrench sensor or of a marker cloud.

    Attributes:
        topic: its name; None looks for the name of the contract.
        frame_id: the frame that the messages must be in; None accepts the one found.
        length_unit: unit of marker positions, and of the length in torques (N mm). None means metres.
    """

    topic: str | None = None
    frame_id: str | None = None
    length_unit: LengthUnit | None = None


Sensor: TypeAlias = "SensorTopic | str | None"


@dataclass(frozen=True, kw_only=True)
class TopicNames:
    """Roles by the rig's own names. Topic names are relative and match in any namespace.

    A value of None looks for the contract's name: with one key the only candidate is taken, with several
    keys the candidate that has the key in its namespace (``left`` takes ``/tactile/left/markers``).

    Attributes:
        ee: end effectors.
        wrench: wrench sensors.
        markers: 3-D marker clouds, by sensor.
        tracks: image-plane tracks, by camera.
        camera_info: by camera; a camera not named here takes the one in its own namespace.
        images: raw or compressed images, by camera.
        time: clock of all streams, 'header' (stamps) or 'log' (time of recording).
        columns: by names of columns of tables, what they are, as ``wrench.force_z [mN]``.
    """

    ee: Mapping[str, EETopics] = field(default_factory=lambda: {"ee": EETopics()})
    wrench: Mapping[str, Sensor] = field(default_factory=lambda: {"sensor": None})
    markers: Mapping[str, Sensor] = field(default_factory=lambda: {"sensor": None})
    tracks: Mapping[str, str | None] = field(default_factory=lambda: {"camera": None})
    camera_info: Mapping[str, str | None] = field(default_factory=dict)
    images: Mapping[str, str | None] = field(default_factory=lambda: {"camera": None})
    time: TimeSource = "header"
    columns: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TopicNames:
        """Build from plain data, as a rig file holds it.

        Raises:
            RecordingError: a key or a value is not known.
        """
        _known_keys(data, [f.name for f in fields(cls)], "topics")
        values: dict[str, Any] = {}
        for role, entries in data.items():
            if role == "time":
                values[role] = _one_of(entries, ("header", "log"), "topics.time")
                continue
            if role == "columns" and isinstance(entries, Mapping):
                values[role] = {str(name): str(meaning) for name, meaning in entries.items()}
                continue
            if not isinstance(entries, Mapping):
                raise RecordingError(
                    f"topics.{role} is {entries!r}.", f"Give names and topics, e.g. {role}: {{name: /topic}}."
                )
            part: type[EETopics] | type[SensorTopic] = EETopics if role == "ee" else SensorTopic
            values[role] = {
                str(name): _entry(part, value, f"topics.{role}.{name}", role) for name, value in entries.items()
            }
        return cls(**values)


def sensor_topic(value: Sensor) -> SensorTopic:
    """Return the long form of a sensor's declaration."""
    return value if isinstance(value, SensorTopic) else SensorTopic(topic=value)


def resolve(role: str, wanted: Mapping[str, str | None], bag: Mapping[str, TopicInfo], notes: Notes) -> dict[str, str]:
    """Find the topic of each name in one role.

    Args:
        role: key of ``ROLES``.
        wanted: topic per name, None to look for it.
        bag: the topics of the recording.
        notes: takes what was assumed.

    Returns:
        Topic per name; names without a topic are absent.

    Raises:
        RecordingError: a named topic is absent or of a wrong type, or the choice is not unique.
    """
    found = {name: _named(role, topic, bag, notes) for name, topic in wanted.items() if topic is not None}
    open_names = [name for name, topic in wanted.items() if topic is None]
    if open_names:
        candidates = [t for t in _candidates(role, bag, notes) if t not in found.values()]
        for name in open_names:
            mine = candidates
            if len(open_names) > 1 or len(candidates) > 1:
                mine = [t for t in candidates if name in t.split("/")[:-1]]
            if len(mine) > 1 or (len(open_names) == 1 and candidates and not mine):
                choice = mine or candidates
                entry = f"{role}: {{{name}: {choice[0]}}}"
                if role.endswith("_pose"):
                    entry = f"ee: {{{name}: {{{role}: {choice[0]}}}}}"
                raise RecordingError(
                    f"{role} of {name!r} may be any of: {', '.join(choice)}.",
                    f"Name the topic in the rig (--rig), or in a `TopicNames`, e.g. {entry}.",
                )
            if mine:
                found[name] = mine[0]
        lost = [t for t in candidates if t not in found.values()]
        if lost and len(open_names) > 1:
            notes.warning(role, f"no name of the rig matches {', '.join(lost)}: not used")
    return found


def camera_info_topic(
    camera: str,
    declared: Mapping[str, str | None],
    siblings: Iterable[str],
    only_camera: bool,
    bag: Mapping[str, TopicInfo],
    notes: Notes,
) -> str | None:
    """Find the camera_info of a camera: as declared, else in the namespace of its other topics, else the only one."""
    topic = declared.get(camera)
    if topic is not None:
        return _named("camera_info", topic, bag, notes)
    for other in siblings:
        for suffix in ("marker_tracks", *ROLES["images"][0]):
            if other.strip("/").endswith(suffix):
                near = "/" + (other.strip("/").removesuffix(suffix) + "camera_info")
                if near in bag and bag[near].msgtypes == (CAMERA_INFO,):
                    return near
    everywhere = _candidates("camera_info", bag, notes)
    return everywhere[0] if only_camera and len(everywhere) == 1 else None


def _named(role: str, name: str, bag: Mapping[str, TopicInfo], notes: Notes) -> str:
    absolute = "/" + name.strip("/")
    matches = [absolute] if absolute in bag else [t for t in bag if t.endswith(absolute)]
    if not matches:
        near = nearest_match(absolute, bag) if bag else ""
        everything = "" if near.startswith("Known") else f" Topics in the recording: {', '.join(sorted(bag))}."
        raise RecordingError(f"Topic {absolute} ({role}) is not in the recording.", near + everything)
    if len(matches) > 1:
        raise RecordingError(
            f"Topic {name} ({role}) is in more than one namespace: {', '.join(matches)}.",
            "Give the full name.",
        )
    topic = matches[0]
    fault = _unfit(role, bag[topic])
    if fault:
        raise RecordingError(f"Topic {topic} {fault}.", f"Name another topic for {role}, or record it as that type.")
    if topic != absolute:
        notes.info(topic, f"taken for {name}")
    return topic


def _candidates(role: str, bag: Mapping[str, TopicInfo], notes: Notes) -> list[str]:
    suffixes = ROLES[role][0]
    named = [t for t in bag if any(("/" + t.lstrip("/")).endswith("/" + s) for s in suffixes)]
    fit = []
    for topic in named:
        fault = _unfit(role, bag[topic])
        if fault:
            notes.warning(topic, f"not used for {role}: it {fault}")
        elif bag[topic].count:
            fit.append(topic)
    if role == "images":
        twins = [t for t in fit if t.endswith("/compressed") and t.removesuffix("/compressed") in fit]
        for twin in twins:
            notes.info(twin, "not used: the raw image is in the recording")
        fit = [t for t in fit if t not in twins]
    return fit


def _unfit(role: str, topic: TopicInfo) -> str:
    """Return what makes a topic unfit for a role, '' if nothing."""
    types = ROLES[role][1]
    if len(topic.msgtypes) > 1 or topic.msgtypes[0] not in types:
        return f"is of type {' and '.join(topic.msgtypes)} where {role} needs {' or '.join(types)}"
    if topic.encodings != ("cdr",):
        return f"is encoded as {' and '.join(topic.encodings)} where only cdr can be read"
    return ""


def _known_keys(data: Mapping[str, Any], known: list[str], where: str) -> None:
    for key in data:
        if key not in known:
            raise RecordingError(f"{where} has no entry {key!r}.", nearest_match(str(key), known))


def _one_of(value: Any, choices: tuple[str, ...], where: str) -> Any:
    if value not in choices:
        raise RecordingError(f"{where} is {value!r}.", f"Use one of: {', '.join(choices)}.")
    return value


def _entry(part: type[EETopics] | type[SensorTopic], value: Any, where: str, role: str) -> Any:
    if value is None:
        return EETopics() if part is EETopics else None
    if isinstance(value, str) and part is SensorTopic:
        return value
    if not isinstance(value, Mapping) or role not in ("ee", "wrench", "markers"):
        raise RecordingError(f"{where} is {value!r}.", "Give the name of a topic.")
    _known_keys(value, [f.name for f in fields(part)], where)
    for key, item in value.items():
        if key == "length_unit":
            _one_of(item, ("m", "mm"), f"{where}.{key}")
        elif key == "tf":
            if not (item is None or (isinstance(item, list | tuple) and len(item) == 2)):
                raise RecordingError(f"{where}.{key} is {item!r}.", "Give two frames, as in [base_link, tool0].")
            value = {**value, key: None if item is None else tuple(map(str, item))}
        elif key == "joints" and isinstance(item, Mapping):
            _known_keys(item, [f.name for f in fields(JointTopics)], f"{where}.{key}")
            lacking = [name for name in ("topic", "base", "tip") if name not in item]
            if lacking:
                raise RecordingError(f"{where}.{key} has no {lacking[0]}.", "Give topic, base and tip.")
            value = {**value, key: JointTopics(**item)}
        elif key == "quaternion_order":
            _one_of(item, ("xyzw", "wxyz"), f"{where}.{key}")
        elif item is not None and not isinstance(item, str):
            raise RecordingError(f"{where}.{key} is {item!r}.", "Give text.")
    return part(**value)
