"""Windows of a recording: simulated by themselves they give what the whole recording has there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_core.errors import ConfigError, RecordingError
from sim_core.rigs import Rig, load_rig, with_parameters
from sim_core.rigs.motion import Experiment
from sysid.fit import FitOptions, fit_runs
from sysid.fit.engine import Engine
from sysid.fit.pool import PooledEngine
from sysid.fit.runs import Run, load_runs
from sysid.fit.windows import window_of
from sysid.parts import Part, check_parts, part_of
from sysid.simulate import simulate_to_bag

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
    bag = tmp_path_factory.mktemp("session") / "session.bag"
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
    engine = Engine()
    there, here = (engine.predict(rig, run).values for run in (whole, part))
    for m, n in zip(whole.measured, part.measured, strict=True):
        inside = m.t >= second
        assert np.array_equal(m.values[inside], n.values, equal_nan=True)
        strongest = np.nanmax(np.abs(there[m.channel] - there[m.channel][0]))
        assert np.nanmax(np.abs(there[m.channel][inside] - here[n.channel])) < 2e-3 * strongest
    assert part.notes == whole.notes


def test_one_press_is_fitted_and_the_other_held_out(
    rig: Rig, session: Path, second: float, workers: PooledEngine
) -> None:
    parts = Path(f"{session}@0:{second}"), Path(f"{session}@{second}:9")
    runs, held_out = load_runs(rig, parts[:1], parts[1:])
    start = with_parameters(rig, {"card.E_pa": 1.0e9})
    result, _ = fit_runs(start, runs, ["card.E"], FitOptions(nuisance=("none",)), held_out=held_out, engine=workers)
    (found,) = result.estimates
    assert found.ci95[0] <= TRUTH["card.E_pa"] <= found.ci95[1]
    scores = {(e.run, e.channel): e for e in result.errors if e.held_out}
    assert {run for run, _ in scores} == {f"session.bag@{second}:9"}
    side = next(e for (_, channel), e in scores.items() if channel == "side")
    assert side.after < 1.4 * side.noise < 0.5 * side.before


def test_a_window_that_begins_in_the_middle_of_things_says_so(rig: Rig, session: Path, second: float) -> None:
    (run,), _ = load_runs(rig, [session])
    times = moving(run)
    coming = window_of(rig, run, Part(session, float(times[times > second][5]), 9.0))
    assert any("begins while finger moves" in note for note in coming.notes)
    deepest = float(run.poses["finger"].times[np.argmin(run.poses["finger"].positions[:, 2])]) + 0.08
    pressed = window_of(rig, run, Part(session, deepest, 9.0))
    told = [note for note in pressed.notes if "standard deviations from rest" in note]
    assert {note.split(":")[0] for note in told} == {"markers", "side", "wrench"}


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


def test_a_wrong_rig_does_not_make_rest_look_otherwise(rig: Rig, session: Path, second: float) -> None:
    """The sag of the card is not that of the data, but has not changed."""
    soft = with_parameters(rig, {"card.E_pa": 1.3e9, "gel.E_pa": 2e5})
    (run,), _ = load_runs(soft, [Path(f"{session}@{second}:9")])
    assert not any("rest" in note for note in run.notes)


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("a.bag", Part(Path("a.bag"))),
        ("x/a.bag@0:12.5", Part(Path("x/a.bag"), 0.0, 12.5)),
        ("a@3:4.bag", Part(Path("a@3:4.bag"))),
        ("me@home@3:4", Part(Path("me@home"), 3.0, 4.0)),
    ],
)
def test_names(name: str, part: Part) -> None:
    assert part_of(Path(name)) == part


def test_a_recording_may_have_a_name_like_a_window(tmp_path: Path) -> None:
    (tmp_path / "a@3:4").mkdir()
    assert part_of(tmp_path / "a@3:4") == Part(tmp_path / "a@3:4")


@pytest.mark.parametrize("name", ["a@4:3", "a@3:3", "a@1.2.3:4"])
def test_windows_of_nothing(name: str) -> None:
    with pytest.raises(ConfigError, match="names no window"):
        part_of(Path(name))


@pytest.mark.parametrize(
    ("given", "held_out", "words"),
    [
        (["a@0:3", "a@3:5", "b"], ["a@5:6"], ""),
        (["a@0:3", "a@2:5"], [], "The window .*a@2:5 is given twice"),
        (["a@0:3"], ["a"], "The window .*a is given both to use and to hold out"),
        (["a", "b/../a"], [], "The recording .* is given twice"),
        (["c@0:3"], [], "The recording .*c does not exist"),
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
