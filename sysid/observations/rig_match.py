"""Whether a recording was made with a rig, as far as its topics, frames and marker numbers tell."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim_core.errors import RecordingError
from sim_core.rigs import MarkerSensor, Rig, Rigid, marker_positions, track_ids
from sysid.recording.bag import TopicInfo
from sysid.recording.message_types import CLOUD, COMPRESSED, IMAGE, JOINTS, POSE, POSES, TF, WRENCH, WRENCHES

STREAMS = {
    **dict.fromkeys(POSES, POSE),
    **dict.fromkeys(WRENCHES, WRENCH),
    **{kind: kind for kind in (TF, JOINTS, CLOUD, IMAGE, COMPRESSED)},
}
"""Types of what a rig reads, and what each holds; other topics say nothing about it."""


@dataclass(frozen=True)
class _Part:
    """Part of a rig that reads one of ``topics``, of type ``kind``. ``key``: where the rig file names the first."""

    words: str
    key: str
    topics: tuple[str, ...]
    kind: str

    def __str__(self) -> str:
        return f"{self.words} ({' or '.join(self.topics)})"

    def found(self, available: Iterable[str]) -> list[str]:
        """The topics of a recording that may be the first of these that is there."""
        return next(filter(None, (_same(topic, available) for topic in self.topics)), [])


def _hands(rig: Rig) -> list[_Part]:
    found = []
    for name, effector in rig.end_effectors.items():
        topics, words, key = effector.topics, f"the pose of {name!r}", f"end_effectors.{name}.topics"
        if topics.tf is not None:
            found.append(_Part(words, f"{key}.tf", ("tf",), TF))
        elif topics.joints is not None:
            found.append(_Part(words, f"{key}.joints.topic", (topics.joints.topic,), JOINTS))
        else:
            found.append(_Part(words, f"{key}.current_pose", (topics.current_pose, topics.target_pose), POSE))
    return found


def _senses(rig: Rig) -> list[_Part]:
    kinds = {"wrench": WRENCH, "markers": CLOUD}
    return [
        *(
            _Part(f"the readings of {n!r}", f"sensors.{n}.topic", (s.topic,), kinds[s.type])
            for n, s in rig.sensors.items()
        ),
        *(
            _Part(f"the tracks of {n!r}", f"cameras.{n}.topics.marker_tracks", (c.topics.marker_tracks,), CLOUD)
            for n, c in rig.cameras.items()
        ),
    ]


def places_of_topics(rig: Rig) -> dict[str, str]:
    """Where the rig file names each topic that it reads, poses, readings and tracks."""
    return {part.topics[0]: part.key for part in (*_hands(rig), *_senses(rig))}


def check_topics(rig: Rig, path: Path, topics: Mapping[str, TopicInfo]) -> None:
    """Refuse a recording that lacks the pose of an end effector, or all that the rig measures, or in which names of the
    rig may mean several topics. Raises ``RecordingError``, which names what differs."""
    types = {
        "/" + topic.strip("/"): {STREAMS[m] for m in info.msgtypes if m in STREAMS} for topic, info in topics.items()
    }
    hands, senses = _hands(rig), _senses(rig)
    found = {part: part.found(types) for part in (*hands, *senses)}
    several = [part for part, same in found.items() if len(same) > 1]
    lacking = [part for part, same in found.items() if not same]
    if not several and not set(hands) & set(lacking) and not set(senses) <= set(lacking):
        return
    named = {t for topic in _named(rig) for t in _same(topic, types)}
    strange = [t for t, kinds in types.items() if kinds and t not in named]
    differences = [f"it lacks {', '.join(map(str, lacking))}"] if lacking else []
    differences += [f"{part} may be {' or '.join(found[part])}" for part in several]
    differences += [f"it has {', '.join(strange)}, which the rig does not name"] if strange else []
    examples = [(part.key, found[part][0]) for part in several]
    examples += [(part.key, t) for part in lacking for t in strange if part.kind in types[t]]
    example = f", as in {examples[0][0]}: {examples[0][1]}" if examples else ""
    images = [name for name, camera in rig.cameras.items() if _same(camera.topics.image, types)]
    tracks = f"Make tracks of the images of {', '.join(images)} with 'thinshell track', give" if images else "Give"
    raise RecordingError(
        f"{path} does not match the rig {rig.name!r}: {'; '.join(differences)}.",
        f"{tracks} the rig that it was recorded with, or write the topics of the recording into this one{example}.",
    )


def marker_numbers(rig: Rig) -> dict[str, np.ndarray]:
    """Numbers of the markers, in the order of the columns, by sensor or camera."""
    bodies = {n: b for n, b in rig.bodies.items() if not isinstance(b, Rigid)}
    found = {
        name: marker_positions(sensor.points, bodies[sensor.body])[1]
        for name, sensor in rig.sensors.items()
        if isinstance(sensor, MarkerSensor)
    }
    return found | {name: track_ids(camera, bodies) for name, camera in rig.cameras.items()}


def numbers_apart(recorded: np.ndarray, known: np.ndarray) -> str:
    """How the marker numbers of a recording and those of a rig differ."""
    recorded, known = np.unique(recorded), np.unique(known)
    lost, strange = np.setdiff1d(known, recorded), np.setdiff1d(recorded, known)
    parts = [
        f"the recording has {len(recorded)} markers ({span_of(recorded)}), the rig {len(known)} ({span_of(known)})"
    ]
    parts += [f"never seen: {span_of(lost)}"] if len(lost) else []
    parts += [f"not compared, since the rig does not know them: {span_of(strange)}"] if len(strange) else []
    return "; ".join(parts) + "."


def span_of(numbers: np.ndarray) -> str:
    """Sorted numbers, in short."""
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"{numbers[0]} to {numbers[-1]}"
    shown = [str(n) for n in numbers[:8]]
    return ", ".join(shown) + (", ..." if len(numbers) > len(shown) else "")


def _same(topic: str, available: Iterable[str]) -> list[str]:
    """The topics of a recording that a name of the rig may mean, in any namespace."""
    absolute = "/" + topic.strip("~/")
    same = [t for t in available if t.endswith(absolute)]
    return [absolute] if absolute in same else same


def _named(rig: Rig) -> list[str]:
    """All topics that the rig names."""
    hands = [t for e in rig.end_effectors.values() for t in (e.topics.current_pose, e.topics.target_pose)]
    cameras = [t for c in rig.cameras.values() for t in (c.topics.marker_tracks, c.topics.image)]
    hands += [e.topics.joints.topic for e in rig.end_effectors.values() if e.topics.joints is not None]
    return [*hands, *(s.topic for s in rig.sensors.values()), *cameras]
