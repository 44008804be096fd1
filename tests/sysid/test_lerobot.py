"""LeRobot datasets are read as tables, and recordings are written as datasets of v3.0."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from recording_files import COUNT

from sim_core.errors import RecordingError
from sim_core.rigs import load_rig
from sim_core.rigs.motion import load_experiment
from sysid.cli.app import main
from sysid.recording import TopicNames, read_recording
from sysid.recording.lerobot import write_dataset, write_tables
from sysid.simulate import simulate_to_bag

pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
pq = pytest.importorskip("pyarrow.parquet")

FPS = 100


def of_others(folder: Path) -> Path:
    """A dataset as others record them: two episodes in one file, joints, a scalar, a film, text."""
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    info = {
        "codebase_version": "v3.0", "fps": 10,
        "features": {
            "observation.state": {"dtype": "float32", "shape": [3], "names": {"axes": ["ee_x", "ee_y", "ee_z"]}},
            "observation.force": {"dtype": "float32", "shape": [1], "names": None},
            "observation.images.top": {"dtype": "video", "shape": [48, 64, 3], "names": ["height", "width", "channel"]},
            "note": {"dtype": "string", "shape": [1], "names": None},
        },
    }  # fmt: skip
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    n = 5
    frames = np.tile(np.arange(n), 2)
    table = pa.table({
        "observation.state": [[0.1 * k, 0.0, 0.5 - 0.01 * k] for k in range(2 * n)],
        "observation.force": [float(k) for k in range(2 * n)],
        "note": ["x"] * (2 * n), "timestamp": [0.1 * k for k in frames], "frame_index": list(frames),
        "episode_index": [0] * n + [1] * n, "index": list(range(2 * n)), "task_index": [0] * (2 * n),
    })  # fmt: skip
    pq.write_table(table, folder / "data" / "chunk-000" / "file-000.parquet")
    return folder


def test_episodes_of_others_are_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset = of_others(tmp_path / "set")
    with pytest.raises(RecordingError, match=r"is a LeRobot dataset \(v3\.0\).*thinshell lerobot import"):
        read_recording(dataset)
    assert main(["lerobot", "import", str(dataset), "--out", str(tmp_path / "out"), "--episodes", "1"]) == 0
    said = capsys.readouterr().out
    assert "1 episodes, 5 frames" in said and "no numbers: note, observation.images.top" in said
    assert 'table_columns: {"observation.state.ee_x"' in said
    (file,) = (tmp_path / "out").iterdir()
    meant = {f"observation.state.ee_{a}": f"current_pose.{a} [m]" for a in "xyz"} | {
        "observation.force": "wrench.force_z [N]"
    }
    recording = read_recording(file, TopicNames(columns=meant))
    np.testing.assert_allclose(recording.poses["ee"].position[:, 0], 0.1 * np.arange(5, 10), atol=1e-6)
    np.testing.assert_allclose(recording.wrenches["sensor"].force[:, 2], np.arange(5.0, 10.0))
    with pytest.raises(RecordingError, match="has episodes 0 to 1, and not 7"):
        write_tables(dataset, tmp_path / "more", [7])
    with pytest.raises(RecordingError, match="no LeRobot dataset"):
        write_tables(tmp_path, tmp_path / "more")
    file = dataset / "data" / "chunk-000" / "file-000.parquet"
    file.write_bytes(file.read_bytes()[:-30])
    with pytest.raises(RecordingError, match="cannot be read"):
        write_tables(dataset, tmp_path / "more")


def test_what_is_exported_comes_back(bag: Path, tmp_path: Path) -> None:
    """At the rate at which it was recorded, the frames are the readings, but for the 24 bits of a float32."""
    recording = read_recording(bag)
    write_dataset([recording, recording], tmp_path / "set", FPS, "press", "bench")
    write_tables(tmp_path / "set", tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["episode_000000.csv", "episode_000001.csv"]
    again = read_recording(tmp_path / "out" / "episode_000001.csv")
    for name, stream in recording.wrenches.items():
        np.testing.assert_allclose(again.wrenches[name].force, stream.force, atol=1e-6)
    np.testing.assert_allclose(again.poses["ee"].position, recording.poses["ee"].position, atol=1e-7)
    assert len(again.poses["ee"]) == COUNT


def test_a_dataset_is_laid_out_as_its_readers_ask(bag: Path, tmp_path: Path) -> None:
    recording = read_recording(bag)
    write_dataset([recording, recording], tmp_path / "set", FPS, "press", "bench")
    info = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["total_episodes"] == 2 and info["fps"] == FPS
    assert info["total_frames"] == 2 * COUNT and info["splits"] == {"train": "0:2"}
    file = pq.ParquetFile(tmp_path / "set" / info["data_path"].format(chunk_index=0, file_index=0))
    assert file.num_row_groups == 2 and set(file.schema_arrow.names) == set(info["features"])
    table = file.read()
    for name, feature in info["features"].items():
        kind = table.schema.field(name).type
        (size,) = feature["shape"]
        value = kind if size == 1 else kind.value_type
        assert (size == 1 or kind.list_size == size) and str(value) in (feature["dtype"], "float")
        assert feature["names"] is None or len(feature["names"]) == size
    assert table.column("index").to_pylist() == list(range(2 * COUNT))
    assert table.column("episode_index").to_pylist() == [0] * COUNT + [1] * COUNT
    np.testing.assert_allclose(table.column("timestamp").to_pylist()[:COUNT], np.arange(COUNT) / FPS, atol=1e-6)
    episodes = pq.read_table(tmp_path / "set" / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    assert [(e["dataset_from_index"], e["dataset_to_index"]) for e in episodes] == [(0, COUNT), (COUNT, 2 * COUNT)]
    assert episodes[0]["tasks"] == ["press"] and episodes[0]["data/file_index"] == 0
    assert len(episodes[0]["stats/observation.state/mean"]) == 7
    tasks = pq.read_table(tmp_path / "set" / "meta" / "tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0], "task": ["press"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    stats = json.loads((tmp_path / "set" / "meta" / "stats.json").read_text())
    np.testing.assert_allclose(stats["observation.state"]["max"][0], 1e-5 * (COUNT - 1), rtol=1e-6)


def test_a_recording_of_a_rig_is_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Markers and tracks that are lost are no numbers in frames, and none in tables."""
    rig = load_rig("strip_coarse")
    simulate_to_bag(rig, load_experiment("pull_taut"), tmp_path / "bag")
    given = ["strip_coarse", str(tmp_path / "bag"), "--out", str(tmp_path / "set"), "--fps", "15"]
    assert main(["lerobot", "export", *given]) == 0
    assert "1 episodes" in capsys.readouterr().out
    assert main(["lerobot", "import", str(tmp_path / "set"), "--out", str(tmp_path / "out")]) == 0
    assert "table_columns" not in capsys.readouterr().out
    assert main(["inspect", str(tmp_path / "out" / "episode_000000.csv"), "--rig", "strip_coarse"]) == 0
    said = capsys.readouterr().out
    for words in ("/current_pose", "/target_pose", "/wrench", "/marker_tracks"):
        assert words in said
    assert "stops a fit" not in said
