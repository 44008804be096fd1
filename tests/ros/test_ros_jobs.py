"""Jobs of the node: what they are asked, how they go on after a cancel, and what their actions carry. Needs no
running ROS."""

from __future__ import annotations

import array
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from small_task import small_task
from test_ros_fit_request import request_of
from test_ros_job_process import FIT, until

pytest.importorskip("rclpy", reason="thinshell_ros needs the ROS message packages")

from sim_core.errors import ConfigError
from sim_core.optimise import Settings
from sim_core.rigs import list_parameters, load_rig
from sim_core.rigs.schema import Known
from sysid.fit.multistart import Step
from sysid.workflow.optimise import optimise_task
from thinshell_ros import jobs as jobs_module
from thinshell_ros.fit_request import DiagnosisRequest, FitRequest
from thinshell_ros.job_actions import PARAMETERS, feedback_fields, given_by, result_fields
from thinshell_ros.job_process import Event, Failed, Succeeded
from thinshell_ros.job_state import JobState
from thinshell_ros.jobs import Jobs, new_id
from thinshell_ros.motion_request import OptimiseRequest, PlanRequest, optimise_request, plan_request

RIG = load_rig(Path(__file__).parent / "data" / "pull_coarse.yaml")
ACTIONS = Path(__file__).resolve().parents[2] / "interfaces" / "action"
NAMES = {"fit": "Fit", "diagnose": "Diagnose", "plan": "Plan", "optimise": "Optimise"}
PULL = str(Path(__file__).parent / "data" / "short_pull.yaml")


def parts(kind: str) -> list[dict[str, str]]:
    """Types of the fields of goal, result and feedback of an action, by their names."""
    text = re.sub(r"\s*#.*", "", (ACTIONS / f"{NAMES[kind]}.action").read_text())
    return [{n: t for t, n in map(str.split, filter(None, part.splitlines()))} for part in text.split("---")]


def empty_goal(kind: str, **given: Any) -> SimpleNamespace:
    """A goal as rclpy makes it where nothing is said."""
    plain = {"string": "", "uint32": 0, "string[]": [], "float64[]": array.array("d")}
    return SimpleNamespace(**{name: plain[word] for name, word in parts(kind)[0].items()} | given)


DIAGNOSED = {
    "rig": "pull", "verdict": "named", "sentence": "It slips.", "explained": True, "not_explained": [],
    "effects": [{"name": "static_friction", "probability": None}], "next_experiment": "", "amended_parameters": [],
    "baseline_parameters": [{"name": "strip.E_pa", "value": 4e9, "ci95": [3.9e9, 4.1e9], "unit": "Pa"}],
    "fit": {"amended": None, "baseline": {"training": 1.0}}, "notes": [], "provenance": {"bags": [], "versions": {}},
}  # fmt: skip
PLANNED = {
    "rig": "pull",
    "outlooks": [
        {
            "experiments": ["pull"], "correlation": [[1.0]], "sentences": [],
            "parameters": [
                {"name": "strip.E_pa", "unit": "Pa", "value": 4e9, "ci95": [3e9, 5e9], "sd": 0.1, "log": True,
                 "determined": True, "from_channels": {}},
            ],
        }
    ],
}  # fmt: skip
OPTIMISED = {"reward": 0.125, "success": True, "failures": [], "rollouts": 7}


def requests(folder: Path) -> dict[str, tuple[Any, dict[str, Any]]]:
    """A request of each kind, and what comes of it."""
    fit = request_of(RIG, folder)
    out = folder / "fits" / "job_7"
    return {
        "fit": (fit, FIT),
        "diagnose": (DiagnosisRequest(RIG, fit.bags, (), out), DIAGNOSED),
        "plan": (PlanRequest(RIG, (), ("strip.E_pa",), frozenset(), out), PLANNED),
        "optimise": (OptimiseRequest("small", None, Settings(), out), OPTIMISED),
    }


@pytest.mark.parametrize("kind", NAMES)
def test_actions_have_the_fields_that_the_node_fills(kind: str, tmp_path: Path) -> None:
    goal, result, feedback = parts(kind)
    assert set(goal) == PARAMETERS[kind].keys() | ({"resume"} & goal.keys())
    assert ("resume" in goal) == (kind in ("fit", "optimise"))
    request, found = requests(tmp_path)[kind]
    state = JobState("job_7", "running", "starting", kind=request.kind)
    assert set(feedback_fields(kind, state, 0.0)) == set(feedback)
    state.take(Succeeded(found), request)
    filled = result_fields(kind, state)
    assert set(filled) == set(result)
    assert json.loads(filled["json"])["job_id"] == "job_7"
    plain = {"string": str, "bool": bool, "float64": float, "string[]": list, "float64[]": list, "bool[]": list}
    assert all(isinstance(filled[name], plain[word]) for name, word in result.items())
    failed = JobState("job_7", "running")
    failed.take(Failed("It could not."), request)
    assert result_fields(kind, failed) == {"job_id": "job_7", "sentence": "It could not."}


def test_results_of_actions_carry_what_was_found(tmp_path: Path) -> None:
    filled = {}
    for kind, (request, found) in requests(tmp_path).items():
        state = JobState("job_7", "running", kind=request.kind)
        state.take(Succeeded(found), request)
        filled[kind] = result_fields(kind, state)
    fit, diagnosis, plan = filled["fit"], filled["diagnose"], filled["plan"]
    assert (fit["names"], fit["estimate"], fit["std"]) == (["strip.E_pa"], [4e9], [0.01 * 4e9])
    assert diagnosis["effects"] == ["static_friction"] and math.isnan(diagnosis["probability"][0])
    assert diagnosis["amended_rig"] == f"{tmp_path / 'fits' / 'job_7'}/amended_rig.yaml"
    assert (plan["lower"], plan["upper"], plan["determined"]) == ([3e9], [5e9], [True])
    assert (filled["optimise"]["reward"], filled["optimise"]["success"]) == (0.125, True)


@pytest.mark.parametrize("kind", ["plan", "optimisation"])
def test_the_process_of_a_job_plans_and_searches(kind: str, tmp_path: Path) -> None:
    """It writes what the node then publishes."""
    request: Any
    if kind == "plan":
        values = {
            "plan.experiments": [PULL],
            "fit.parameters": ["strip.E"],
            "fit.nuisance": "none",
            "output_dir": str(tmp_path),
        }
        request = plan_request(RIG, values, "job_7")
    else:
        small_task(tmp_path)
        request = OptimiseRequest(
            str(tmp_path / "small.yaml"), None, Settings("cem", rollouts=2, seed=1), tmp_path / "job_7"
        )
    jobs = Jobs(lambda events: None)
    jobs.start(request, "job_7")

    def ended() -> bool:
        jobs.poll()
        return not jobs.running

    try:
        until(ended)
    finally:
        jobs.end()
    assert jobs.state.state == "succeeded", jobs.state.doing
    assert (request.out / request.file).is_file()
    if kind == "plan":
        low, high = jobs.state.result["ci95"]["strip.E_pa"]
        assert low < {p.name: p.value for p in list_parameters(RIG)}["strip.E_pa"] < high  # type: ignore[operator]
    else:
        assert jobs.state.result["rollouts"] == 2


def test_a_goal_gives_what_is_neither_empty_nor_zero() -> None:
    assert given_by("fit", empty_goal("fit")) == {}
    goal = empty_goal("fit", parameters=["strip.E"], initial=array.array("d", [5e9]), max_iterations=7, resume="fit_1")
    assert given_by("fit", goal) == {"fit.parameters": ["strip.E"], "fit.initial": [5e9], "fit.max_iterations": 7}


def test_plans_and_optimisations_that_cannot_be_made_are_refused_with_a_remedy(tmp_path: Path) -> None:
    plan = {
        "plan.experiments": [PULL],
        "fit.parameters": ["strip.E"],
        "fit.nuisance": "all",
        "output_dir": str(tmp_path),
    }
    asked = plan_request(RIG, plan, "plan_7")
    assert (asked.names, asked.out, len(asked.experiments)) == (("strip.E_pa",), tmp_path / "plan_7", 1)
    for change, words in (
        ({"plan.experiments": None}, "plan.experiments"),
        ({"fit.parameters": []}, "fit.parameters"),
        ({"plan.experiments": ["no_such"]}, "no_such"),
    ):
        with pytest.raises(ConfigError, match=words):
            plan_request(RIG, plan | change, "plan_7")
    small_task(tmp_path)
    search = {
        "optimise.task": str(tmp_path / "small.yaml"), "optimise.rig": "", "optimise.method": "cma",
        "optimise.budget": 4, "optimise.seed": 3, "optimise.stop_at_success": False, "output_dir": str(tmp_path),
    }  # fmt: skip
    made = optimise_request(search, "optimisation_7")
    assert (made.settings.rollouts, made.settings.seed, made.rig) == (4, 3, None)
    for change, words in (
        ({"optimise.task": ""}, "optimise.task"),
        ({"optimise.method": "guess"}, "guess"),
        ({"optimise.rig": "no_such_rig"}, "no_such_rig"),
    ):
        with pytest.raises(ConfigError, match=words):
            optimise_request(search | change, "optimisation_7")
    with pytest.raises(ConfigError, match=r"no search in .*optimisation_7"):
        optimise_request(search, "optimisation_7", begun=True)


class Process:
    """Stands in for the process of a job: what it reports is put into ``left``."""

    def __init__(self, request: Any) -> None:
        self.left: list[Event] = []
        self.elapsed_s = 2.5

    def events(self) -> list[Event]:
        given, self.left = self.left, []
        return given

    def stop(self) -> None:
        return None


@pytest.fixture
def jobs(monkeypatch: pytest.MonkeyPatch) -> Jobs:
    monkeypatch.setattr(jobs_module, "JobProcess", Process)
    return Jobs(lambda events: None)


def report(jobs: Jobs, *events: Event) -> None:
    process: Any = jobs._process
    process.left = list(events)
    jobs.poll()


def test_one_job_runs_at_a_time(jobs: Jobs, tmp_path: Path) -> None:
    jobs.start(request_of(RIG, tmp_path), "fit_7")
    with pytest.raises(ConfigError, match="fit_7 is running"):
        jobs.start(request_of(RIG, tmp_path), "fit_8")
    assert jobs.cancel() == (True, "fit_7 was cancelled; nothing was written")
    assert jobs.cancel() == (False, "No job is running.")


def test_names_of_jobs_of_one_millisecond_differ_and_are_in_order() -> None:
    names = [new_id("fit") for _ in range(2000)]
    assert names == sorted(set(names))


def test_a_fit_goes_on_at_its_best_values_with_the_evaluations_that_are_left(jobs: Jobs, tmp_path: Path) -> None:
    asked = request_of(RIG, tmp_path, fit__initial=[5e9, 0.3], fit__prior_sd=[0.0, 0.05])
    jobs.start(asked, "fit_7")
    report(jobs, Step(20, 3.0, {"strip.E_pa": 4.2e9, "strip.nu": 0.35}))
    assert "~/resume begins at the best values" in jobs.cancel()[1]
    request, name = jobs.resumed()
    assert isinstance(request, FitRequest) and name != "fit_7" and request.out == asked.out.with_name(name)
    values = {p.name: p.value for p in list_parameters(request.rig)}
    assert values["strip.E_pa"] == 4.2e9
    assert values["strip.nu"] == 0.3, "what is known of it is known of this value"
    assert request.options == replace(asked.options, max_evaluations=30)
    jobs.start(request, name)
    report(jobs, Failed("The process of the job was ended by SIGKILL."))
    assert jobs.resumed(name)[0].out != request.out


def test_a_fit_does_not_go_on_from_values_that_the_rig_knows(jobs: Jobs, tmp_path: Path) -> None:
    rig = RIG.model_copy(update={"known": {"strip.nu": Known(sd=0.05)}})
    jobs.start(replace(request_of(RIG, tmp_path), rig=rig), "fit_7")
    before = {p.name: p.value for p in list_parameters(rig)}
    report(jobs, Step(20, 3.0, {"strip.E_pa": 4.2e9, "strip.nu": 0.35}))
    jobs.cancel()
    values = {p.name: p.value for p in list_parameters(jobs.resumed()[0].rig)}
    assert (values["strip.E_pa"], values["strip.nu"]) == (4.2e9, before["strip.nu"])


def test_a_search_that_goes_on_is_no_job_to_resume_and_begins_its_time_anew(jobs: Jobs, tmp_path: Path) -> None:
    request = requests(tmp_path)["optimise"][0]
    jobs.start(request, "optimisation_7")
    report(jobs)
    assert jobs.elapsed_s == 2.5
    jobs.cancel()
    assert jobs.knows("optimisation_7")
    jobs.start(*jobs.resumed())
    assert jobs.elapsed_s == 0.0 and not jobs.knows("optimisation_7")


def test_a_node_that_ends_says_what_its_job_leaves(jobs: Jobs, tmp_path: Path) -> None:
    assert jobs.end() == ""
    jobs.start(request_of(RIG, tmp_path), "fit_7")
    assert jobs.end() == "fit_7 was cancelled; nothing was written."
    jobs.cancel()
    request = requests(tmp_path)["optimise"][0]
    jobs.start(request, "optimisation_7")
    assert jobs.end() == f"optimisation_7 was cancelled; what it has tried is in {request.out}."


def test_what_cannot_go_on_says_so(jobs: Jobs, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No job was cancelled or failed"):
        jobs.resumed()
    for kind in ("diagnose", "plan"):
        jobs.start(requests(tmp_path)[kind][0], f"{kind}_7")
        jobs.cancel()
        with pytest.raises(ConfigError, match=f"{kind}_7 cannot go on"):
            jobs.resumed()
    with pytest.raises(ConfigError, match="plan_8 is no job of this node"):
        jobs.resumed("plan_8")
    jobs.start(requests(tmp_path)["plan"][0], "plan_9")
    report(jobs, Succeeded(PLANNED))
    assert not jobs.knows("plan_9") and jobs.state.state == "succeeded" and not jobs.running


def test_a_search_goes_on_in_its_folder_under_its_name(jobs: Jobs, tmp_path: Path) -> None:
    request = requests(tmp_path)["optimise"][0]
    jobs.start(request, "optimisation_7")
    assert jobs.cancel()[1] == (
        f"optimisation_7 was cancelled; what it has tried is in {request.out}, and ~/resume goes on from there"
    )
    assert jobs.resumed() == (request, "optimisation_7")


def test_a_search_does_not_go_on_with_another_rig(tmp_path: Path) -> None:
    made = small_task(tmp_path)
    optimise_task(made, Settings("cem", rollouts=2, seed=1), tmp_path / "out")
    assert (tmp_path / "out" / "curve.png").is_file()
    other = tmp_path / "stiffer.yaml"
    other.write_text("overlay_of: rig.yaml\nname: small_strip\nparameters: {card.E_pa: 3.0e9}\n")
    from sim_core.tasks import load_task

    on_other = load_task(str(tmp_path / "small.yaml"), rig=other)
    assert on_other.target_rig is not None, "the target stays that of the task's rig"
    with pytest.raises(ConfigError, match="has a search on another rig"):
        optimise_task(on_other, Settings("cem", rollouts=4, seed=1), tmp_path / "out")


def test_words_of_a_plan_and_of_an_optimisation(tmp_path: Path) -> None:
    state = JobState("plan_7", "running", kind="plan")
    state.take(Succeeded(PLANNED), requests(tmp_path)["plan"][0])
    assert "would determine 1 of 1 parameters" in state.doing and state.level == "ok"
    search = JobState("optimisation_7", "running", kind="optimisation")
    search.take(Succeeded(OPTIMISED | {"success": False}), requests(tmp_path)["optimise"][0])
    assert "best of 7 rollouts has the reward 0.125, no success" in search.doing and search.level == "warn"
    assert math.isnan(float(search.report(1.0).values["loss"]))
