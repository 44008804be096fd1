"""Where the tip of a serial chain of a URDF is, from the positions of its joints.

The chain is the only way between two links of the tree; what branches off it is not read. Forward kinematics is the
product of the transforms along it (Siciliano et al., Robotics, 2009, section 2.7), for all instants at once.
Libraries were tried: pinocchio brings 400 MB, yourdfpy the meshes of trimesh, and kinpy moves no mimic joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.errors import RecordingError, nearest_match
from sysid.recording.arrays import Floats

TURNING, SLIDING = ("revolute", "continuous"), ("prismatic",)
"""Types of joints that are moved by an angle [rad], and by a length [m]."""


@dataclass(frozen=True)
class Joint:
    """A joint of a URDF.

    ``origin_m`` [m] and ``origin``: its frame in that of the parent link; ``axis``: unit vector in its frame.
    ``leader``: the joint that it follows, by ``multiplier`` and ``offset``, its own name where it follows none.
    ``lower``, ``upper``: limits of its position [rad or m], infinite where it has none.
    """

    name: str
    type: str
    parent: str
    child: str
    origin_m: tuple[float, float, float]
    origin: Rotation
    axis: tuple[float, float, float]
    leader: str
    multiplier: float = 1.0
    offset: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf

    @property
    def moves(self) -> bool:
        """Whether it has a position."""
        return self.type != "fixed"


@dataclass(frozen=True)
class Chain:
    """The joints from the link ``base`` to the link ``tip``; ``towards``: whether each leads to a child."""

    base: str
    tip: str
    joints: tuple[Joint, ...]
    towards: tuple[bool, ...]

    @property
    def leaders(self) -> tuple[str, ...]:
        """The joints whose positions it needs."""
        return tuple(dict.fromkeys(joint.leader for joint in self.joints if joint.moves))

    def poses(self, positions: Mapping[str, Floats]) -> tuple[Floats, Rotation]:
        """Pose of the tip in the frame of the base: positions [m] ``(n, 3)`` and ``n`` orientations.

        Args:
            positions: position [rad or m] ``(n,)`` of each of ``leaders``.
        """
        count = len(next(iter(positions.values()))) if positions else 1
        place, turn = np.zeros((count, 3)), Rotation.identity(count)
        for joint, towards in zip(self.joints, self.towards, strict=True):
            p, r = _moved(joint, positions, count)
            if not towards:
                r = r.inv()
                p = -r.apply(p)
            place, turn = place + turn.apply(p), turn * r
        return place, turn


def _moved(joint: Joint, positions: Mapping[str, Floats], count: int) -> tuple[Floats, Rotation]:
    """Pose of the child link of a joint in its parent link: [m] ``(n, 3)``, and ``n`` orientations."""
    place, turn = np.tile(joint.origin_m, (count, 1)), Rotation.from_quat(np.tile(joint.origin.as_quat(), (count, 1)))
    if not joint.moves:
        return place, turn
    along = np.outer(joint.multiplier * positions[joint.leader] + joint.offset, joint.axis)
    if joint.type in SLIDING:
        return place + turn.apply(along), turn
    return place, turn * Rotation.from_rotvec(along)


def chain_of(text: str, base: str, tip: str, source: str) -> Chain:
    """The chain between two links of a URDF. ``source``: where the text is from, for errors.

    Raises:
        RecordingError: it is no URDF, lacks a link, or has a joint on the chain that cannot be used.
    """
    joints, links = joints_of(text, source)
    for which, link in (("base", base), ("tip", tip)):
        if link not in links:
            raise RecordingError(
                f"{source} has no link {link!r}, which `topics.joints.{which}` of the rig names.",
                nearest_match(link, sorted(links)) if links else "Give the URDF of the robot.",
            )
    if base == tip:
        raise RecordingError(
            f"`topics.joints` of the rig names {base!r} as base and as tip: no joint is between them.",
            "Name the link that is the hand as tip.",
        )
    parents = {joint.child: joint for joint in joints}
    up, down = _to_root(base, parents, source), _to_root(tip, parents, source)
    while up and down and up[-1] is down[-1]:
        up, down = up[:-1], down[:-1]
    root_up = up[-1].parent if up else base
    root_down = down[-1].parent if down else tip
    if root_up != root_down:
        raise RecordingError(
            f"{source} has no chain from the link {base!r} to the link {tip!r}: they are in two trees.",
            "Give the URDF that holds both, or name links of one robot.",
        )
    chain = Chain(base, tip, (*up, *down[::-1]), (False,) * len(up) + (True,) * len(down))
    _check(chain, {joint.name: joint for joint in joints}, source)
    return chain


def joints_of(text: str, source: str) -> tuple[list[Joint], set[str]]:
    """All joints of a URDF and the names of its links. ``source``: where it is from. Raises ``RecordingError``."""
    if "<xacro:" in text:
        raise RecordingError(f"{source} is a xacro file, not a URDF.", "Expand it: xacro FILE > robot.urdf.")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise RecordingError(f"{source} is no XML: {error}.", "Give the URDF of the robot.") from None
    if root.tag != "robot":
        raise RecordingError(f"{source} is no URDF: its root is <{root.tag}>, not <robot>.", "Give the robot's URDF.")
    links = {str(link.get("name")) for link in root.findall("link")}
    joints = [_joint(element, source) for element in root.findall("joint")]
    for what, names in (("name", [j.name for j in joints]), ("child link", [j.child for j in joints])):
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise RecordingError(
                f"{source} has two joints with the {what} {twice[0]!r}.",
                "Each joint needs a name and a child of its own.",
            )
    return joints, links


def _joint(element: ElementTree.Element, source: str) -> Joint:
    name, kind = str(element.get("name")), str(element.get("type"))
    where = f"{source}: the joint {name!r}"
    ends = [element.find(tag) for tag in ("parent", "child")]
    parent, child = (str(end.get("link")) if end is not None else "" for end in ends)
    if not (parent and child):
        raise RecordingError(
            f"{where} names no parent or no child link.", "Write <parent link=...> and <child link=...>."
        )
    origin, axis = element.find("origin"), element.find("axis")
    xyz = _numbers(origin, "xyz", (0.0, 0.0, 0.0), where)
    rpy = _numbers(origin, "rpy", (0.0, 0.0, 0.0), where)
    along = np.array(_numbers(axis, "xyz", (1.0, 0.0, 0.0), where))
    length = float(np.linalg.norm(along))
    if length == 0.0:
        raise RecordingError(f"{where} has an axis of length 0.", 'Write its direction, as in <axis xyz="0 0 1"/>.')
    mimic, limit = element.find("mimic"), element.find("limit")
    bounded = kind in ("revolute", "prismatic") and limit is not None
    # The angles of URDF turn about the fixed axes x, y, z of the parent, one after the other.
    return Joint(
        name,
        kind,
        parent,
        child,
        (xyz[0], xyz[1], xyz[2]),
        Rotation.from_euler("xyz", rpy),
        (float(along[0] / length), float(along[1] / length), float(along[2] / length)),
        name if mimic is None else str(mimic.get("joint")),
        1.0 if mimic is None else _number(mimic, "multiplier", 1.0, where),
        0.0 if mimic is None else _number(mimic, "offset", 0.0, where),
        _number(limit, "lower", 0.0, where) if bounded and limit is not None else -np.inf,
        _number(limit, "upper", 0.0, where) if bounded and limit is not None else np.inf,
    )


def _numbers(
    element: ElementTree.Element | None, key: str, default: tuple[float, float, float], where: str
) -> tuple[float, ...]:
    text = None if element is None else element.get(key)
    if text is None:
        return default
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        values = ()
    if len(values) != 3 or not np.isfinite(values).all():
        raise RecordingError(f"{where} has {key}={text!r}, which is not three finite numbers.", "Correct the URDF.")
    return values


def _number(element: ElementTree.Element, key: str, default: float, where: str) -> float:
    text = element.get(key)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise RecordingError(f"{where} has {key}={text!r}, which is no finite number.", "Correct the URDF.")
    return value


def _to_root(link: str, parents: Mapping[str, Joint], source: str) -> list[Joint]:
    """The joints from a link up to the root."""
    found: list[Joint] = []
    while link in parents:
        if parents[link] in found:
            raise RecordingError(
                f"{source} has a circle of joints through the link {link!r}.", "The links of a URDF are a tree."
            )
        found.append(parents[link])
        link = parents[link].parent
    return found


def _check(chain: Chain, joints: Mapping[str, Joint], source: str) -> None:
    for joint in chain.joints:
        if joint.type not in ("fixed", *TURNING, *SLIDING):
            raise RecordingError(
                f"{source}: the joint {joint.name!r} between {chain.base!r} and {chain.tip!r} is of type "
                f"{joint.type!r}, which one number does not place.",
                "Name a base behind it: chains of fixed, revolute, continuous and prismatic joints are read.",
            )
        leader = joints.get(joint.leader)
        if not joint.moves:
            continue
        if leader is None or not leader.moves or leader.leader != leader.name:
            raise RecordingError(
                f"{source}: the joint {joint.name!r} mimics {joint.leader!r}, which is no joint that moves by itself.",
                nearest_match(joint.leader, sorted(n for n, j in joints.items() if j.moves and j.leader == n)),
            )
