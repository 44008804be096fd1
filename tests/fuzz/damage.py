"""Sound inputs of every kind, edits that damage them, and what must hold for whatever comes of it.

Whatever a disk holds is read, or refused in one sentence (a ``ThinshellError``). Run as a script it looks for inputs
for which that does not hold, and keeps them as they were edited in ``corpus/``::

    python tests/fuzz/damage.py --minutes 60
"""

from __future__ import annotations

import argparse
import copy
import json
import random
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import meshio
import numpy as np
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sim_core.errors import ThinshellError
from sim_core.geometry.mesh_file import read_sheet
from sim_core.rigs import config_folder, load_rig
from sim_core.rigs.motion import load_experiment
from sim_core.tasks.load import load_task
from sysid.observations.checks import examine
from sysid.recording import RecordingWriter, read_recording

CORPUS = Path(__file__).parent / "corpus"

STRUCTURED = {
    "rig_press": "rigs/card_press.yaml",
    "rig_gel": "rigs/gel_sensor.yaml",
    "rig_free": "rigs/push_block.yaml",
    "experiment_press": "experiments/press_post.yaml",
    "task_lifting": "tasks/lifting.yaml",
}
"""Files of which what they say is changed as well, below the folder of configurations."""

Edit = tuple[str, float, int]
"""Kind of an edit, where (share of the length, 0 to 1), and a number: bit, byte or count."""

KINDS = ("flip", "set", "zero", "delete", "insert", "repeat", "cut")
VALUES = ("value", "remove", "scale", "double", "add")
"""Kinds of edits of what a file of YAML or JSON says, which is still YAML or JSON after them."""
WRONG: tuple[Any, ...] = (
    None, [], {}, -1, 0, 1, 2.5, float("nan"), float("inf"), 1e300, -1e300, 1e-300, 10**30, "", "x", "1 mm", True,
    [0, 0, 0], [1], [[1, 2], [3]], {"a": 1}, [float("nan")] * 3,
)  # fmt: skip
FACTORS = (-1, 0, 1e-9, 1e9, 1e3, 1e-3, 0.5, 2)
LONGEST_S = 20.0
"""Processor time in which an input is read or refused."""
MOST_BYTES = 3 << 30
"""Address space beyond what is in use in which it is."""


def sound(folder: Path) -> dict[str, Path]:
    """One small input of each kind."""
    bag = folder / "bag"
    store = get_typestore(Stores.ROS2_JAZZY)
    draw = np.random.default_rng(0)
    image = draw.integers(0, 255, (24, 32)).astype(np.uint8)
    with RecordingWriter(bag) as out:
        for k in range(40):
            t = 10**9 + 10**7 * k
            out.pose("current_pose", t, (1e-3 * k, 0, 0.1), (0, 0, 0, 1), "base_link")
            out.wrench("wrench", t, draw.normal(size=3), draw.normal(size=3), "gel")
            out.tracks("marker_tracks", t, 10.0 * np.arange(8).reshape(4, 2) + 0.1 * k, np.arange(4), np.ones(4), "cam")
            if k % 8 == 0:
                out.image_compressed("image/compressed", t, image, "cam")
        out.camera_info("camera_info", 10**9, np.diag([500.0, 500.0, 1.0]), np.zeros(5), "plumb_bob", 640, 480, "cam")
    chunked = next(bag.glob("*.mcap"))
    found = {"mcap": chunked, "metadata": bag / "metadata.yaml"}
    found["mcap_records"] = repacked(chunked, folder / "records.mcap", use_chunking=False)
    found["mcap_plain"] = repacked(chunked, folder / "plain.mcap", compression=CompressionType.NONE)
    found["mcap_lz4"] = repacked(chunked, folder / "lz4.mcap", compression=CompressionType.LZ4)
    for name, mode in (("db3", CompressionMode.NONE), ("db3_messages", CompressionMode.MESSAGE)):
        writer = Writer(folder / name, version=9, storage_plugin=StoragePlugin.SQLITE3)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with Reader(bag) as old, writer as new:
            made = {c.topic: new.add_connection(c.topic, c.msgtype, typestore=store) for c in old.connections}
            for connection, stamp, raw in old.messages():
                new.write(made[connection.topic], stamp, raw)
        found[name] = next((folder / name).glob("*.db3"))
    found["rosbag1"] = _ros1(folder / "press.bag")
    found["csv"] = folder / "pull.csv"
    rows = [f"{0.01 * k:.3f},{0.1 * k:.2f},{0.5 * k:.2f},{k},{2 * k}" for k in range(30)]
    header = "time [s],x [mm],force_z [N],marker_tracks.3.u [px],marker_tracks.3.v [px]"
    found["csv"].write_text("\n".join([header, *rows]) + "\n")
    found["rig"] = folder / "rig.yaml"
    found["rig"].write_text((config_folder() / "rigs" / "card_press.yaml").read_text())
    for name, source in STRUCTURED.items():
        found[name] = folder / f"{name}{Path(source).suffix}"
        found[name].write_text((config_folder() / source).read_text())
    points = np.array([[x, y, 0.0] for x in range(4) for y in range(3)])
    cells = [[3 * i + j, 3 * i + j + 3, 3 * i + j + 4, 3 * i + j + 1] for i in range(3) for j in range(2)]
    triangles = np.array([[a, b, c] for a, b, c, d in cells] + [[a, c, d] for a, b, c, d in cells])
    for name in ("obj", "stl", "ply"):
        found[f"mesh_{name}"] = folder / f"sheet.{name}"
        meshio.Mesh(points, [("triangle", triangles)]).write(found[f"mesh_{name}"])
    found["picture"] = folder / "picture.png"
    cv2.imwrite(str(found["picture"]), image)
    return found


def damaged(data: bytes, edits: Sequence[Edit]) -> bytes:
    """The bytes after edits, one after the other."""
    out = bytearray(data)
    for kind, where, number in edits:
        at = min(int(where * len(out)), max(len(out) - 1, 0))
        if kind == "flip" and out:
            out[at] ^= 1 << (number % 8)
        elif kind == "set" and out:
            out[at] = number % 256
        elif kind == "zero":
            out[at : at + number] = bytes(len(out[at : at + number]))
        elif kind == "delete":
            del out[at : at + number]
        elif kind == "insert":
            out[at:at] = bytes([number % 256]) * (1 + number % 17)
        elif kind == "repeat":
            out[at:at] = out[at : at + number]
        elif kind == "cut":
            del out[at:]
    return bytes(out)


def changed(data: bytes, edits: Sequence[Edit]) -> bytes:
    """The YAML or JSON text after edits of what it says; those of bytes (:func:`damaged`) come last."""
    content = yaml.safe_load(data)
    for kind, where, number in edits:
        places = [place for place in _places(content) if place]
        if kind not in VALUES or not places:
            continue
        *way, last = places[min(int(where * len(places)), len(places) - 1)]
        inner = content
        for step in way:
            inner = inner[step]
        value = copy.deepcopy(WRONG[number % len(WRONG)])
        if kind == "value":
            inner[last] = value
        elif kind == "remove":
            del inner[last]
        elif kind == "scale" and isinstance(inner[last], int | float):
            inner[last] *= FACTORS[number % len(FACTORS)]
        elif kind == "double" and isinstance(inner, list):
            inner.append(copy.deepcopy(inner[last]))
        elif kind == "add" and isinstance(inner, dict):
            inner[("zz", 1, None, "type")[number % 4]] = value
    return damaged(yaml.safe_dump(content).encode(), edits)


def _places(content: Any, before: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The ways to all values in nested mappings and lists."""
    yield before
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in list(items):
        yield from _places(value, (*before, key))


def judge(name: str, original: Path, edits: Sequence[Edit], folder: Path) -> str:
    """What is wrong with how a damaged input is read, '' if nothing."""
    data = (changed if name in STRUCTURED else damaged)(original.read_bytes(), edits)
    try:
        _try(name, original, data, folder)
    except ThinshellError as error:
        if not str(error).strip() or "Traceback" in str(error):
            return f"an error without words: {error!r}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


def _try(name: str, original: Path, data: bytes, folder: Path) -> None:
    if name == "rig" or name in STRUCTURED:
        path = folder / original.name
        path.write_bytes(data)
        if name.startswith("experiment"):
            load_experiment(path)
        elif name.startswith("task"):
            load_task(path)
        else:
            load_rig(path)
        return
    if name.startswith("mesh"):
        path = folder / original.name
        path.write_bytes(data)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read_sheet(path, "mm")
        return
    if name == "picture":
        path = folder / "pictures"
        with RecordingWriter(path) as out:
            out.pose("current_pose", 10**9, (0, 0, 0), (0, 0, 0, 1), "base_link")
            out.wrench("wrench", 10**9, (0, 0, 0), (0, 0, 0), "gel")
            for k in range(3):
                out.image_compressed("image/compressed", 10**9 + k * 10**8, data, "cam")
    elif name == "metadata":
        path = folder / "bag"
        path.mkdir()
        (path / "metadata.yaml").write_bytes(data)
        for file in original.parent.glob("*.mcap"):
            (path / file.name).write_bytes(file.read_bytes())
    else:
        path = folder / f"input{original.suffix}"
        path.write_bytes(data)
    recording = read_recording(path, need_pose=False)
    for images in recording.images.values():
        for _ in images.decoded():
            pass
    examine(recording)
    recording.summary()


def repacked(source: Path, target: Path, **options: object) -> Path:
    """The messages of an MCAP file in another one, written with other options."""
    with source.open("rb") as old, target.open("wb") as new:
        writer = McapWriter(new, **options)  # type: ignore[arg-type]
        writer.start(profile="ros2", library="test")
        ids: dict[int, int] = {}
        for schema, channel, message in make_reader(old).iter_messages():
            assert schema is not None
            if channel.id not in ids:
                made = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, made)
            writer.add_message(ids[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    return target


def _ros1(path: Path) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "geometry_msgs/msg/WrenchStamped"
    vector = store.types["geometry_msgs/msg/Vector3"]
    with Writer1(path) as bag:
        made = bag.add_connection("/wrench", kind, typestore=store)
        for k in range(30):
            stamp = store.types["builtin_interfaces/msg/Time"](sec=1, nanosec=10**7 * k)
            header = store.types["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="gel")
            body = store.types["geometry_msgs/msg/Wrench"](
                force=vector(0.0, 0.0, 0.1 * k), torque=vector(0.0, 0.0, 0.0)
            )
            message = store.types[kind](header=header, wrench=body)
            bag.write(made, 10**9 + 10**7 * k, store.serialize_ros1(message, kind))
    return path


def drawn(random_: random.Random, kinds: Sequence[str] = KINDS) -> list[Edit]:
    """A few edits, mostly one."""
    count = random_.choice([1, 1, 1, 2, 3, 8])
    return [
        (random_.choice(kinds), random_.random(), random_.choice([1, 3, 7, 64, 255, 4096] + list(range(len(WRONG)))))
        for _ in range(count)
    ]


class _Hung(BaseException):
    """An input took longer than :data:`LONGEST_S`."""


def _alarm(_number: int, _frame: object) -> None:
    raise _Hung


def search(minutes: float, seed: int, say: Callable[[str], None] = print) -> int:
    """Look for inputs that are not read as they must be; returns how many kinds of failures were found."""
    random_ = random.Random(seed)
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, resource.RLIM_INFINITY))
    signal.signal(signal.SIGPROF, _alarm)
    end, tried, failures = time.monotonic() + 60.0 * minutes, 0, set()
    with tempfile.TemporaryDirectory() as base:
        inputs = sound(Path(base))
        while time.monotonic() < end:
            name = random_.choice(sorted(inputs))
            edits = drawn(random_, VALUES if name in STRUCTURED else KINDS)
            with tempfile.TemporaryDirectory() as folder:
                signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
                try:
                    fault = judge(name, inputs[name], edits, Path(folder))
                except _Hung:
                    fault = f"more than {LONGEST_S:g} s"
                finally:
                    signal.setitimer(signal.ITIMER_PROF, 0.0)
            tried += 1
            kind = (name, fault.partition(":")[0], fault[:60])
            if fault and kind not in failures:
                failures.add(kind)
                say(f"{name}: {fault}: {edits}")
                place = CORPUS / f"{name}_{seed}_{tried}.json"
                place.write_text(json.dumps({"input": name, "edits": edits}) + "\n", encoding="utf-8")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    say(f"{tried} damaged inputs, {len(failures)} kinds of failures, at most {peak} MiB in use")
    return len(failures)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    sys.exit(1 if search(given.minutes, given.seed) else 0)
