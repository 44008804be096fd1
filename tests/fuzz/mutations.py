"""Mutations of what a bag, a rig, a mesh and a table say: names, types, sizes and values, one place at a time.

A bag is small but whole: a pose, a wrench, markers, tracks, pictures and a camera_info. One message is changed in one
field, or one topic or file in its name or type. Whatever comes of it, the program says what is wrong in one sentence
or reads on; what is whole is not lost, and what is lost is said with its topic. As a script it tries as many as are
asked for::

    python tests/fuzz/mutations.py --count 2000
"""

from __future__ import annotations

import argparse
import dataclasses
import random
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from damage import repacked
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sim_core.errors import ThinshellError
from sim_core.rigs import load_rig
from sysid.model.load import load_run
from sysid.observations.checks import examine
from sysid.recording import Recording, RecordingWriter, read_recording

STORE = get_typestore(Stores.ROS2_JAZZY)
COUNT = 40
TEXTS = (
    "",
    "x",
    "/",
    "caf\N{LATIN SMALL LETTER E WITH ACUTE}",
    "a" * 5000,
    "current_pose",
    "../..",
    "%s",
    "\x00",
    "base link",
)
FLOATS = (float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e-300, 1e300, 1e30, 1e6, -0.0)
INTS = (0, 1, -1, 2, 7, 255, 2**15, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1)
TYPES = (
    "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Image", "std_msgs/msg/String", "geometry_msgs/msg/Pose",
)  # fmt: skip
RIG = {
    "name": "small",
    "bodies": {
        "card": {
            "type": "sheet",
            "shape": {"type": "mesh", "file": "card.obj", "unit": "mm"},
            "material": {"E_pa": 2.0e9, "nu": 0.3, "thickness_m": 3.0e-4, "density_kg_m3": 400.0},
        }
    },
    "clamps": [{"name": "grip", "body": "card", "region": {"x_m": [-0.001, 0.011]}, "mount": "hand"}],
    "end_effectors": {"hand": {"start": {"position_m": [0.0, 0.0, 0.1]}}},
    "sensors": {"cell": {"type": "wrench", "on": "hand", "frame_id": "gel", "topic": "wrench"}},
}
"""A rig with a mesh file, for the bag and for the table."""


def bag(path: Path) -> Path:
    """The whole bag."""
    draw = np.random.default_rng(0)
    image = draw.integers(0, 255, (24, 32)).astype(np.uint8)
    places = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.0]])
    with RecordingWriter(path) as out:
        for k in range(COUNT):
            t = 10**9 + 10**7 * k
            out.pose("current_pose", t, (1e-4 * k, 0, 0.1), (0, 0, 0, 1), "base_link")
            out.wrench("wrench", t, draw.normal(size=3), draw.normal(size=3), "gel")
            out.markers("markers", t, places + 1e-5 * k, places, np.arange(3), "gel")
            out.tracks("marker_tracks", t, 5.0 * np.arange(8).reshape(4, 2) + 0.1 * k, np.arange(4), np.ones(4), "cam")
            if k % 8 == 0:
                out.image_compressed("image/compressed", t, image, "cam")
        out.camera_info("camera_info", 10**9, np.diag([500.0, 500.0, 1.0]), np.zeros(5), "plumb_bob", 640, 480, "cam")
    return path


def messages(path: Path) -> list[tuple[str, str, int, Any]]:
    """Topic, type, time of recording and content of all messages."""
    with Reader(path) as reader:
        return [(c.topic, c.msgtype, t, STORE.deserialize_cdr(raw, c.msgtype)) for c, t, raw in reader.messages()]


def write(path: Path, items: list[tuple[str, str, int, Any]]) -> None:
    """A bag of them; what cannot be serialised is left as bytes."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as out:
        made: dict[tuple[str, str], Any] = {}
        for topic, kind, t, message in items:
            if (topic, kind) not in made:
                made[topic, kind] = out.add_connection(topic, kind, typestore=STORE)
            raw = message if isinstance(message, bytes) else STORE.serialize_cdr(message, message.__msgtype__)
            out.write(made[topic, kind], t, raw)


def as_pages(source: Path, target: Path) -> Path:
    """The messages of a bag in a file of sqlite."""
    with Reader(source) as old, Writer(target, version=9, storage_plugin=StoragePlugin.SQLITE3) as new:
        made = {c.topic: new.add_connection(c.topic, c.msgtype, typestore=STORE) for c in old.connections}
        for connection, stamp, raw in old.messages():
            new.write(made[connection.topic], stamp, raw)
    (file,) = target.glob("*.db3")
    return file


def places(message: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The ways to all values in a message."""
    if dataclasses.is_dataclass(message):
        for field in dataclasses.fields(message):
            if not field.name.startswith("__"):
                yield from places(getattr(message, field.name), (*way, field.name))
    elif isinstance(message, list):
        yield way
        for k, item in enumerate(message):
            yield from places(item, (*way, k))
    else:
        yield way


def get(message: Any, way: tuple[Any, ...]) -> Any:
    for step in way:
        message = message[step] if isinstance(step, int) else getattr(message, step)
    return message


def put(message: Any, way: tuple[Any, ...], value: Any) -> None:
    inner = get(message, way[:-1])
    if isinstance(way[-1], int):
        inner[way[-1]] = value
    else:
        object.__setattr__(inner, way[-1], value)


def other(value: Any, draw: random.Random) -> Any:
    """Another value of the same kind."""
    if isinstance(value, str):
        return draw.choice(TEXTS)
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return draw.choice(INTS)
    if isinstance(value, float):
        return draw.choice(FLOATS)
    if isinstance(value, list):
        return draw.choice([[], value[:-1], value + value, value[::-1]])
    array = np.array(value)
    change = draw.choice(["entry", "short", "long", "none"])
    if change == "entry" and array.size:
        pool = FLOATS if array.dtype.kind == "f" else tuple(i % 256 for i in INTS)
        array[draw.randrange(array.size)] = draw.choice(pool)
        return array
    return {"short": array[:-1], "long": np.concatenate([array, array])}.get(change, array[:0])


@dataclasses.dataclass
class Mutation:
    """What was done, to which topic ('' for none alone), and how many messages of it may be lost for it, None: all."""

    words: str
    topic: str = ""
    lost: int | None = None


def of_message(items: list[tuple[str, str, int, Any]], draw: random.Random) -> Mutation:
    """One value of one message."""
    k = draw.randrange(len(items))
    topic, kind, t, message = items[k]
    way = draw.choice([way for way in places(message) if way])
    kept = get(message, way)
    while True:
        value = other(kept, draw)
        put(message, way, value)
        try:
            STORE.serialize_cdr(message, kind)
        except Exception:  # a number that the type cannot hold
            put(message, way, kept)
            continue
        break
    words = f"{topic}: {'.'.join(map(str, way))} = {str(value)[:40]!r} at {t}"
    return Mutation(words, topic, None if topic == "/camera_info" else 1)


def of_times(items: list[tuple[str, str, int, Any]], draw: random.Random) -> Mutation:
    """The time of recording of one message."""
    k = draw.randrange(len(items))
    topic, kind, t, message = items[k]
    items[k] = (topic, kind, draw.choice([0, 1, t + 10**9, t - 5 * 10**8, 2**62]), message)
    return Mutation(f"{topic}: recorded at {items[k][2]} instead of {t}", topic, 1)


def of_bytes(items: list[tuple[str, str, int, Any]], draw: random.Random) -> Mutation:
    """Bytes of one message: cut, doubled, flipped."""
    k = draw.randrange(len(items))
    topic, kind, t, message = items[k]
    raw = bytearray(STORE.serialize_cdr(message, kind))
    change = draw.choice(["cut", "empty", "double", "flip"])
    if change == "flip":
        raw[draw.randrange(len(raw))] ^= 1 << draw.randrange(8)
    new = {"cut": raw[: draw.randrange(len(raw))], "empty": raw[:0], "double": raw + raw}.get(change, raw)
    items[k] = (topic, kind, t, bytes(new))
    return Mutation(f"{topic}: bytes {change} at {t}", topic, None if topic == "/camera_info" else 1)


def of_topic(items: list[tuple[str, str, int, Any]], draw: random.Random) -> Mutation:
    """The name or the type of one topic."""
    topic = draw.choice(sorted({item[0] for item in items}))
    change = draw.choice(["name", "type", "lost", "twice"])
    value = draw.choice(
        ["/x", "/left" + topic, topic + "/", "//" + topic, "/caf\N{LATIN SMALL LETTER E WITH ACUTE}", topic.upper()]
    )
    kind = draw.choice(TYPES)
    for k, (name, own, t, message) in enumerate(list(items)):
        if name == topic and change == "name":
            items[k] = (value, own, t, message)
        elif name == topic and change == "type":
            items[k] = (name, kind, t, bytes(STORE.serialize_cdr(message, own)))
        elif name == topic and change == "twice":
            items.append((value, own, t, message))
    if change == "lost":
        items[:] = [item for item in items if item[0] != topic]
    items.sort(key=lambda item: item[2])
    return Mutation(f"{topic}: {change} {value if change != 'type' else kind}", topic)


def of_files(path: Path, draw: random.Random) -> Mutation:
    """Names of files, and what the metadata says of them."""
    meta = path / "metadata.yaml"
    (file,) = path.glob("*.mcap")
    change = draw.choice(["rename", "remove", "list", "count", "stray file", "suffix"])
    content = yaml.safe_load(meta.read_text())
    info = content["rosbag2_bagfile_information"]
    if change == "rename":
        file.rename(
            path
            / draw.choice(["a.mcap", "A.MCAP", "data", "x.mcap.active", "caf\N{LATIN SMALL LETTER E WITH ACUTE}.mcap"])
        )
    elif change == "remove":
        meta.unlink()
        return Mutation("metadata.yaml removed")
    elif change == "list":
        info["relative_file_paths"] = draw.choice(
            [[], [file.name] * 2, ["C:\\bags\\" + file.name], [None], ["../" + file.name], [3]]
        )
    elif change == "count":
        info[draw.choice(sorted(info))] = draw.choice([None, -1, "x", [], {}, 10**30])
    elif change == "stray file":
        (path / draw.choice(["._a.mcap", "b.mcap", "b.csv", "notes.txt", "x.db3-wal"])).write_bytes(
            draw.choice([b"", b"\x00" * 40, b"x,y\n1"])
        )
    else:
        file.rename(file.with_suffix(draw.choice([".db3", ".bag", ".csv", ".zst", ".gz"])))
    meta.write_text(yaml.safe_dump(content))
    return Mutation(f"files: {change}")


def of_storage(raw: bytes, draw: random.Random) -> tuple[bytes, list[int]]:
    """One to three bits of a file."""
    out = bytearray(raw)
    where = [draw.randrange(len(out)) for _ in range(draw.randint(1, 3))]
    for at in where:
        out[at] ^= 1 << draw.randrange(8)
    return bytes(out), where


def of_table(folder: Path, draw: random.Random) -> Mutation:
    """One cell, name, separator or line of a table."""
    file = folder / "pull.csv"
    rows = [line.split(",") for line in file.read_text().splitlines()]
    line, column = draw.randrange(len(rows)), draw.randrange(len(rows[0]))
    change = draw.choice(["cell", "add", "drop", "line", "separator", "encoding"])
    if change == "cell":
        rows[line][column] = draw.choice(
            [*TEXTS, "nan", "1e400", "1,5", "-", "0x10", "1_000", "time [s]", "[", "x [mm"]
        )
    elif change == "add":
        rows[line].insert(column, "9")
    elif change == "drop":
        del rows[line][column]
    elif change == "line":
        rows.insert(line, draw.choice([[], ["#"], ["a", "b"], rows[line]]))
    text = (draw.choice([";", "\t", "|", " "]) if change == "separator" else ",").join
    data = "\n".join(text(row) for row in rows).encode(
        draw.choice(["utf-16", "utf-8-sig"]) if change == "encoding" else "utf-8"
    )
    file.write_bytes(data)
    return Mutation(f"table: {change} in line {line + 1}, column {column + 1}")


def of_mesh(folder: Path, draw: random.Random) -> Mutation:
    """One word of a mesh file."""
    file = folder / "card.obj"
    lines = [line.split() for line in file.read_text().splitlines()]
    k = draw.randrange(len(lines))
    at = draw.randrange(len(lines[k]))
    lines[k][at] = draw.choice(["nan", "0", "-1", "99", "1e300", "x", "", "1/2/3", "f", "v", "1e-7", "-99999", "2.5"])
    file.write_text("\n".join(" ".join(line) for line in lines) + "\n")
    return Mutation(f"mesh: word {at} of line {k + 1} is {lines[k][at]!r}")


def of_rig(folder: Path, draw: random.Random) -> Mutation:
    """One value of a rig file."""
    from damage import VALUES, changed

    file = folder / "rig.yaml"
    edit = (draw.choice(VALUES), draw.random(), draw.randrange(256))
    file.write_bytes(changed(file.read_bytes(), [edit]))
    return Mutation(f"rig: {edit}")


MOST_LOST = {".mcap": 2, ".db3": 32}
"""Messages that one bit damages at most: the record that it is in and the next one; those of a page of 4 KiB."""

MESSAGES: tuple[Callable[..., Mutation], ...] = (of_message, of_times, of_bytes, of_topic)
FOLDERS: tuple[Callable[..., Mutation], ...] = (of_table, of_mesh, of_rig)


class Trial:
    """Whole inputs, and one mutation after the other of them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.bag = bag(folder / "bag")
        self.items = messages(self.bag)
        (chunked,) = self.bag.glob("*.mcap")
        self.stored = {
            "records.mcap": repacked(chunked, folder / "records.mcap", use_chunking=False).read_bytes(),
            "pages.db3": as_pages(self.bag, folder / "pages").read_bytes(),
        }
        self.set = folder / "set"
        self.set.mkdir()
        points = [(10.0 * i, 10.0 * j, 0.0) for i in range(5) for j in range(3)]
        faces = [(3 * i + j + 1, 3 * i + j + 4, 3 * i + j + 5) for i in range(4) for j in range(2)]
        faces += [(3 * i + j + 1, 3 * i + j + 5, 3 * i + j + 2) for i in range(4) for j in range(2)]
        lines = ["v {} {} {}".format(*p) for p in points] + ["f {} {} {}".format(*f) for f in faces]
        (self.set / "card.obj").write_text("\n".join(lines) + "\n")
        (self.set / "rig.yaml").write_text(yaml.safe_dump(RIG))
        rows = [f"{0.01 * k:.2f},{0.1 * k:.1f},0,100,{0.5 * k:.1f},{0.1 * k:.1f}" for k in range(COUNT)]
        header = "time [s],x [mm],y [mm],z [mm],force_x [N],force_z [N]"
        (self.set / "pull.csv").write_text("\n".join([header, *rows]) + "\n")
        self.rig = load_rig(str(self.set / "rig.yaml"))
        self.whole = counts(read_recording(self.bag, need_pose=False))

    def judge(self, seed: int) -> tuple[str, str]:
        """What was done, and what is wrong with what comes of it, '' if nothing."""
        draw = random.Random(seed)
        change = draw.choice([*MESSAGES, *MESSAGES, of_files, of_storage, of_storage, *FOLDERS])
        with tempfile.TemporaryDirectory() as place, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            work = Path(place) / "work"
            try:
                if change is of_storage:
                    name = draw.choice(sorted(self.stored))
                    raw, where = of_storage(self.stored[name], draw)
                    work.mkdir()
                    (work / name).write_bytes(raw)
                    words = f"{name}: a bit of each of the bytes {where} of {len(raw)}"
                    return words, self._read_stored(work / name, len(where) * MOST_LOST[Path(name).suffix])
                if change in FOLDERS:
                    work.mkdir()
                    for file in self.set.iterdir():
                        (work / file.name).write_bytes(file.read_bytes())
                    done = change(work, draw)
                    return done.words, self._read_set(work)
                items = messages(self.bag)
                done = change(items, draw) if change in MESSAGES else Mutation("")
                write(work, items)
                if change is of_files:
                    done = change(work, draw)
                return done.words, self._read_bag(work, done)
            except cv2.error as error:
                return change.__name__, f"cv2.error: {error}"

    def _read_set(self, work: Path) -> str:
        def load() -> None:
            rig = load_rig(str(work / "rig.yaml"))
            load_run(rig, work / "pull.csv")

        return fault_of(load)[1]

    def _read_stored(self, file: Path, most: int) -> str:
        """Of a file with some bits changed, no more messages are lost than those bits can hold, and not silently."""
        recording, fault = fault_of(lambda: read_recording(file, need_pose=False))
        if recording is None:
            return fault or "refused: " + refusal(lambda: read_recording(file, need_pose=False))
        for step in (lambda: examine(recording), recording.summary, lambda: load_run(self.rig, file)):
            fault = fault_of(step)[1]
            if fault:
                return fault
        found = counts(recording)
        lost = sum(max(0, count - found.get(topic, 0)) for topic, count in self.whole.items())
        if lost > most:
            return f"{lost} messages lost, where {most} could be damaged"
        return "" if not lost or recording.warnings else f"{lost} messages lost without a word"

    def _read_bag(self, work: Path, done: Mutation) -> str:
        recording, fault = fault_of(lambda: read_recording(work, need_pose=False))
        if fault or recording is None:
            if not fault and done.lost is not None:
                _, fault = None, "refused: " + refusal(lambda: read_recording(work, need_pose=False))
            return fault
        for step in (lambda: examine(recording), recording.summary, lambda: load_run(self.rig, work)):
            fault = fault_of(step)[1]
            if fault:
                return fault
        found = counts(recording)
        for topic, count in self.whole.items():
            lost = count - found.get(topic, 0)
            if topic == done.topic:
                if done.lost is not None and lost > done.lost:
                    return f"{lost} messages of {topic} lost for one"
            elif lost and done.topic:
                return f"{lost} messages of {topic} lost for a change of {done.topic}"
            said = [note for note in recording.notes if topic in note.channel or topic in note.text]
            if 0 < lost < count and not said:
                return f"{lost} messages of {topic} lost without a word"
        return ""


def counts(recording: Recording) -> dict[str, int]:
    """Samples by topic."""
    return {stream.topic: len(stream) for _, _, stream in recording.streams()}


def fault_of(action: Callable[[], Any]) -> tuple[Any, str]:
    """What comes of it, None if it is refused, and what defect it shows."""
    try:
        return action(), ""
    except ThinshellError as error:
        text = str(error)
        return None, "" if text.strip() and "Traceback" not in text else f"an error without words: {error!r}"
    except Exception as error:
        return None, f"{type(error).__name__}: {error}"


def refusal(action: Callable[[], Any]) -> str:
    try:
        action()
    except ThinshellError as error:
        return str(error)
    return ""


def faults(first: int, count: int, say: Callable[[str], None] = lambda text: None) -> list[str]:
    """What is wrong with so many mutations from a seed on."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(Path(folder))
        for seed in range(first, first + count):
            words, fault = trial.judge(seed)
            if fault:
                found.append(f"{seed}: {words}: {fault}")
                say(found[-1])
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    failed = faults(given.first, given.count, print)
    print(f"{given.count} mutations, {len(failed)} with a defect")
    sys.exit(bool(failed))
