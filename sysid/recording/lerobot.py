"""LeRobot datasets (v2 and v3): their episodes as tables, and recordings as a dataset of v3.0.

A dataset has its numbers in Parquet files, one row a frame at a fixed rate, and what their columns are in
``meta/info.json`` (github.com/huggingface/lerobot, src/lerobot/datasets). Films stay where they are: pictures are
tracked apart. Parquet is read and written by pyarrow, the extra ``lerobot``.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.errors import RecordingError
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.io.atomic_folder import whole_folder
from sysid.recording.csv_header import Unknown, column_of
from sysid.recording.find import lerobot_info
from sysid.recording.recording import Recording
from sysid.recording.streams import Stream

VERSION = "v3.0"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
OWN = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Columns that every dataset has."""


@dataclass(frozen=True)
class Feature:
    """A column of a dataset as frames ``(n, m)``, with the name of each of its numbers."""

    names: tuple[str, ...]
    values: np.ndarray


def arrow() -> tuple[Any, Any]:
    """pyarrow and its Parquet. Raises ``RecordingError`` where it is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise RecordingError(
            "LeRobot datasets are read and written by pyarrow, which is not installed.",
            "Install it: pip install 'thinshell_ros[lerobot]'.",
        ) from None
    return pyarrow, pyarrow.parquet


# Episodes as tables.


def write_tables(dataset: Path, out: Path, episodes: Sequence[int] = ()) -> str:
    """Write the episodes of a dataset (all, if none are named) as tables ``episode_000000.csv`` into a new folder.
    Returns what was written and what not, in words. Raises ``RecordingError`` for what is no such dataset."""
    info = lerobot_info(dataset)
    if info is None:
        raise RecordingError(
            f"{dataset} is no LeRobot dataset: it has no meta/info.json with a codebase_version.",
            "Give the folder that holds meta and data.",
        )
    found = sorted({k for _, k in _rows(dataset)})
    missing = sorted(set(episodes) - set(found))
    if missing or not found:
        content = (
            f"episodes {found[0]} to {found[-1]}" if found else "no frames in its Parquet files (data/*/*.parquet)"
        )
        raise RecordingError(
            f"{dataset} has {content}" + (f", and not {', '.join(map(str, missing))}." if missing else "."),
            "Give numbers of episodes that it has." if found else "Download its files of data too.",
        )
    chosen = set(episodes or found)
    counts: dict[int, int] = {}
    left: dict[str, None] = {}
    features = info.get("features")
    features = features if isinstance(features, dict) else {}
    with whole_folder(out) as folder:
        for rows, episode in _rows(dataset):
            if episode in chosen:
                columns = dict(_columns(rows, features, left))
                counts[episode] = counts.get(episode, 0) + _append(folder / f"episode_{episode:06d}.csv", columns)
    left |= dict.fromkeys(
        k for k, f in features.items() if isinstance(f, dict) and f.get("dtype") in ("video", "image")
    )
    lines = [f"{out}: {len(counts)} episodes, {sum(counts.values())} frames, as tables."]
    if left:
        lines.append(f"Not written, since they are no numbers: {', '.join(left)}.")
    unknown = [name for name in columns if name != "time [s]" and not _known(name)]
    if unknown:
        lines.append(
            "Say in the rig what these columns are, as table_columns: "
            f"{{{json.dumps(unknown[0])}: 'current_pose.x [m]'}}: {', '.join(unknown)}."
        )
    return "\n".join(lines)


def _rows(dataset: Path) -> Iterator[tuple[dict[str, list[Any]], int]]:
    """The frames of each episode in each file, by column, in their order."""
    pa, parquet = arrow()
    for file in sorted((dataset / "data").glob("*/*.parquet")):
        try:
            table = parquet.read_table(file)
        except (OSError, ValueError) as error:  # pyarrow's errors are these
            raise RecordingError(f"{file} cannot be read: {error}.", "Use another copy of the dataset.") from None
        names = table.column_names
        if "episode_index" not in names or "timestamp" not in names:
            raise RecordingError(
                f"{file} has no columns episode_index and timestamp, but {', '.join(names) or 'none'}.",
                "Give a dataset of LeRobot v2.0 or later.",
            )
        column = np.array(table.column("episode_index").to_pylist())
        for episode in dict.fromkeys(int(k) for k in column.ravel()):
            part = table.filter(pa.array(column.ravel() == episode))
            if "frame_index" in names:
                part = part.sort_by("frame_index")
            yield {name: part.column(name).to_pylist() for name in names}, episode


def _columns(
    rows: Mapping[str, list[Any]], features: Mapping[str, Any], left: dict[str, None]
) -> Iterator[tuple[str, np.ndarray]]:
    """Names and numbers of the columns of a table; names of features without numbers go to ``left``."""
    yield "time [s]", _numbers(rows["timestamp"]).ravel()
    for name, values in rows.items():
        if name in OWN:
            continue
        try:
            numbers = _numbers(values)
        except (TypeError, ValueError):
            left[name] = None
            continue
        described = features.get(name)
        own = _names(described.get("names") if isinstance(described, dict) else None)
        own = own if len(own) == numbers.shape[1] else [str(k) for k in range(numbers.shape[1])]
        for k, word in enumerate(own):
            single = numbers.shape[1] == 1 and not _known(word)
            yield word if _known(word) else name if single else f"{name}.{word}", numbers[:, k]


def _numbers(values: list[Any]) -> np.ndarray:
    """Frames ``(n, m)`` of numbers. Raises ``TypeError`` or ``ValueError`` where they are none."""
    if any(isinstance(value, str | bytes | dict) for value in values[:1]):
        raise TypeError("no numbers")
    return np.asarray(values, dtype=float).reshape(len(values), -1)


def _names(described: Any) -> list[str]:
    """Names of the numbers of a feature: a list, or lists by a word such as 'motors' or 'axes'."""
    if isinstance(described, dict):
        return [word for inner in described.values() for word in _names(inner)]
    return [str(word) for word in described] if isinstance(described, list) else []


def _known(name: str) -> bool:
    """Whether a table may have this column as it is."""
    try:
        return column_of(name, {}) is not None
    except Unknown:
        return False


def _append(file: Path, columns: Mapping[str, np.ndarray]) -> int:
    """Write the frames behind those that the file has already; how many."""
    new = not file.exists()
    with file.open("a", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        if new:
            writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow(["" if math.isnan(value) else f"{value:.9g}" for value in row])
    return len(next(iter(columns.values())))


# Recordings as a dataset.


def write_dataset(recordings: Sequence[Recording], out: Path, fps: int, task: str, robot: str) -> str:
    """Write recordings as the episodes of a new dataset of v3.0, in frames ``fps`` a second; returns what was written.

    ``observation.state`` has the poses of all end effectors, ``action`` those that were commanded (or of the next
    frame, where none were recorded), ``observation.NAME`` the readings of each sensor and camera. Names of the numbers
    say topic, component and unit. Raises ``RecordingError`` where recordings have other channels than the first."""
    pa, parquet = arrow()
    episodes = [_frames(recording, fps) for recording in recordings]
    first = episodes[0]
    for number, episode in enumerate(episodes):
        unlike = {k for k in {*first, *episode} if first.get(k, _NONE).names != episode.get(k, _NONE).names}
        if unlike:
            raise RecordingError(
                f"Episode {number} has other columns than episode 0 in {', '.join(sorted(unlike))}: a dataset has the "
                "same ones in all.",
                "Export recordings of one rig with the same streams together.",
            )
    shapes = {name: (len(f.names),) for name, f in first.items()} | {name: (1,) for name in OWN}
    fields = [_field(pa, name, shapes[name][0]) for name in (*first, *OWN)]
    schema = pa.schema(fields)
    rows, start = [], 0
    with whole_folder(out) as folder:
        data = folder / DATA_PATH.format(chunk_index=0, file_index=0)
        data.parent.mkdir(parents=True)
        with parquet.ParquetWriter(data, schema, compression="snappy") as writer:
            for number, episode in enumerate(episodes):
                count = len(next(iter(episode.values())).values)
                frames = np.arange(count)
                own = {"timestamp": frames / fps, "frame_index": frames, "episode_index": np.full(count, number),
                       "index": start + frames, "task_index": np.zeros(count, dtype=int)}  # fmt: skip
                values = {name: f.values for name, f in episode.items()} | own
                arrays = [_array(pa, field, np.asarray(values[field.name])) for field in fields]
                writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
                stats = {f"stats/{n}/{k}": v for n, a in values.items() for k, v in _statistics(a).items()}
                rows.append({
                    "episode_index": number, "tasks": [task], "length": count, "dataset_from_index": start,
                    "dataset_to_index": start + count, "data/chunk_index": 0, "data/file_index": 0,
                    "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0, **stats,
                })  # fmt: skip
                start += count
        index = folder / EPISODES_PATH.format(chunk_index=0, file_index=0)
        index.parent.mkdir(parents=True)
        parquet.write_table(pa.Table.from_pylist(rows), index, compression="snappy")
        _write_tasks(pa, parquet, folder / "meta" / "tasks.parquet", task)
        every = {name: np.vstack([e[name].values for e in episodes]) for name in first}
        _write_json(folder / "meta" / "stats.json", {name: _statistics(a) for name, a in every.items()})
        features: dict[str, dict[str, Any]] = {}
        features |= {n: {"dtype": "float32", "shape": shapes[n], "names": list(f.names)} for n, f in first.items()}
        features |= {name: {"dtype": kind, "shape": (1,), "names": None} for name, kind in OWN.items()}
        _write_json(folder / "meta" / "info.json", {
            "codebase_version": VERSION, "robot_type": robot, "total_episodes": len(episodes), "total_frames": start,
            "total_tasks": 1, "chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 200,
            "fps": fps, "splits": {"train": f"0:{len(episodes)}"}, "data_path": DATA_PATH, "video_path": None,
            "features": features,
        })  # fmt: skip
    return f"{out}: LeRobot {VERSION}, {len(episodes)} episodes, {start} frames at {fps} Hz: {', '.join(first)}."


_NONE = Feature((), np.zeros((0, 0)))


def _frames(recording: Recording, fps: int) -> dict[str, Feature]:
    """The channels of a recording at the instants of frames from its first pose or reading on."""
    streams = [stream for _, _, stream in recording.streams() if len(stream)]
    begin, end = min(s.t[0] for s in streams), max(s.t[-1] for s in streams)
    t = begin + np.arange(int((end - begin) * fps + 1e-6) + 1) / fps
    found: dict[str, Feature] = {}
    if recording.poses:
        state = {name: _poses(stream, t) for name, stream in recording.poses.items()}
        commanded = {name: _poses(stream, t) for name, stream in recording.target_poses.items()}
        topics = {name: _dotted(stream.topic) for name, stream in recording.poses.items()}
        names = tuple(f"{topics[n]}.{c}" for n in state for c in ("x [m]", "y [m]", "z [m]", "qx", "qy", "qz", "qw"))
        found["observation.state"] = Feature(names, np.hstack(list(state.values())))
        action = [commanded.get(n, np.vstack([own[1:], own[-1:]])) for n, own in state.items()]
        given = {n: _dotted(recording.target_poses[n].topic) if n in commanded else topics[n] for n in state}
        found["action"] = Feature(
            tuple(f"{given[n]}.{c}" for n in state for c in ("x [m]", "y [m]", "z [m]", "qx", "qy", "qz", "qw"))
            if set(commanded) == set(state) else tuple(f"next/{name}" for name in names), np.hstack(action),
        )  # fmt: skip
    for name, w in recording.wrenches.items():
        words = [*(f"force_{a} [N]" for a in "xyz"), *(f"torque_{a} [N m]" for a in "xyz")]
        values = _interpolated(w, np.hstack([w.force, w.torque]), t)
        found[f"observation.{name}"] = Feature(tuple(f"{_dotted(w.topic)}.{word}" for word in words), values)
    for name, m in recording.markers.items():
        labels = tuple(f"{_dotted(m.topic)}.{k}.{a} [m]" for k in m.ids for a in "xyz")
        found[f"observation.{name}"] = Feature(labels, _interpolated(m, m.position.reshape(len(m), -1), t))
    for name, c in recording.tracks.items():
        labels = tuple(f"{_dotted(c.topic)}.{k}.{a} [px]" for k in c.ids for a in "uv")
        found[f"observation.{name}"] = Feature(labels, _interpolated(c, c.uv.reshape(len(c), -1), t))
    return found


def _poses(stream: Any, t: np.ndarray) -> np.ndarray:
    trajectory = PoseTrajectory.from_samples(stream.t, stream.position, stream.quaternion)
    positions, quaternions = trajectory.sample(np.clip(t, stream.t[0], stream.t[-1]))
    return np.hstack([positions, quaternions])


def _interpolated(stream: Stream, values: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Readings between their neighbours, NaN where one of them is missing or there is none."""
    if not len(stream):
        return np.full((len(t), values.shape[1]), np.nan)
    after = np.clip(np.searchsorted(stream.t, t), min(1, len(stream) - 1), len(stream) - 1)
    before = np.maximum(after - 1, 0)
    gap = stream.t[after] - stream.t[before]
    share = np.where(gap > 0.0, (t - stream.t[before]) / np.where(gap > 0.0, gap, 1.0), 0.0)[:, None]
    exact = share[:, 0] >= 1.0 - 1e-9
    out = np.where(share > 1e-9, (1.0 - share) * values[before] + share * values[after], values[before])
    out[exact] = values[after][exact]
    out[(share[:, 0] < -1e-9) | (share[:, 0] > 1.0 + 1e-9)] = np.nan
    return np.asarray(out)


def _dotted(topic: str) -> str:
    """A topic as columns of tables name it."""
    return topic.strip("/").replace("/", ".")


def _field(pa: Any, name: str, size: int) -> Any:
    kind = pa.int64() if OWN.get(name) == "int64" else pa.float32()
    return pa.field(name, kind if size == 1 else pa.list_(kind, size))


def _array(pa: Any, field: Any, values: np.ndarray) -> Any:
    if not pa.types.is_fixed_size_list(field.type):
        return pa.array(values.ravel(), type=field.type)
    flat = pa.array(np.ascontiguousarray(values).ravel(), type=field.type.value_type)
    return pa.FixedSizeListArray.from_arrays(flat, type=field.type)


def _statistics(values: np.ndarray) -> dict[str, list[float]]:
    """Least, largest, mean and standard deviation of each number, of those that are there, and how many frames."""
    frames = np.asarray(values, dtype=float).reshape(len(values), -1)
    seen = np.isfinite(frames)
    count = np.maximum(seen.sum(axis=0), 1)
    filled = np.where(seen, frames, 0.0)
    mean = filled.sum(axis=0) / count
    spread = np.sqrt((np.where(seen, frames - mean, 0.0) ** 2).sum(axis=0) / count)
    least = np.where(seen, frames, np.inf).min(axis=0)
    most = np.where(seen, frames, -np.inf).max(axis=0)
    some = seen.any(axis=0)
    return {
        "min": np.where(some, least, 0.0).tolist(), "max": np.where(some, most, 0.0).tolist(), "mean": mean.tolist(),
        "std": spread.tolist(), "count": [len(frames)],
    }  # fmt: skip


def _write_tasks(pa: Any, parquet: Any, file: Path, task: str) -> None:
    """The one task, as the index of a table of pandas."""
    kinds = (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    about = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {"name": n, "field_name": n, "pandas_type": t, "numpy_type": k, "metadata": None} for n, t, k in kinds
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
    }
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": pa.array([task])})
    parquet.write_table(table.replace_schema_metadata({"pandas": json.dumps(about)}), file)


def _write_json(file: Path, content: Mapping[str, Any]) -> None:
    file.write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")
