"""What parameters of the node that fits stand for, and what it says of a fit. Needs no ROS."""

import math
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="thinshell_ros needs the ROS message packages")

from sim_core.errors import ConfigError, ThinshellError
from sim_core.rigs import Rig, list_parameters, load_rig
from sysid.fit.multistart import Step
from thinshell_ros.fit_request import FitRequest, fit_request, numbers_of, topic_names, with_topics
from thinshell_ros.job_process import Failed, Share, Succeeded
from thinshell_ros.job_state import JobState

NONE: dict[str, Any] = {
    "held_out_uri": "", "fit.initial": None, "fit.lower": None, "fit.upper": None, "fit.max_iterations": 50,
    "fit.seed": 3, "fit.nuisance": "all", "fit.parameters": ["strip.E", "strip.nu"], "fit.prior_sd": None,
    "fit.per_bag": None, "fit.starts": 1, "fit.profile": False, "fit.robust": True,
}  # fmt: skip


@pytest.fixture
def rig() -> Rig:
    return load_rig(Path(__file__).parent / "data" / "pull_coarse.yaml")


def request_of(rig: Rig, folder: Path, **values: Any) -> FitRequest:
    for name in ("one", "two"):
        (folder / name).mkdir(exist_ok=True)
    given = {k.replace("__", "."): v for k, v in values.items()}
    asked = {"bag_uri": str(folder / "one"), "output_dir": str(folder / "fits"), **NONE, **given}
    return fit_request(rig, {}, asked, "fit_7")


def test_values_become_arguments(rig: Rig, tmp_path: Path) -> None:
    asked = request_of(
        rig, tmp_path, held_out_uri=[str(tmp_path / "two")], fit__initial=[5e9, 0.3], fit__lower=[1e9, 0.1],
        fit__nuisance="time, bias",
    )  # fmt: skip
    assert asked.bags == (tmp_path / "one",)
    assert asked.held_out == (tmp_path / "two",)
    assert asked.names == ("strip.E_pa", "strip.nu")
    assert asked.options.bounds == {"strip.E_pa": (1e9, math.inf), "strip.nu": (0.1, math.inf)}
    assert {p.name: p.value for p in list_parameters(asked.rig)}["strip.E_pa"] == 5e9
    assert asked.options.kinds == {"time", "bias"}
    assert (asked.options.max_evaluations, asked.options.seed) == (50, 3)
    assert asked.out == tmp_path / "fits" / "fit_7"
    assert (tmp_path / "fits").is_dir()


def test_what_is_known_before_and_how_it_is_searched(rig: Rig, tmp_path: Path) -> None:
    bags = [str(tmp_path / "one"), str(tmp_path / "two")]
    asked = request_of(
        rig, tmp_path, bag_uri=bags, fit__initial=[5e9, 0.3], fit__prior_sd=[1e8, 0.0], fit__per_bag=["strip.nu"],
        fit__starts=3, fit__profile=True, fit__robust=False,
    )  # fmt: skip
    assert not asked.options.robust
    assert asked.options.priors == {"strip.E_pa": (5e9, 1e8)}
    assert (asked.options.per_bag, asked.options.starts, asked.options.intervals) == (["strip.nu"], 3, "profiled")
    plain = request_of(rig, tmp_path).options
    assert (plain.priors, plain.per_bag, plain.starts, plain.intervals) == ({}, [], 1, "checked")
    assert plain.robust


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"bag_uri": []}, "no recording to fit"),
        ({"bag_uri": ["one", 2]}, "Give a path or a list of paths"),
        ({"fit__parameters": None}, "not said what to fit"),
        ({"fit__upper": [5e9, math.nan]}, "one finite number"),
        ({"fit__lower": [1e9, 0.4], "fit__upper": [9e9, 0.39]}, "strip.nu leave nothing between 0.4 and 0.39"),
        ({"fit__upper": [4e9, 0.4]}, "above 4e+09 Pa"),
        ({"fit__prior_sd": [1e8, 0.1]}, "fit.initial does not say which"),
        ({"fit__initial": [5e9, 0.3], "fit__prior_sd": [-1e8, 0.1]}, "no value with a standard deviation"),
        ({"fit__per_bag": ["gel.E"]}, "gel.E"),
    ],
)
def test_values_that_cannot_be_used_are_refused(rig: Rig, tmp_path: Path, values: dict[str, Any], words: str) -> None:
    with pytest.raises(ThinshellError, match="(?s)" + words.replace("+", r"\+")):
        request_of(rig, tmp_path, **values)


def test_topics_are_renamed_one_by_one(rig: Rig) -> None:
    names = topic_names(rig)
    assert names["gripper.current_pose"] == "current_pose"
    assert names["load_cell"] == "wrench"
    changed = {name: f"other/{topic}" for name, topic in names.items()}
    assert topic_names(with_topics(rig, changed)) == changed
    assert topic_names(with_topics(rig, {"load_cell": "ft"})) == {**names, "load_cell": "ft"}
    assert with_topics(rig, names) == rig


def test_the_state_follows_the_fit(rig: Rig, tmp_path: Path) -> None:
    asked = request_of(rig, tmp_path)
    state = JobState("fit_7", "running", "starting", 50)
    report = state.report(1.0)
    assert (report.level, report.message) == ("ok", "running")
    assert report.values["eta_s"] == "nan"
    assert state.estimate() == {}
    state.take(Share(0.2, "evaluation 2"), asked)
    state.take(Step(2, 7.5, {"strip.E_pa": 4e9}), asked)
    values = state.report(3.0).values
    assert (values["iteration"], values["max_iterations"], values["loss"]) == ("2", "50", "7.5")
    assert values["eta_s"] == "12.0"  # a fifth took 3 s
    assert state.estimate() == {"strip.E_pa": 4e9}
    state.take(Failed("No."), asked)
    report = state.report(4.0)
    assert (report.level, report.message, report.values["detail"]) == ("error", "failed", "No.")


def test_standard_deviations_are_in_the_units_of_the_parameters(rig: Rig, tmp_path: Path) -> None:
    estimates = [
        {"name": "strip.E_pa", "value": 4e9, "sd": 0.01, "log": True, "ci95": [3.92e9, 4.08e9], "unit": "Pa"},
        {"name": "strip.nu", "value": 0.3, "sd": 0.01, "log": False, "ci95": [0.28, 0.32], "unit": ""},
    ]
    fit = {
        "rig": "pull", "estimates": estimates, "correlation": [[1.0, 0.2], [0.2, 1.0]], "misfit": 1.1,
        "converged": True, "identifiability": ["a"], "remarks": [], "cautions": [], "notes": ["b"], "unexplained": [],
        "undetermined": [], "no_success": "",
        "provenance": {"bags": [{"path": "one", "sha256": ["ab"]}], "versions": {"thinshell_ros": "0.1.0"}},
    }  # fmt: skip
    state = JobState("fit_7", "running")
    state.take(Succeeded(fit), request_of(rig, tmp_path))
    assert state.state == "succeeded"
    assert state.estimate() == {"strip.E_pa": 4e9, "strip.nu": 0.3}
    assert state.result["std"] == {"strip.E_pa": 4e7, "strip.nu": 0.01}
    assert state.result["bag_sha256"] == {"one": ["ab"]}
    assert state.result["code_version"] == {"thinshell_ros": "0.1.0"}
    assert state.result["loss"] == 1.1
    report = state.report(9.0)
    assert (report.level, report.values["loss"]) == ("ok", "1.1")
    assert state.result["remarks"] == ["a", "b"]


def test_a_fit_that_did_not_converge_is_a_warning(rig: Rig, tmp_path: Path) -> None:
    """It has ended and written its results, so its state is one of those that are known; the level and words differ."""
    fit = {
        "rig": "pull", "estimates": [], "correlation": [], "misfit": 40.0, "converged": False,
        "message": "the evaluations allowed, 2, are used up", "identifiability": ["a"], "remarks": [], "notes": [],
        "cautions": [], "unexplained": ["It leaves more than noise."], "undetermined": [], "no_success": "",
        "provenance": {"bags": [], "versions": {}},
    }  # fmt: skip
    state = JobState("fit_7", "running")
    asked = request_of(rig, tmp_path)
    state.take(Succeeded(fit), asked)
    report = state.report(9.0)
    words = "The fit did not converge: the evaluations allowed, 2, are used up. Take its values as a start"
    assert (report.level, report.message) == ("warn", "succeeded")
    assert report.values["detail"].startswith(words) and str(asked.out) in report.values["detail"]
    first, *others = state.result["remarks"]
    assert first.startswith(words) and others == ["It leaves more than noise.", "a"]


@pytest.mark.parametrize(
    ("changed", "first"),
    [
        ({"undetermined": ["strip.nu"]}, "The data do not determine strip.nu: 0 to 0.5 fit about as well."),
        ({"unexplained": ["The rig does not explain it."]}, "The rig does not explain it."),
    ],
)
def test_a_fit_that_needs_a_look_is_a_warning(
    rig: Rig, tmp_path: Path, changed: dict[str, list[str]], first: str
) -> None:
    """What is not determined is said before cautions and notes, and after what the rig does not explain."""
    fit = {
        "rig": "pull", "estimates": [], "correlation": [], "misfit": 1.0, "converged": True, "message": "",
        "identifiability": ["a", "The data do not determine strip.nu: 0 to 0.5 fit about as well."], "remarks": [],
        "cautions": ["c"], "notes": ["n"], "unexplained": [], "undetermined": [], "no_success": "",
        "provenance": {"bags": [], "versions": {}},
    }  # fmt: skip
    state = JobState("fit_7", "running")
    state.take(Succeeded({**fit, **changed}), request_of(rig, tmp_path))
    report = state.report(9.0)
    assert (report.level, report.message) == ("warn", "succeeded")
    assert report.values["detail"].startswith(first)
    assert state.result["remarks"][-3:] == ["c", "a", "n"]


def test_topics_that_a_recording_does_not_have_are_refused(rig: Rig, tmp_path: Path) -> None:
    """Those of the rig may be missing: a recording need not have all of them."""
    bag = Path(__file__).parents[2] / "bags" / "press_post"
    asked = {**NONE, "bag_uri": str(bag), "output_dir": str(tmp_path)}
    own = topic_names(rig)
    assert fit_request(rig, own, asked, "job").bags == (bag,)
    with pytest.raises(ThinshellError, match=r"topics.load_cell is 'ft/nope', and .*press_post has no such topic. It"):
        fit_request(rig, {**own, "load_cell": "ft/nope"}, asked, "job")
    assert fit_request(rig, {**own, "load_cell": "left/wrench"}, asked, "job").bags == (bag,)


def test_initial_values_outside_the_bounds_are_those_of_the_request(rig: Rig, tmp_path: Path) -> None:
    with pytest.raises(ThinshellError, match=r"fit.initial has 3e\+09 for strip.E_pa, .* 4e\+09 to inf. Start within"):
        request_of(rig, tmp_path, fit__parameters=["strip.E"], fit__initial=[3e9], fit__lower=[4e9])


@pytest.mark.parametrize(
    ("typed", "numbers"),
    [
        ([4.0e9], [4.0e9]),
        (["4.0e9", "1e3"], [4.0e9, 1e3]),
        ([4, 5], [4.0, 5.0]),
        ("4.0e9", [4.0e9]),
        (4.0, [4.0]),
        ([], []),
        ("", []),
        (None, []),
    ],
)
def test_numbers_are_taken_as_they_are_typed(typed: Any, numbers: list[float]) -> None:
    assert numbers_of(typed, "fit.initial") == numbers


@pytest.mark.parametrize("typed", [["stiff"], [True], "stiff", [b"\x01"]])
def test_what_is_no_list_of_numbers_is_refused(typed: Any) -> None:
    with pytest.raises(ConfigError, match=r"fit.initial is .*Give a list of numbers"):
        numbers_of(typed, "fit.initial")
