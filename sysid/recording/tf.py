"""Poses from a tree of transforms (``/tf``, ``/tf_static``): the frame pair that a rig names, along the whole chain."""

from __future__ import annotations

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


@dataclass
class _Edge:
    """Transforms of one child frame in one parent frame, in the order of recording. ``message``: which of ``source``
    each is of."""

    parent: str
    child: str
    source: MessageSet
    static: bool
    message: list[int]
    stamps_ns: list[int]
    rows: list[tuple[float, ...]]


def tf_topics(bag: Bag) -> list[str]:
    """The topics of transforms of a recording."""
    return [t.name for t in bag.topics.values() if t.msgtypes == (TF,) and t.count]


def tf_series(bag: Bag, base: str, child: str, clock: TimeSource, notes: Notes) -> Series:
    """The pose of ``child`` in ``base`` whenever the fastest moving part of the chain between them was published.

    The other parts are interpolated to these instants, rotations by slerp.

    Raises:
        RecordingError: the recording has no such chain.
    """
    edges: dict[str, _Edge] = {}
    for topic in tf_topics(bag):
        _read(bag, topic, edges, notes)
    ups = {name: _up(edges, name) for name in (base, child)}
    common = next((frame for frame in ups[child] if frame in ups[base]), None)
    if common is None or base == child:
        known = sorted({frame for edge in edges.values() for frame in (edge.parent, edge.child)})
        lacking = next((name for name in (base, child) if name not in known), None)
        raise RecordingError(
            f"{bag.path} has no chain of transforms from {base!r} to {child!r}"
            + (f": {lacking!r} is in none." if lacking else ": they are in two trees, or one frame."),
            nearest_match(lacking, known) if lacking and known else f"Frames: {', '.join(known) or 'none'}.",
        )
    down = [edges[frame] for frame in ups[child][: ups[child].index(common)]][::-1]
    up = [edges[frame] for frame in ups[base][: ups[base].index(common)]]
    moving = [edge for edge in (*up, *down) if not edge.static and len(edge.rows) > 1]
    leading = max(moving or [*up, *down], key=lambda edge: len(edge.rows))
    tracks = {id(edge): _trajectory(edge, clock, notes) for edge in (*up, *down)}
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
    for edge in up:
        p, r = _sampled(*tracks[id(edge)], times_ns)
        inverse = r.inv()
        position, rotation = position + rotation.apply(inverse.apply(-p)), rotation * inverse
    for edge in down:
        p, r = _sampled(*tracks[id(edge)], times_ns)
        position, rotation = position + rotation.apply(p), rotation * r
    rows = [tuple(row) for row in np.hstack([position, rotation.as_quat()]).tolist()]
    source = leading.source.take(np.array(leading.message, dtype=np.int64)[kept])
    return Series(f"/tf ({base} to {child})", base, source, rows, times_ns)


def _read(bag: Bag, topic: str, edges: dict[str, _Edge], notes: Notes) -> None:
    source = bag.messages(topic)
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
            length = float(np.linalg.norm(row[3:]))
            if not np.isfinite(row).all() or not 0.5 < length < 2.0:
                damaged += 1
                continue
            parent, child = str(one.header.frame_id).lstrip("/"), str(one.child_frame_id).lstrip("/")
            edge = edges.setdefault(child, _Edge(parent, child, source, topic.strip("/").endswith(STATIC), [], [], []))
            if edge.parent != parent:
                raise RecordingError(
                    f"{topic}: the frame {child!r} has two parents, {edge.parent!r} and {parent!r}.",
                    "Stop the second publisher of that frame, and record again.",
                )
            if edge.source is not source:
                continue  # static and moving at once: the first counts
            edge.message.append(k)
            edge.stamps_ns.append(int(one.header.stamp.sec) * 1_000_000_000 + int(one.header.stamp.nanosec))
            edge.rows.append(row)
    if damaged:
        notes.warning(topic, f"{plural(damaged, 'transform')} that cannot be used dropped")


def _up(edges: dict[str, _Edge], frame: str) -> list[str]:
    """The frame, its parent, and so on to the root."""
    chain = [frame]
    while chain[-1] in edges and edges[chain[-1]].parent not in chain:
        chain.append(edges[chain[-1]].parent)
    return chain


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
