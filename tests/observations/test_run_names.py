"""Recordings of one name in different folders stay apart."""

from __future__ import annotations

from pathlib import Path

import pytest

import sysid.model.load
from sim_core.rigs import config_folder, load_rig
from sysid.model.load import load_runs
from sysid.observations.observations import Run, distinct_names, of_recording


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["x/press", "x/slide"], ["press", "slide"]),
        (["a/bag", "b/bag"], ["a/bag", "b/bag"]),
        (["a/bag/", "b/../b/bag", "c/other"], ["a/bag", "b/bag", "other"]),
        (["1/a/bag", "2/a/bag", "2/b/bag"], ["1/a/bag", "2/a/bag", "b/bag"]),
        (["/bag", "/a/bag"], ["/bag", "a/bag"]),
        ([], []),
    ],
)
def test_names_are_the_shortest_distinct_ends(paths: list[str], names: list[str]) -> None:
    assert distinct_names([Path(p) for p in paths]) == names


def test_bags_of_one_name_have_different_run_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").mkdir()
    monkeypatch.chdir(tmp_path / "a")
    assert distinct_names([Path("bag"), Path("../b/bag")]) == ["a/bag", "b/bag"]


def test_loaded_runs_have_these_names(small_rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sysid.model.load, "read_run", lambda rig, p, _: Run(p.name, str(p), (), {}, (), 1.0))
    runs, held_out = load_runs(small_rig(), [Path("a/bag")], [Path("b/bag"), Path("c")])
    assert [[r.name for r in group] for group in (runs, held_out)] == [["a/bag"], ["b/bag", "c"]]
    assert runs[0].path == "a/bag"


def test_what_speaks_against_recordings_is_heard_once_each(
    small_rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of another rig, and faults, held out or not; windows of one recording do not say it again."""
    monkeypatch.chdir(tmp_path)
    against = {"a": ("of another rig.", ()), "b": ("", ("gap", "stuck")), "c": ("", ())}
    for name in against:
        (tmp_path / name).touch()

    def load(rig: object, path: Path, despite: object) -> Run:
        unlike, doubts = against[path.name]
        return Run(path.name, str(path), (), {}, (), 9.0, unlike=unlike, doubts=doubts)

    monkeypatch.setattr(sysid.model.load, "read_run", load)
    monkeypatch.setattr("sysid.model.load.window_of", lambda rig, run, part: run)
    heard: list[str] = []
    load_runs(small_rig(), [Path("a@0:1"), Path("a@2:3"), Path("c")], [Path("b")], heard.append)
    assert heard == ["a: of another rig.", "b: gap", "b: stuck"]


def test_what_a_recording_lacks_is_reported_first_and_its_name_once() -> None:
    rig = load_rig("card_press")
    more = rig.sensors["wrench_gel"].model_copy(update={"topic": "arm/wrench"})
    heard: list[str] = []
    with_arm = rig.model_copy(update={"sensors": {**rig.sensors, "arm": more}})
    load_runs(with_arm, [config_folder().parent / "bags" / "press_post"], on_warning=heard.append)
    assert "press_post: arm/wrench: named by the rig, not in this recording" in heard
    assert of_recording("run", "run: cut short") == "run: cut short" and of_recording("run", "late") == "run: late"
