"""What a plan of experiments or an optimisation over ROS is asked to do: parameter values, checked and made into
arguments of the library. No ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from sim_core.errors import ConfigError
from sim_core.optimise import Settings, method
from sim_core.optimise.run import RUN
from sim_core.rigs import Rig
from sim_core.rigs.motion import Experiment, compile_experiment, load_experiment
from sim_core.tasks import load_task
from sysid.model.nuisance_parameters import checked_kinds
from thinshell_ros.fit_request import folder_of, nuisance_of, parameters_of


@dataclass(frozen=True)
class PlanRequest:
    """Arguments of :func:`sysid.workflow.plan.plan_to_folder`. ``out``: a folder that does not exist."""

    kind: ClassVar = "plan"
    file: ClassVar = "plan.json"
    rig: Rig
    experiments: tuple[Experiment, ...]
    names: tuple[str, ...]
    nuisance: frozenset[str]
    out: Path


@dataclass(frozen=True)
class OptimiseRequest:
    """Arguments of :func:`sysid.workflow.optimise.optimise_task`. ``rig``: in place of the task's, None for that;
    ``out``: a folder that does not exist, or in which the same search was begun."""

    kind: ClassVar = "optimisation"
    file: ClassVar = "result.json"
    task: str
    rig: str | None
    settings: Settings
    out: Path


def plan_request(rig: Rig, values: Mapping[str, Any], job_id: str) -> PlanRequest:
    """The request for a plan, of ``plan.experiments``, ``fit.parameters``, ``fit.nuisance`` and ``output_dir``. Raises
    ``ThinshellError``."""
    given = values["plan.experiments"] or []
    if not given:
        raise ConfigError("It is not said what to plan.", "Set plan.experiments to a list of names or files.")
    experiments = tuple(load_experiment(name) for name in given)
    for experiment in experiments:
        compile_experiment(experiment, rig)
    names = tuple(parameters_of(rig, values, "what the experiments are to determine"))
    kinds = checked_kinds(nuisance_of(values))
    return PlanRequest(rig, experiments, names, kinds, folder_of(values["output_dir"]) / job_id)


def optimise_request(values: Mapping[str, Any], job_id: str, begun: bool = False) -> OptimiseRequest:
    """The request for an optimisation, of the parameters ``optimise.*`` and ``output_dir``. ``begun``: it goes on in
    the folder ``job_id``. Raises ``ThinshellError``."""
    task, rig = values["optimise.task"], values["optimise.rig"] or None
    if not task:
        raise ConfigError("It is not said which task to do.", "Set optimise.task to a name or a file.")
    load_task(task, rig=rig)
    method(values["optimise.method"])
    settings = Settings(
        method=values["optimise.method"],
        rollouts=values["optimise.budget"],
        seed=values["optimise.seed"],
        stop_at_success=values["optimise.stop_at_success"],
    )
    out = folder_of(values["output_dir"]) / job_id
    if begun and not (out / RUN).is_file():
        raise ConfigError(f"There is no search in {out} that could go on.", "Name a job whose folder is in output_dir.")
    return OptimiseRequest(task, rig, settings, out)
