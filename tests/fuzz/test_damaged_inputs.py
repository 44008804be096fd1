"""Whatever is wrong with an input, it is read or refused in one sentence."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import pytest
from damage import CORPUS, KINDS, STRUCTURED, VALUES, damaged, judge, sound

hypothesis = pytest.importorskip("hypothesis", reason="hypothesis is not installed")
from hypothesis import HealthCheck, given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

EXAMPLES = 12
"""Damaged inputs of each kind in a run of the tests; ``damage.py`` looks for more."""

WHERE = st.floats(0.0, 1.0, exclude_max=True)
BYTES = st.tuples(st.sampled_from(KINDS), WHERE, st.sampled_from([1, 3, 7, 64, 255, 4096]))
MEANING = st.tuples(st.sampled_from(VALUES), WHERE, st.integers(0, 255))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return sound(tmp_path_factory.mktemp("sound"))


NAMES = (
    "mcap", "mcap_records", "mcap_plain", "mcap_lz4", "db3", "db3_messages", "metadata", "rosbag1", "csv", "rig",
    "picture", "mesh_obj", "mesh_stl", "mesh_ply", *STRUCTURED,
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_sound_inputs_are_read(inputs: dict[str, Path], name: str, tmp_path: Path) -> None:
    assert set(inputs) == set(NAMES)
    assert judge(name, inputs[name], [], tmp_path) == ""


@pytest.mark.parametrize("name", NAMES)
def test_damaged_inputs_are_read_or_refused(inputs: dict[str, Path], name: str) -> None:
    @settings(
        max_examples=EXAMPLES, deadline=None, derandomize=True, database=None,
        suppress_health_check=[HealthCheck.too_slow],
    )  # fmt: skip
    @given(edits=st.lists(MEANING if name in STRUCTURED else BYTES, min_size=1, max_size=4))
    def check(edits: list[tuple[str, float, int]]) -> None:
        with tempfile.TemporaryDirectory() as folder:
            assert judge(name, inputs[name], edits, Path(folder)) == ""

    check()


@pytest.mark.parametrize("kept", sorted(CORPUS.glob("*.json")), ids=lambda path: path.stem)
def test_what_once_failed_does_not_again(inputs: dict[str, Path], kept: Path, tmp_path: Path) -> None:
    case = json.loads(kept.read_text(encoding="utf-8"))
    assert judge(case["input"], inputs[case["input"]], [tuple(edit) for edit in case["edits"]], tmp_path) == ""


def test_an_error_of_the_program_would_be_seen(inputs: dict[str, Path], tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("damage.read_recording", lambda *_args, **_options: {}["missing"])
    assert judge("mcap", inputs["mcap"], [], tmp_path).startswith("KeyError")
    assert damaged(b"abc", [("flip", 0.5, 0), ("cut", 0.9, 1)]) == b"ac"
