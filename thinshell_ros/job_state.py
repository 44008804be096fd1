"""What is known of the latest job, and what the node says of it. No ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

from sysid.fit.multistart import Step
from sysid.fit.result import not_converged
from thinshell_ros.fit_request import DiagnosisRequest, FitRequest
from thinshell_ros.health import Level, Report
from thinshell_ros.job_process import Event, Failed, Request, Share, Succeeded, Warned
from thinshell_ros.motion_request import OptimiseRequest, PlanRequest

State = Literal["idle", "running", "succeeded", "cancelled", "failed"]


@dataclass
class JobState:
    """The latest job. ``kind``: what it is; ``state``: as it is published; ``doing``: what is being done, or why it
    failed."""

    job_id: str = ""
    state: State = "idle"
    doing: str = ""
    max_iterations: int = 0
    share: float = 0.0
    step: Step | None = None
    result: dict[str, Any] = field(default_factory=dict)
    warned: bool = False
    """Something speaks against a recording."""
    kind: str = "fit"

    def take(self, event: Event, request: Request) -> None:
        """Take in what the process reported."""
        if isinstance(event, Share):
            self.share, self.doing = event.share, event.text
        elif isinstance(event, Step):
            self.step = event
        elif isinstance(event, Warned):
            self.warned = True
        elif isinstance(event, Succeeded):
            self.state, self.share, self.doing = "succeeded", 1.0, f"results in {request.out}"
            if isinstance(request, FitRequest):
                self.result = result_of(event.found, self.job_id, request)
                if self._astray:
                    self.doing = f"{self.result['remarks'][0]} {self.doing}"
            else:
                if isinstance(request, DiagnosisRequest):
                    self.result = diagnosis_of(event.found, self.job_id, request)
                elif isinstance(request, PlanRequest):
                    self.result = plan_of(event.found, self.job_id, request)
                else:
                    self.result = optimisation_of(event.found, self.job_id, request)
                self.doing = f"{self.result['sentence']} {self.doing}"
        elif isinstance(event, Failed):
            self.state, self.doing = "failed", event.reason

    def estimate(self) -> dict[str, float]:
        """Values of the parameters that are fitted, as far as they are known."""
        if self.state == "succeeded":
            return dict(self.result.get("estimate", {}))
        return self.step.values if self.step else {}

    @property
    def level(self) -> Level:
        """How serious the state is. A fit that ended and did not converge, or does not explain the recordings, or does
        not determine all that was asked for, has succeeded in writing its results, which need a look; so has a
        diagnosis by which something is missing, a plan by which something stays open, and a search without success.
        While a job runs of whose recordings something is known to be wrong, it may be better to stop it."""
        levels: dict[State, Level] = {"failed": "error", "cancelled": "warn"}
        doubtful = self.warned if self.state == "running" else self._astray
        return levels.get(self.state, "warn" if doubtful else "ok")

    @property
    def _astray(self) -> bool:
        found = self.result
        if not found:
            return False
        if self.kind == "diagnosis":
            return bool(found["verdict"] != "nothing_missing")
        if self.kind == "optimisation":
            return not found["success"]
        if self.kind == "plan":
            return not all(found["determined"].values())
        return not found["converged"] or not found["explained"] or bool(found["undetermined"])

    def report(self, elapsed_s: float) -> Report:
        """The state after some time [s] since the start, until the end. ``loss``: mean squared whitened residual
        (:attr:`sysid.solve.optimum.Fitted.misfit`), of the best values so far, and of the result."""
        left = elapsed_s * (1.0 / self.share - 1.0) if self.state == "running" and self.share > 0.0 else math.nan
        loss = self.result.get("loss", math.nan) if self.result else self.step.misfit if self.step else math.nan
        values = {
            "job_id": self.job_id,
            "iteration": str(self.step.evaluations if self.step else 0),
            "max_iterations": str(self.max_iterations),
            "loss": f"{loss:.6g}",
            "elapsed_s": f"{elapsed_s:.1f}",
            "eta_s": f"{left:.1f}",
            "detail": self.doing,
        }
        return Report(self.kind, self.level, self.state, values)


def result_of(fit: dict[str, Any], job_id: str, request: FitRequest) -> dict[str, Any]:
    """The result as it is published, from the content of ``fit.json``.

    ``std``: standard deviations in the units of the parameters (to first order where the logarithm is fitted);
    ``correlation``: rows and columns in the order of ``estimate``; ``loss``: mean squared whitened residual;
    ``explained``: down to the noise; ``undetermined``: names of parameters that the recordings do not determine;
    ``remarks``: first that the fit did not converge, or not to the noise, or what is not determined, if so.
    """
    estimates = fit["estimates"]
    source = fit["provenance"]
    astray = [] if fit["converged"] else [not_converged(fit["message"])]
    astray += [fit["no_success"]] if fit["no_success"] else []
    return {
        "job_id": job_id,
        "rig": fit["rig"],
        "output_dir": str(request.out),
        "estimate": {e["name"]: e["value"] for e in estimates},
        "std": {e["name"]: e["sd"] * (abs(e["value"]) if e["log"] else 1.0) for e in estimates},
        "ci95": {e["name"]: e["ci95"] for e in estimates},
        "unit": {e["name"]: e["unit"] for e in estimates},
        "correlation": fit["correlation"],
        "loss": fit["misfit"],
        "converged": fit["converged"],
        "explained": not fit["unexplained"],
        "undetermined": fit["undetermined"],
        "remarks": [
            *astray,
            *fit["unexplained"],
            *([s for s in fit["identifiability"] if s.startswith("The data do not determine")]),
            *fit["cautions"],
            *([s for s in fit["identifiability"] if not s.startswith("The data do not determine")]),
            *fit["remarks"],
            *fit["notes"],
        ],
        "bag_sha256": {bag["path"]: bag["sha256"] for bag in source["bags"]},
        "code_version": source["versions"],
    }


def diagnosis_of(found: dict[str, Any], job_id: str, request: DiagnosisRequest) -> dict[str, Any]:
    """The result of a diagnosis as it is published, from the content of ``diagnosis.json`` (docs/diagnosis.md).

    ``estimate``, ``ci95``, ``unit``: of the rig with the answer in it; ``effects``: names of the answer; ``loss``: mean
    squared whitened residual of the rig with it.
    """
    parameters = found["amended_parameters"] or found["baseline_parameters"]
    shown = found["fit"]["amended"] or found["fit"]["baseline"]
    return {
        "job_id": job_id,
        "rig": found["rig"],
        "output_dir": str(request.out),
        "verdict": found["verdict"],
        "sentence": found["sentence"],
        "effects": [effect["name"] for effect in found["effects"]],
        "probability": [effect["probability"] for effect in found["effects"]],
        "explained": found["explained"],
        "not_explained": found["not_explained"],
        "next_experiment": found["next_experiment"],
        "estimate": {p["name"]: p["value"] for p in parameters},
        "ci95": {p["name"]: p["ci95"] for p in parameters},
        "unit": {p["name"]: p["unit"] for p in parameters},
        "loss": shown["training"],
        "remarks": found["notes"],
        "bag_sha256": {bag["path"]: bag["sha256"] for bag in found["provenance"]["bags"]},
        "code_version": found["provenance"]["versions"],
    }


def plan_of(found: dict[str, Any], job_id: str, request: PlanRequest) -> dict[str, Any]:
    """The result of a plan as it is published, from the content of ``plan.json``. ``ci95``, ``unit``, ``determined``:
    what would be known of each parameter with all experiments together; ``outlooks``: of each of them as well."""
    together = found["outlooks"][-1]
    parameters = together["parameters"]
    sure = [p["name"] for p in parameters if p["determined"]]
    words = ", ".join(f"{p['name']} to {p['value']:.4g} ({p['ci95'][0]:.4g} to {p['ci95'][1]:.4g})" for p in parameters)
    return {
        "job_id": job_id,
        "rig": found["rig"],
        "output_dir": str(request.out),
        "sentence": (
            f"The experiments would determine {len(sure)} of {len(parameters)} parameters; limits of 95 %, in the "
            f"units of the rig: {words}."
        ),
        "ci95": {p["name"]: p["ci95"] for p in parameters},
        "unit": {p["name"]: p["unit"] for p in parameters},
        "determined": {p["name"]: p["determined"] for p in parameters},
        "remarks": together["sentences"],
        "outlooks": found["outlooks"],
    }


def optimisation_of(found: dict[str, Any], job_id: str, request: OptimiseRequest) -> dict[str, Any]:
    """The result of an optimisation as it is published, from the content of ``result.json``. ``trajectory``: path of
    the motion; ``rollouts``: how many were made; ``failures``: why it is no success."""
    success = "a success" if found["success"] else "no success"
    return {
        "job_id": job_id,
        "task": request.task,
        "rig": request.rig or "",
        "output_dir": str(request.out),
        "sentence": f"The best of {found['rollouts']} rollouts has the reward {found['reward']:.5g}, {success}.",
        "reward": found["reward"],
        "success": found["success"],
        "failures": found["failures"],
        "rollouts": found["rollouts"],
        "trajectory": str(request.out / "trajectory.json"),
    }
