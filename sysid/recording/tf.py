"""Poses from a tree of transforms (``/tf``, ``/tf_static``): the frame pair that a rig names, along the whole chain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.errors import RecordingError, nearest_match
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.recording.arrays import Floats
from sysid.recording.bag import Bag, MessageSet
from sysid.recording.message_types import TF
from sysid.recording.messages import Series, decode
from sysid.recording.notes import Notes, plural
from sysid.recording.times import TimeSource, order_in_time

STATIC = "tf_static"


@dataclass(eq=False)
class _Edge:
    """Transforms of one child frame in one parent frame, in the order of recording. ``message``: which of ``source``
    each is of; ``unusable``: how many more there are that are no transforms."""

    parent: str
    child: str
    source: MessageSet
    static: bool
    message: list[int]
    stamps_ns: list[int]
    rows: list[tuple[float, ...]]
    unusable: int = 0

    def other(self, frame: str) -> str:
        """The end that is not ``frame``."""
        return self.child if frame == self.parent else self.parent


def tf_topics(bag: Bag) -> list[str]:
    """The topics of transforms of a recording."""
    return [t.name for t in bag.topics.values() if t.msgtypes == (TF,) and t.count]


def tf_series(bag: Bag, base: str, child: str, clock: TimeSource, notes: Notes) -> Series:
    """The pose of ``child`` in ``base`` whenever the fastest moving part of the chain between them was published.

    The other parts are interpolated to these instants, rotations by slerp.

    Raises:
        RecordingError: the recording has no such chain.
    """
    edges: dict[tuple[str, str], _Edge] = {}
    for topic in tf_topics(bag):
        _read(bag, topic, edges, notes)
    usable = [edge for edge in edges.values() if edge.rows]
    above = _above(usable, base, child)
    chain = _chain(above, base, child)
    if not chain:
        known = sorted({frame for edge in usable for frame in (edge.parent, edge.child)})
        lacking = next((name for name in (base, child) if name not in known), None)
        raise RecordingError(
            f"{bag.path} has no chain of transforms from {base!r} to {child!r}"
            + (f": {lacking!r} is in none." if lacking else ": they are in two trees, or one frame."),
            nearest_match(lacking, known) if lacking and known else f"Frames: {', '.join(known) or 'none'}.",
        )
    _judge(bag, chain, above, base, child, notes)
    moving = [edge for edge in chain if not edge.static and len(edge.rows) > 1]
    leading = max(moving or chain, key=lambda edge: len(edge.rows))
    tracks = {id(edge): _trajectory(edge, clock, notes) for edge in chain}
    kept, times_ns = _ordered(leading, clock, Notes())
    others = [tracks[id(edge)][0] for edge in moving if edge is not leading]
    inside = np.ones(len(times_ns), dtype=bool)
    for other in others:
        inside &= (times_ns >= other[0]) & (times_ns <= other[-1])
    if not inside.any():
        raise RecordingError(
            f"{bag.path}: the transforms between {base!r} and {child!r} were never published at the same time.",
            "Record /tf while all of the robot's drivers run.",
        )
    if not inside.all():
        notes.info("/tf", f"{plural(int((~inside).sum()), 'pose')} outside of the time of all transforms left out")
    kept, times_ns = kept[inside], times_ns[inside]
    position, rotation = np.zeros((len(times_ns), 3)), Rotation.identity(len(times_ns))
    frame = base
    for edge in chain:
        p, r = _sampled(*tracks[id(edge)], times_ns)
        if edge.child == frame:
            r = r.inv()
            p = r.apply(-p)
        position, rotation, frame = position + rotation.apply(p), rotation * r, edge.other(frame)
    rows = [tuple(row) for row in np.hstack([position, rotation.as_quat()]).tolist()]
    source = leading.source.take(np.array(leading.message, dtype=np.int64)[kept])
    return Series(f"/tf ({base} to {child})", base, source, rows, times_ns)


def _read(bag: Bag, topic: str, edges: dict[tuple[str, str], _Edge], notes: Notes) -> None:
    source = bag.messages(topic)
    static = topic.strip("/").endswith(STATIC)
    damaged = 0
    for k, data in enumerate(source.payloads()):
        try:
            transforms = decode(data, TF).transforms
        except ValueError:
            damaged += 1
            continue
        for one in transforms:
            t, q = one.transform.translation, one.transform.rotation
            row = (t.x, t.y, t.z, q.x, q.y, q.z, q.w)
            parent, child = str(one.header.frame_id).lstrip("/"), str(one.child_frame_id).lstrip("/")
            edge = edges.setdefault((parent, child), _Edge(parent, child, source, static, [], [], []))
            if edge.source is not source:
                continue  # static and moving at once: the first counts
            if not np.isfinite(row).all() or not 0.5 < float(np.linalg.norm(row[3:])) < 2.0:
                edge.unusable += 1
                continue
            edge.message.append(k)
            edge.stamps_ns.append(int(one.header.stamp.sec) * 1_000_000_000 + int(one.header.stamp.nanosec))
            edge.rows.append(row)
    if damaged:
        notes.warning(topic, f"{plural(damaged, 'message')} that cannot be read dropped")


def _above(edges: Sequence[_Edge], *frames: str) -> list[_Edge]:
    """The transforms to the parents of frames, to theirs, and so on to the roots."""
    reached, found = list(dict.fromkeys(frames)), []
    for frame in reached:
        up = [edge for edge in edges if edge.child == frame]
        reached += [edge.parent for edge in up if edge.parent not in reached]
        found += up
    return found


def _chain(edges: Sequence[_Edge], base: str, child: str) -> list[_Edge]:
    """The shortest way from one frame to another, empty if there is none."""
    before: dict[str, _Edge | None] = {base: None}
    reached = [base]
    for frame in reached:
        for edge in edges:
            if frame in (edge.parent, edge.child) and edge.other(frame) not in before:
                before[edge.other(frame)] = edge
                reached.append(edge.other(frame))
    found: list[_Edge] = []
    frame = child
    while (edge_before := before.get(frame)) is not None:
        found.append(edge_before)
        frame = edge_before.other(frame)
    return found[::-1]


def _judge(bag: Bag, chain: Sequence[_Edge], edges: Sequence[_Edge], base: str, child: str, notes: Notes) -> None:
    """What is wrong with the transforms of a chain; others are of no concern. Raises where there is a second chain."""
    for edge in chain:
        if second := _chain([e for e in edges if e is not edge], base, child):
            ways = (" - ".join(_frames(way, base)) for way in (chain, second))
            raise RecordingError(
                f"{bag.path} has two chains of transforms from {base!r} to {child!r}: {' and '.join(ways)}.",
                "Stop the second publisher of the frame that has two parents, and record again.",
            )
        others = [e.parent for e in edges if e.child == edge.child and e is not edge and e not in chain]
        if others:
            notes.warning(
                "/tf",
                f"the frame {edge.child!r} has the parent {', '.join(map(repr, others))} and also {edge.parent!r}: the "
                f"chain {' - '.join(_frames(chain, base))} is used",
            )
        if edge.unusable:
            notes.warning("/tf", f"{plural(edge.unusable, 'transform')} of {edge.child!r} that cannot be used dropped")


def _frames(chain: Sequence[_Edge], base: str) -> list[str]:
    frames = [base]
    for edge in chain:
        frames.append(edge.other(frames[-1]))
    return frames


def _ordered(edge: _Edge, clock: TimeSource, notes: Notes) -> tuple[np.ndarray, np.ndarray]:
    log_ns = edge.source.log_ns[np.array(edge.message, dtype=np.int64)]
    return order_in_time(f"/tf ({edge.child})", np.array(edge.stamps_ns, dtype=np.int64), log_ns, clock, notes)


def _trajectory(edge: _Edge, clock: TimeSource, notes: Notes) -> tuple[np.ndarray, Floats]:
    """Times [ns] ``(n,)`` and poses ``(n, 7)``; of a static transform the last one."""
    if edge.static or len(edge.rows) == 1:
        return np.zeros(1, dtype=np.int64), np.array(edge.rows[-1:])
    kept, times_ns = _ordered(edge, clock, notes)
    return times_ns, np.array(edge.rows)[kept]


def _sampled(times_ns: np.ndarray, poses: Floats, at_ns: np.ndarray) -> tuple[Floats, Rotation]:
    start = int(times_ns[0])
    quaternions = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    track = PoseTrajectory.from_samples(1e-9 * (times_ns - start), poses[:, :3], quaternions)
    position, quaternion = track.sample(1e-9 * (at_ns - start) if len(times_ns) > 1 else np.zeros(len(at_ns)))
    return position, Rotation.from_quat(quaternion)
