"""Poses from the positions of joints (``sensor_msgs/msg/JointState``) and the URDF of the robot."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sim_core.errors import RecordingError, nearest_match
from sysid.recording.arrays import Bools, Floats, Ints
from sysid.recording.bag import Bag
from sysid.recording.message_types import JOINTS, TEXT
from sysid.recording.messages import Series, Table, decode, read_table
from sysid.recording.notes import Notes, plural
from sysid.recording.times import TimeSource, order_in_time
from sysid.recording.urdf import SLIDING, TURNING, Chain, Joint, chain_of, joints_of

AngleUnit = Literal["rad", "deg"]
DEGREE = math.pi / 180.0
BEYOND = {**dict.fromkeys(TURNING, 0.1), **dict.fromkeys(SLIDING, 0.01)}
"""How far [rad, m] a position may be beyond the limits of its joint before that is said."""
MANY_TURNS = 8.0 * math.pi
"""Positions [rad] of a joint without limits beyond this look like degrees."""
LARGEST_URDF = 64 * 2**20
"""Bytes."""


@dataclass(frozen=True, kw_only=True)
class JointTopics:
    """Where the joints of an end effector are recorded, and which links of the URDF they move.

    Attributes:
        topic: of the positions of joints.
        base: link in which poses are.
        tip: link that is the end effector.
        urdf: file with the URDF; None: the recording has it on the topic ``description``.
        description: topic of the URDF as text.
        angle_unit: of positions of turning joints. None means rad and refuses what is likely in degrees.
        length_unit: of positions of sliding joints. None means m and refuses what is likely in mm.
        max_gap_s: where a joint that comes in messages of its own pauses for longer [s], there is no pose.
    """

    topic: str
    base: str
    tip: str
    urdf: str | None = None
    description: str = "robot_description"
    angle_unit: AngleUnit | None = None
    length_unit: Literal["m", "mm"] | None = None
    max_gap_s: float = 1.0


def joint_series(bag: Bag, topic: str, named: JointTopics, clock: TimeSource, notes: Notes) -> Series:
    """The pose of the tip in the base at each message with the joint that was published most often.

    Joints that come in other messages are interpolated between these linearly.

    Args:
        bag: the recording.
        topic: its topic of joints.
        named: links, URDF and units.
        clock: of the stamps.
        notes: takes what was repaired or assumed.

    Raises:
        RecordingError: there is no such chain, a joint is missing, or units cannot be trusted.
    """
    text, source = _description(bag, named)
    chain = chain_of(text, named.base, named.tip, source)
    if not chain.leaders:
        raise RecordingError(
            f"{source}: all joints from {named.base!r} to {named.tip!r} are fixed: the pose never changes.",
            "Name the link that the robot moves as `topics.joints.tip` of the end effector.",
        )
    names: set[str] = set()
    table = read_table(topic, JOINTS, bag.messages(topic), lambda m: _positions(m, chain.leaders, names), notes)
    samples = {name: _Samples.of(table, name) for name in chain.leaders}
    for name, found in samples.items():
        if not len(found.message):
            raise RecordingError(
                f"{topic} has no position of the joint {name!r}, which is between {named.base!r} and {named.tip!r} in "
                f"{source}.",
                f"Record it, or name links that the recorded joints move. {nearest_match(name, sorted(names))}",
            )
        found.note_unusable(topic, notes)
    leading = max(chain.leaders, key=lambda name: len(samples[name].message))
    ordered = _in_order(topic, table, samples, leading, clock, notes)
    kept, times_ns = ordered[leading]
    by_name = {joint.name: joint for joint in _moving(chain, text, source)}
    positions, inside = {}, np.ones(len(times_ns), dtype=bool)
    for name, found in samples.items():
        own = _in_si(topic, by_name[name], found.values, named, notes)
        place, at_ns = ordered[name]
        values, known = _at(own[place], at_ns, times_ns, by_name[name], named.max_gap_s)
        positions[name] = values
        inside &= known
    if not inside.any():
        raise RecordingError(
            f"{topic}: the joints {', '.join(chain.leaders)} were never published within {named.max_gap_s:g} s of each "
            "other.",
            "Record while the drivers of all joints run, or raise `topics.max_gap_s` of the end effector.",
        )
    if not inside.all():
        notes.warning(
            topic,
            f"{plural(int((~inside).sum()), 'pose')} left out: a joint of the chain has no position within "
            f"{named.max_gap_s:g} s (max_gap_s) before or after",
        )
    tip_m, turn = chain.poses({name: values[inside] for name, values in positions.items()})
    digest = hashlib.sha256(text.encode()).hexdigest()[:12]
    notes.info(
        topic, f"poses of {named.tip!r} in {named.base!r} from {', '.join(chain.leaders)} and {source} ({digest})"
    )
    rows = [tuple(row) for row in np.hstack([tip_m, turn.as_quat()]).tolist()]
    messages = table.source.take(samples[leading].message[kept[inside]])
    return Series(f"{topic} ({named.base} to {named.tip})", named.base, messages, rows, times_ns[inside])


@dataclass(frozen=True)
class _Samples:
    """Positions of one joint: ``message``: which rows of the table have it ``(n,)``, ``values`` ``(n,)``; ``unusable``:
    positions that are not finite."""

    name: str
    message: Ints
    values: Floats
    unusable: int

    @classmethod
    def of(cls, table: Table, name: str) -> _Samples:
        having = [(k, row[name]) for k, row in enumerate(table.rows) if name in row]
        usable = [(k, value) for k, value in having if math.isfinite(value)]
        return cls(
            name,
            np.array([k for k, _ in usable], dtype=np.int64),
            np.array([value for _, value in usable], dtype=np.float64),
            len(having) - len(usable),
        )

    def note_unusable(self, topic: str, notes: Notes) -> None:
        if self.unusable:
            notes.warning(topic, f"{plural(self.unusable, 'position')} of {self.name!r} that are not finite left out")


def _positions(message: Any, wanted: tuple[str, ...], names: set[str]) -> dict[str, float]:
    """Positions of the joints that are wanted. ``names``: takes the names of all that have one."""
    if len(message.position) != len(message.name):
        raise ValueError(f"has {len(message.position)} positions of {len(message.name)} joints")
    names.update(message.name)
    return {name: float(q) for name, q in zip(message.name, message.position, strict=True) if name in wanted}


def description_topics(bag: Bag, named: JointTopics) -> list[str]:
    """Topics of a recording that may hold the URDF; none where a file does."""
    absolute = "/" + named.description.strip("/")
    fit = [t.name for t in bag.topics.values() if t.name.endswith(absolute) and t.msgtypes == (TEXT,) and t.count]
    return fit if named.urdf is None else []


def _description(bag: Bag, named: JointTopics) -> tuple[str, str]:
    """The URDF, and where it is from."""
    if named.urdf is not None:
        path = Path(named.urdf)
        try:
            if path.stat().st_size > LARGEST_URDF:
                raise RecordingError(f"{path} is larger than {LARGEST_URDF} bytes.", "Give the URDF of the robot.")
            return path.read_text(encoding="utf-8"), str(path)
        except (OSError, UnicodeDecodeError) as error:
            why = getattr(error, "strerror", None) or "it is no text"
            raise RecordingError(
                f"The URDF {path} cannot be read: {why}.",
                "Correct `topics.joints.urdf` of the end effector in the rig.",
            ) from None
    texts = {
        str(decode(data, TEXT).data): topic
        for topic in description_topics(bag, named)
        for data in bag.messages(topic).payloads()
        if data
    }
    if not texts:
        raise RecordingError(
            f"{bag.path} has no URDF: no message of {named.description} ({TEXT}).",
            "Write `urdf: robot.urdf` under `topics.joints` of the end effector in the rig, or record the topic, which "
            "is latched.",
        )
    if len(texts) > 1:
        raise RecordingError(
            f"{bag.path} has {len(texts)} different URDFs on {', '.join(sorted(set(texts.values())))}.",
            "Name the topic of the right one as `topics.joints.description`, or a file as `topics.joints.urdf`.",
        )
    ((text, name),) = texts.items()
    return text, f"the URDF of {name}"


def _moving(chain: Chain, text: str, source: str) -> list[Joint]:
    """The joints of the chain, and those that they mimic and that are not on it."""
    lacking = set(chain.leaders) - {joint.name for joint in chain.joints}
    return [*chain.joints, *(joint for joint in joints_of(text, source)[0] if joint.name in lacking)]


def _in_order(
    topic: str, table: Table, samples: Mapping[str, _Samples], leading: str, clock: TimeSource, notes: Notes
) -> dict[str, tuple[Ints, Ints]]:
    """By joint, which of its samples count, in order of time, and their times [ns]."""
    found: dict[str, tuple[Ints, Ints]] = {}
    seen: dict[bytes, tuple[Ints, Ints]] = {}
    for name in (leading, *(other for other in samples if other != leading)):
        index = samples[name].message
        key = index.tobytes()
        if key not in seen:
            words = topic if not seen else f"{topic} ({name})"
            seen[key] = order_in_time(words, table.stamps_ns[index], table.source.log_ns[index], clock, notes)
        found[name] = seen[key]
    return found


def _at(values: Floats, own_ns: Ints, at_ns: Ints, joint: Joint, max_gap_s: float) -> tuple[Floats, Bools]:
    """Positions at other instants, and where they are known: between samples that are no farther apart than the gap."""
    if np.array_equal(own_ns, at_ns):
        return values, np.ones(len(at_ns), dtype=bool)
    if joint.type == "continuous":
        values = np.unwrap(values)  # drivers may write it between -pi and pi
    after = np.searchsorted(own_ns, at_ns)
    inside = (at_ns >= own_ns[0]) & (at_ns <= own_ns[-1])
    after = np.clip(after, 0, len(own_ns) - 1)
    before = np.clip(after - 1, 0, len(own_ns) - 1)
    near = (own_ns[after] - own_ns[before] <= 1e9 * max_gap_s) | (own_ns[after] == at_ns)
    start = int(at_ns[0])
    return np.interp(1e-9 * (at_ns - start), 1e-9 * (own_ns - start), values), inside & near


def _in_si(topic: str, joint: Joint, values: Floats, named: JointTopics, notes: Notes) -> Floats:
    """Positions in rad or m, which are compared with the limits of the joint."""
    turns = joint.type in TURNING
    declared, other, factor = (named.angle_unit, "deg", DEGREE) if turns else (named.length_unit, "mm", 1e-3)
    unit, key = ("rad", "angle_unit") if turns else ("m", "length_unit")
    if declared == other:
        values = values * factor
    least, most = float(values.min()), float(values.max())
    lower, upper = joint.lower, joint.upper
    if not math.isfinite(upper - lower) or lower >= upper:
        lower, upper = (-MANY_TURNS, MANY_TURNS) if turns else (-math.inf, math.inf)
    slack = BEYOND[joint.type]

    def fits(a: float, b: float) -> bool:
        return a >= lower - slack and b <= upper + slack

    if fits(least, most):
        return values
    words = f"positions of the joint {joint.name!r} reach from {least:.4g} to {most:.4g} {unit}"
    bound = f"its limits are {lower:.4g} and {upper:.4g} {unit}"
    if declared is None and fits(factor * least, factor * most):
        raise RecordingError(
            f"{topic}: {words}, and {bound}; in {other} they would fit.",
            f"Write `{key}: {other}` under `topics.joints` of the end effector in the rig, or `{key}: {unit}` if they "
            "are right.",
        )
    notes.warning(topic, f"{words}, and {bound}: another robot, or another unit (`{key}` under `topics.joints`)")
    return values
