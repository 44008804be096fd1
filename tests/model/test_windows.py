"""Windows of a recording: simulated by themselves they give what the whole recording has there."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from sim_core.errors import ConfigError, RecordingError
from sim_core.rigs import Rig, load_rig, with_parameters
from sim_core.rigs.motion import Experiment
from sysid.diagnosis import diagnose_runs
from sysid.fit import FitOptions, fit_runs
from sysid.model.load import load_run, load_runs
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.predictor import SerialPredictor
from sysid.model.provenance import provenance
from sysid.model.windows import not_from_rest, window_of
from sysid.noise.data_quality import data_quality_warnings
from sysid.observations.observations import Run, check_apart
from sysid.observations.selection import Part, check_parts, part_of
from sysid.simulate import simulate_to_bag
from sysid.workflow import fit_bags

TRUTH = {"card.E_pa": 2.6e9}
REST_S = 2.0
"""The card rings down in half of it."""


def press(depth_m: float) -> list[dict[str, Any]]:
    """Down on the card, up again, and rest; 0.6 s and the rest."""
    poses = [{"position_m": [0.0, 0.0, -depth_m]}, {"position_m": [0.0, 0.0, 0.0]}]
    return [
        {"type": "waypoints", "speed_m_s": 0.1, "hold_s": 0.1, "poses": poses},
        {"type": "wait", "duration_s": REST_S},
    ]


@pytest.fixture(scope="module")
def rig(small_rig: Callable[..., Rig]) -> Rig:
    return small_rig()


@pytest.fixture(scope="module")
def session(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two presses, the second deeper and from 2.5 s on."""
    bag = tmp_path_factory.mktemp("session") / "session"
    motion = [{"type": "wait", "duration_s": 0.1}, *press(0.011), *press(0.013)]
    experiment = Experiment.model_validate({"name": "session", "motions": {"finger": motion}})
    simulate_to_bag(with_parameters(rig, TRUTH), experiment, bag, seed=3)
    return bag


def moving(run: Run) -> np.ndarray:
    """Times [s] at which the finger moves."""
    trajectory = run.poses["finger"]
    return np.asarray(trajectory.times[:-1][trajectory.speeds()[0] > 1e-3])


@pytest.fixture(scope="module")
def second(rig: Rig, session: Path) -> float:
    """When the second press begins [s], at a whole number of steps."""
    (run,), _ = load_runs(rig, [session])
    times = moving(run)
    return rig.solver.dt_s * int(float(times[1:][np.diff(times) > 0.5 * REST_S][0]) / rig.solver.dt_s - 2)


def test_a_window_is_predicted_as_the_whole_recording_is_there(rig: Rig, session: Path, second: float) -> None:
    (whole, part), _ = load_runs(rig, [session, Path(f"{session}@{second}:9")])
    assert part.end == pytest.approx(whole.end - second, abs=1e-9) and part.end < 0.6 * whole.end
    engine = SerialPredictor()
    there, here = (engine.predict(rig, run).values for run in (whole, part))
    for m, n in zip(whole.measured, part.measured, strict=True):
        inside = m.t >= second
        assert np.array_equal(m.values[inside], n.values, equal_nan=True)
        strongest = np.nanmax(np.abs(there[m.channel] - there[m.channel][0]))
        assert np.nanmax(np.abs(there[m.channel][inside] - here[n.channel])) < 2e-3 * strongest
    assert part.notes == ("The window ends at 9 s, the recording's readings at 5.400 s.",), (
        "the others are reported once"
    )


@pytest.mark.slow
def test_one_press_is_fitted_and_the_other_held_out(
    rig: Rig, session: Path, second: float, workers: ParallelPredictor
) -> None:
    parts = Path(f"{session}@0:{second}"), Path(f"{session}@{second}:9")
    runs, held_out = load_runs(rig, parts[:1], parts[1:])
    start = with_parameters(rig, {"card.E_pa": 1.0e9})
    result, _ = fit_runs(start, runs, ["card.E"], FitOptions(nuisance=("none",)), held_out=held_out, engine=workers)
    (found,) = result.estimates
    assert found.ci95[0] <= TRUTH["card.E_pa"] <= found.ci95[1]
    scores = {(e.run, e.channel): e for e in result.errors if e.held_out}
    assert {run for run, _ in scores} == {f"session@{second}:9"}
    side = next(e for (_, channel), e in scores.items() if channel == "side")
    assert side.after < 1.4 * side.noise < 0.5 * side.before


def test_a_window_that_begins_in_the_middle_of_things_says_so(rig: Rig, session: Path, second: float) -> None:
    (run,), _ = load_runs(rig, [session])
    times = moving(run)
    coming = window_of(rig, run, Part(session, float(times[times > second][5]), 9.0))
    assert any("finger moves in the 0.2 s before the window begins" in note for note in coming.notes)
    deepest = float(run.poses["finger"].times[np.argmin(run.poses["finger"].positions[:, 2])]) + 0.08
    pressed = window_of(rig, run, Part(session, deepest, 9.0))
    notes = not_from_rest(rig, pressed)
    assert {note.split(":")[0] for note in notes} == {"markers", "side", "wrench"}
    assert all("standard deviations from rest" in note for note in notes)


def test_where_nothing_was_measured(rig: Rig, session: Path) -> None:
    with pytest.raises(RecordingError, match=r"nothing was measured from 70 to 80 s\. The recording has readings"):
        load_runs(rig, [Path(f"{session}@70:80")])


def test_free_bodies_are_nowhere_in_the_middle_of_a_recording(tmp_path: Path) -> None:
    rig, bag = load_rig("push_block"), tmp_path / "bag"
    motion = {"finger": [{"type": "wait", "duration_s": 0.1}]}
    simulate_to_bag(rig, Experiment.model_validate({"name": "wait", "motions": motion}), bag)
    with pytest.raises(ConfigError, match=r"bodies that lie free.*Begin the window at 0 s"):
        load_runs(rig, [Path(f"{bag}@0.05:1")])
    assert load_runs(rig, [Path(f"{bag}@0:1")])[0]


def test_rest_is_that_of_the_rig_that_was_fitted(rig: Rig, session: Path, second: float) -> None:
    """A sag of the card that has not changed does not depend on it."""
    (run,), _ = load_runs(with_parameters(rig, {"card.E_pa": 1.3e9}), [Path(f"{session}@{second}:9")])
    for stiffness in (1.3e9, TRUTH["card.E_pa"]):
        assert not_from_rest(with_parameters(rig, {"card.E_pa": stiffness}), run) == []
    assert not_from_rest(rig, load_runs(rig, [session])[0][0]) == []


def test_noise_that_repeats_itself_is_no_motion(rig: Rig, session: Path, second: float) -> None:
    """A filtered wrench: the mean of 0.2 s is as uncertain as its few independent readings make it."""
    (run,), _ = load_runs(rig, [session])
    for seed in range(12):
        rng = np.random.default_rng(seed)
        measured = []
        for m in run.measured:
            if m.channel == "wrench":
                noise = lfilter([np.sqrt(1.0 - 0.95**2)], [1.0, -0.95], rng.standard_normal(m.values.shape), axis=0)
                m = replace(m, values=m.values + noise * np.repeat([5e-3, 5e-5], 3))
            measured.append(m)
        filtered = replace(run, measured=tuple(measured))
        assert not_from_rest(rig, window_of(rig, filtered, Part(session, second, 9.0))) == []


def test_a_pose_that_is_measured_with_noise_stands_still(rig: Rig, session: Path, second: float) -> None:
    (run,), _ = load_runs(rig, [session])
    poses = run.poses["finger"]
    for seed in range(12):
        noise = 1e-4 * np.random.default_rng(seed).standard_normal(poses.positions.shape)
        noisy = replace(run, poses={"finger": replace(poses, positions=poses.positions + noise)})
        part = window_of(rig, noisy, Part(session, second, 9.0))
        assert not any("moves" in note for note in part.notes) and set(part.changes) == {"markers", "side", "wrench"}


def test_the_drift_of_a_sensor_goes_on(rig: Rig, session: Path, second: float) -> None:
    offset = {f"{kind}_{axis}_{unit}": 0.0 for kind, unit in (("bias", "n"), ("drift", "n_per_s")) for axis in "xyz"}
    offset["drift_z_n_per_s"] = 0.5
    drifting = rig.model_copy(update={"effects": {"wrench_offset": offset}})
    (whole, part), _ = load_runs(drifting, [session, Path(f"{session}@{second}:9")])
    engine = SerialPredictor()
    there, here = (engine.predict(drifting, run).values["wrench"] for run in (whole, part))
    inside = next(m.t for m in whole.measured if m.channel == "wrench") >= second
    rest = 5
    np.testing.assert_allclose(here[:rest], there[inside][:rest], atol=1e-4)
    assert here[0, 2] - there[0, 2] == pytest.approx(0.5 * second, rel=0.02)


def test_windows_that_meet_share_no_reading(rig: Rig, session: Path, second: float) -> None:
    (whole, before, after), _ = load_runs(rig, [session, Path(f"{session}@0:{second}"), Path(f"{session}@{second}:9")])
    for m, a, b in zip(whole.measured, before.measured, after.measured, strict=True):
        assert len(a.t) + len(b.t) == len(m.t)
        assert a.t[-1] < second and b.t[0] >= 0.0


def test_a_result_says_which_window_it_is_of(rig: Rig, session: Path, second: float) -> None:
    (run,), _ = load_runs(rig, [Path(f"{session}@{second}:9")])
    recorded = provenance(rig, [run], [], 0, FitOptions(starts=2, bounds={"gel.E_pa": (1e4, np.inf)}).to_json())
    assert recorded["bags"][0]["window_s"] == [second, 9.0]
    assert recorded["options"]["starts"] == 2 and recorded["options"]["bounds"] == {"gel.E_pa": [1e4, None]}
    assert recorded["settings"]["uncertainty"]["conflict_sd"] == 3.0
    json.dumps(recorded, allow_nan=False)


def test_a_channel_without_readings_in_a_window_is_reported(rig: Rig, session: Path) -> None:
    (run,), _ = load_runs(rig, [session])
    late = tuple(replace(m, values=np.where(m.t[:, None] > 1.0, np.nan, m.values)) if m.channel == "side" else m
                 for m in run.measured)  # fmt: skip
    part = window_of(rig, replace(run, measured=late), Part(session, 2.0, 9.0))
    assert {m.channel for m in part.measured} == {"wrench", "markers"}
    assert "side: no reading from 2 to 9 s" in part.notes and "side: no reading from 2 to 9 s" in part.doubts
    assert any(note.startswith("The window ends at 9 s, the recording's readings at 5.") for note in part.notes)


def test_what_is_missing_is_counted_in_the_window(rig: Rig, tmp_path: Path) -> None:
    """Components that are not finite, by the window that they are in; components and markers that it has none of."""
    bag = tmp_path / "bag"
    motion = {"finger": [{"type": "wait", "duration_s": 0.6}]}

    def gaps(channel: str, kind: str, stamps: np.ndarray, clean: np.ndarray) -> np.ndarray:
        noisy = np.zeros(clean.shape)
        since = stamps - stamps[0]
        if kind == "wrench":
            noisy[:4, 0] = np.nan
            noisy[since > 0.3, 5] = np.nan
        if channel == "side":
            noisy[since > 0.3, 2] = np.nan
        return noisy

    simulate_to_bag(rig, Experiment.model_validate({"name": "wait", "motions": motion}), bag, noise=gaps)
    heard: list[str] = []
    (whole, first, last), _ = load_runs(rig, [bag, Path(f"{bag}@0:0.3"), Path(f"{bag}@0.4:9")], on_warning=heard.append)
    late = int(np.isnan(next(m for m in last.measured if m.channel == "wrench").values[:, 5]).sum())
    counted = [next(n for n in run.doubts if "NaN" in n) for run in (whole, first, last)]
    assert int(counted[0].split()[1]) > 4 + late
    assert counted[1:] == [f"/wrench: {n} messages with NaN or infinite components, masked" for n in (4, late)]
    (silent,) = (n for n in last.doubts if "no reading" in n)
    assert silent.startswith("wrench: no reading of torque z from 0.4 to 9 s, which the rig says to be measured.")
    assert heard == [f"{run.name}: {n}" for run in (whole, first, last) for n in run.doubts]
    assert any(re.fullmatch(r"side: no reading of the markers \d+ from 0\.4 to 9 s", n) for n in last.notes)
    assert not any("no reading" in n for run in (whole, first) for n in run.notes)
    assert "4 messages" in data_quality_warnings(rig, [first])[0]
    alone = [load_run(rig, path) for path in (bag, Path(f"{bag}@0.4:9"))]
    assert [(run.since, run.doubts) for run in alone] == [(0.0, whole.doubts), (0.4, last.doubts)]


@pytest.mark.parametrize(
    ("name", "bag", "begin", "end"),
    [
        ("a.bag", "a.bag", 0.0, np.inf),
        ("a.bag@0:12.5", "a.bag", 0.0, 12.5),
        ("a.bag@1e1:20", "a.bag", 10.0, 20.0),
        ("a@3:4.bag", "a@3:4.bag", 0.0, np.inf),
        ("me@home@3:4", "me@home", 3.0, 4.0),
        ("a@3:4", "a@3:4", 0.0, np.inf),
    ],
)
def test_names(tmp_path: Path, name: str, bag: str, begin: float, end: float) -> None:
    """Those of recordings that are there, which may look like a window."""
    (tmp_path / bag).mkdir()
    assert part_of(tmp_path / name) == Part(tmp_path / bag, begin, end)


@pytest.mark.parametrize("window", ["4:3", "3:3", "1.2.3:4", "12:", ":20", "12", "-1:3", "5s:9s", "1:inf", "nan:2"])
def test_windows_of_nothing(tmp_path: Path, window: str) -> None:
    (tmp_path / "a").mkdir()
    with pytest.raises(ConfigError, match=r"names no window of .*a\. Write for example .*a@12\.5:20"):
        part_of(tmp_path / f"a@{window}")


@pytest.mark.parametrize(
    ("given", "held_out", "words"),
    [
        (["a@0:3", "a@3:5", "b"], ["a@5:6"], ""),
        (["a@0:3", "a@2:5"], [], "Of .*a the readings from 2 to 3 s are given twice"),
        (["a@0:3"], ["a"], "Of .*a the readings from 0 to 3 s are given both to use and to hold out"),
        (["a", "b/../a"], [], "The recording .* is given twice"),
        (["c@0:3"], [], "The recording .*c@0:3 does not exist"),
    ],
)
def test_no_reading_is_named_twice(tmp_path: Path, given: list[str], held_out: list[str], words: str) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
    paths = [[tmp_path / name for name in names] for names in (given, held_out)]
    if not words:
        check_parts(*paths)
        return
    with pytest.raises(RecordingError, match=words):
        check_parts(*paths)


@pytest.fixture(scope="module")
def copies(session: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The session, its only file, and a copy of it under another name."""
    copy = tmp_path_factory.mktemp("copies") / "other"
    shutil.copytree(session, copy)
    (inside,) = session.glob("*.mcap")
    return {"bag": session, "file": inside, "copy": copy}


@pytest.mark.parametrize(
    ("given", "held_out", "words"),
    [
        (["bag", "file"], [], r"mcap, which has readings of .*session, is given twice"),
        (["bag"], ["copy"], r"other, which has readings of .*session, is given both to use and to hold out"),
        (["bag@0:2"], ["copy@1:3"], r"Of .*other, which .* the readings from 1 to 2 s are given both"),
        (["copy@0:2"], ["file"], r"the readings from 0 to 2 s are given both"),
    ],
)
def test_one_recording_under_two_names(
    rig: Rig, copies: dict[str, Path], tmp_path: Path, given: list[str], held_out: list[str], words: str
) -> None:
    """Fits and diagnoses know it by its content, from paths and from runs at hand."""
    bags, kept = ([Path(re.sub(r"^\w+", lambda m: str(copies[m[0]]), name)) for name in n] for n in (given, held_out))
    with pytest.raises(RecordingError, match=words):
        fit_bags(rig, bags, ["card.E"], held_out=kept, out=tmp_path / "fit")
    runs, others = load_runs(rig, bags, kept)
    with pytest.raises(RecordingError, match=words):
        fit_runs(rig, runs, ["card.E"], held_out=others)
    with pytest.raises(RecordingError, match=words):
        diagnose_runs(rig, runs, others)


def test_windows_of_copies_that_do_not_meet(rig: Rig, copies: dict[str, Path], second: float) -> None:
    check_apart(*load_runs(rig, [Path(f"{copies['bag']}@0:{second}")], [Path(f"{copies['copy']}@{second}:9")]))


def test_a_file_of_a_split_recording_has_readings_of_it(rig: Rig, session: Path) -> None:
    """Its time begins elsewhere, so windows of the two are not compared."""
    (run,), _ = load_runs(rig, [session])
    whole = replace(run, sha256=("a", "b"), until=1.0)
    second = replace(run, path="second.mcap", sha256=("b",), since=2.0, until=3.0)
    with pytest.raises(RecordingError, match=r"second\.mcap, which has readings of .*, is given twice"):
        check_apart([whole, second])
    check_apart([whole, replace(second, sha256=("c",)), replace(run, sha256=()), replace(run, sha256=())])
