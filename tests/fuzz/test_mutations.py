"""Whatever a bag, a rig, a mesh or a table says instead: no defect, nothing whole lost, what is lost is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mutations import COUNT, Trial, bag, faults, messages, put, write

from sysid.recording import read_recording

FEW, MANY = 25, 2000


def test_a_few_mutations() -> None:
    assert faults(100_000, FEW) == []


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_many_mutations() -> None:
    assert faults(0, MANY) == []


def test_a_loss_without_a_word_would_be_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trial = Trial(tmp_path)
    assert [trial.judge(seed)[1] for seed in range(3)] == [""] * 3
    trial.whole["/wrench"] += 5
    trial.whole["/marker_tracks"] += 5
    seen = [trial.judge(seed)[1] for seed in range(40)]
    assert any("lost for" in fault for fault in seen)
    monkeypatch.setattr("mutations.examine", lambda *_: {}["missing"])
    assert any(trial.judge(seed)[1].startswith("KeyError") for seed in range(40))


@pytest.mark.parametrize(
    ("topic", "way", "value", "words"),
    [
        ("/wrench", ("header", "frame_id"), "g\x00l", "of another frame dropped"),
        ("/current_pose", ("pose", "position", "x"), float("nan"), "holds NaN or infinity"),
    ],
)
def test_what_one_message_costs_is_said_with_topic_and_time(
    tmp_path: Path, topic: str, way: tuple[str, ...], value: object, words: str
) -> None:
    items = messages(bag(tmp_path / "bag"))
    mine = [item for item in items if item[0] == topic]
    put(mine[7][3], way, value)
    write(tmp_path / "changed", items)
    recording = read_recording(tmp_path / "changed", need_pose=False)
    (stream,) = (s for _, _, s in recording.streams() if s.topic == topic)
    assert len(stream) == COUNT - 1
    (note,) = (n for n in recording.warnings if n.channel == topic)
    assert words in note.text and "recorded 0.070 s after the first of this topic" in note.text
    assert np.isfinite(stream.t).all()
