"""One optimisation of a task: a folder with everything that it was made with and that came of it.

    run.json          task, variant, method, budget, seed, versions
    task.yaml, rig.yaml  the task and the rig with the numbers of the variant
    evaluations.jsonl every action that was tried, in order (:mod:`sim_core.optimise.problem`)
    checks.jsonl      what came of the checks of successes (:mod:`sim_core.optimise.confirm`)
    result.json       the best action, its reward, whether it is a success, rollouts, seconds
    trajectory.json   the best motion and what the hands do afterwards, with what the sensors of the rig will read
                      (:mod:`sim_core.trajectories`)
    trace.npz         its rollout with all states (:mod:`sim_core.trace_file`): 'thinshell show' draws it

A folder with a log goes on from there.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sim_core.errors import ConfigError, ConvergenceError
from sim_core.optimise.cluster import check_cluster
from sim_core.optimise.confirm import Confirmations
from sim_core.optimise.descent import SHAKE
from sim_core.optimise.evaluators import Parameters
from sim_core.optimise.methods import method
from sim_core.optimise.problem import Budget, BudgetSpent, Evaluation, OnRollout, Problem
from sim_core.optimise.workers import evaluator
from sim_core.rigs import rig_to_yaml
from sim_core.simulate import Trace
from sim_core.tasks.actions import ActionSpace
from sim_core.tasks.load import MadeTask
from sim_core.tasks.rollout import Outcome, TaskRollouts
from sim_core.threads import worker_threads
from sim_core.trace_file import save_trace
from sim_core.trajectories import Limits, make_trajectory, write_trajectory

RUN, LOG, RESULT = "run.json", "evaluations.jsonl", "result.json"
TRAJECTORY, TRACE = "trajectory.json", "trace.npz"


@dataclass(frozen=True)
class Settings:
    """Of one search. ``seed``: of all that is drawn, the action that it begins with included; ``workers``: rollouts at
    once, on threads or on a ``cluster`` (:mod:`sim_core.optimise.cluster`); ``draws``: sets of parameters over which
    the fitness is meant, and ``quantile`` its least share; ``stop_at_success``: the search ends with the first success
    that a check confirms."""

    method: str = "hybrid"
    rollouts: int = 200
    seconds: float = float("inf")
    seed: int = 0
    workers: int = 1
    draws: tuple[Parameters, ...] = ()
    quantile: float = 0.0
    stop_at_success: bool = False
    cluster: str = ""


@dataclass(frozen=True)
class Result:
    """What a search found.

    ``reward``: of the best action with the cells and the parameters of the rig; ``reached``: whether that is one of a
    success, ``success``: whether a person would call it one (:mod:`sim_core.tasks.check`), ``failures``: why not,
    ``refined_reward``: with cells and steps half as large, NaN where that was not tried; ``searched_reward``: its
    fitness in the search, with its cells, over the draws, of which ``success_share`` are successes; ``to_success``:
    rollouts up to the first with the reward of a success (None: there is none); ``cpu_s`` of the rollouts, ``check_s``
    of the checks: process time [s]; ``wall_s`` [s]; ``curve``: rollouts, best fitness so far, and what the method was
    doing.
    """

    action: np.ndarray
    reward: float
    reached: bool
    success: bool
    failures: tuple[str, ...]
    refined_reward: float
    stopped: str
    force_n: float
    searched_reward: float
    success_share: float
    rollouts: int
    to_success: int | None
    cpu_s: float
    check_s: float
    wall_s: float
    interrupted: bool
    curve: tuple[tuple[int, float, str], ...]

    def to_json(self) -> str:
        """As text."""
        data = {**asdict(self), "action": self.action.tolist()}
        return json.dumps(data, indent=1)


def optimise(
    made: MadeTask, settings: Settings, folder: Path | None = None, on_rollout: OnRollout | None = None
) -> Result:
    """Search for the best action of a task.

    ``folder``: new, or one in which the same search was begun. Ctrl-C ends the search, and what was found is kept.
    Raises ``ConfigError`` where the folder has another search, where the cluster has no such address, and where no
    rollout came to an end.
    """
    search = method(settings.method).search
    if settings.cluster:
        check_cluster(settings.cluster)
    space = ActionSpace(made)
    log = None
    if folder is not None:
        log = _open(made, settings, folder)
    interrupted = False
    confirm = Confirmations(made, folder)
    rng = np.random.default_rng(settings.seed)
    start = np.clip(SHAKE * rng.standard_normal(space.size), -1.0, 1.0)
    with evaluator(made, settings.workers, made.has_coarse, space.size, settings.cluster) as rollouts:
        problem = Problem(
            rollouts,
            Budget(settings.rollouts, settings.seconds),
            log=log,
            on_rollout=on_rollout,
            draws=settings.draws,
            quantile=settings.quantile,
            stop_at_success=settings.stop_at_success,
            confirm=confirm,
            motions=space.generic(),
        )
        try:
            search(problem, start, rng)
        except BudgetSpent:
            pass
        except KeyboardInterrupt:
            interrupted = True
        finally:
            problem.close()
        if problem.best is None or problem.best.outcomes[0].stopped:
            why = "none was made" if problem.best is None else problem.best.outcomes[0].stopped
            raise ConfigError(
                f"No rollout of {made.name} came to its end in {problem.rollouts}: {why}.",
                "Allow more rollouts, or smaller steps of the hands.",
            )
    best = problem.confirmed or problem.best
    nominal = made.has_coarse or settings.draws
    final = TaskRollouts(made).outcome(best.action) if nominal else best.outcomes[0]
    result = _result(problem, best, final, confirm, interrupted)
    if folder is not None:
        write_motion(made, settings, result, folder)
        (folder / RESULT).write_text(result.to_json() + "\n", encoding="utf-8")  # last: what has it is whole
    return result


def _result(problem: Problem, chosen: Evaluation, final: Outcome, confirm: Confirmations, interrupted: bool) -> Result:
    best, count, curve, to_success = -np.inf, 0, [], None
    for evaluation in problem.history:
        count += len(evaluation.outcomes)
        if evaluation.fitness > best:
            best = evaluation.fitness
        curve.append((count, float(best), evaluation.phase))
        if to_success is None and evaluation.success:
            to_success = count
    cpu = sum(o.cpu_s for e in problem.history for o in e.outcomes)
    verdict = confirm.verdict(chosen.action) if final.success and not interrupted else None
    return Result(
        chosen.action,
        final.reward,
        final.success,
        verdict is not None and verdict.passed,
        () if verdict is None else verdict.failures,
        float("nan") if verdict is None else verdict.refined_reward,
        final.stopped,
        final.force_n,
        chosen.fitness,
        float(np.mean([o.success for o in chosen.outcomes])),
        count,
        to_success,
        cpu,
        confirm.cpu_s,
        problem.wall_s,
        interrupted,
        tuple(curve),
    )


def write_motion(made: MadeTask, settings: Settings, result: Result, folder: Path) -> None:
    """Write the trajectory of the best action with its prediction, and its trace, in place of those before; without
    prediction and trace where the rig has other cells than the search and its rollout fails.

    With draws of parameters the prediction is the mean and the standard deviation of their rollouts, as far as they
    come to an end, and the trace is that of the rig as it is.
    """
    rollouts = TaskRollouts(made)
    with worker_threads(max(1, settings.workers)) as threads:
        trace, *drawn = threads.map(partial(_traced, rollouts, result.action), [{}, *settings.draws])
    traces = [t for t in drawn if t is not None]
    if len(traces) < 2:
        traces = [trace] if trace is not None else []
    trajectory = make_trajectory(
        made.rig,
        rollouts.poses(result.action),
        rollouts.space.times,
        limits=Limits(max_force_n=made.stop.most_force_n),
        traces=traces,
        open_parameters=len(settings.draws[0]) if settings.draws else None,
        name=made.task.name,
        description=made.task.title,
        provenance={
            "task": made.name,
            "method": settings.method,
            "seed": str(settings.seed),
            "reward": f"{result.reward:.6g}",
            "success": str(result.success).lower(),
        },
    )
    for name in (TRAJECTORY, TRACE):
        (folder / name).unlink(missing_ok=True)
    write_trajectory(folder / TRAJECTORY, trajectory)
    if trace is not None:
        rollouts.outcome(result.action)
        save_trace(folder / TRACE, trace, rollouts.sought())


def _traced(rollouts: TaskRollouts, action: np.ndarray, parameters: Parameters) -> Trace | None:
    """The rollout of an action; None where it fails."""
    try:
        return rollouts.trace(action, parameters)
    except ConvergenceError:
        return None


def _open(made: MadeTask, settings: Settings, folder: Path) -> Path:
    """The log in a folder, which is made, or has the same search."""
    about = _about(made, settings)
    path = folder / RUN
    try:
        if path.exists():
            _same(json.loads(path.read_text(encoding="utf-8")), about, folder)
            if (folder / "rig.yaml").read_text(encoding="utf-8") != rig_to_yaml(made.rig):
                raise ConfigError(
                    f"The folder {folder} has a search on another rig.", "Name a new folder, or ask for the same rig."
                )
        else:
            if folder.exists() and any(folder.iterdir()):
                raise ConfigError(f"The folder {folder} has other files in it.", "Name a new folder.")
            folder.mkdir(parents=True, exist_ok=True)
            task = made.task.model_dump(mode="json", exclude_none=True)
            (folder / "task.yaml").write_text(yaml.safe_dump(task, sort_keys=False), encoding="utf-8")
            (folder / "rig.yaml").write_text(rig_to_yaml(made.rig), encoding="utf-8")
            path.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    except (OSError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"The folder {folder} cannot be used: {error}.", "Name another one.") from None
    return folder / LOG


def _about(made: MadeTask, settings: Settings) -> dict[str, Any]:
    packages = {name: version(name) for name in ("numpy", "scipy", "cma")}
    return {
        "task": made.task.name,
        "variant": made.variant_name,
        "method": settings.method,
        "seed": settings.seed,
        "workers": settings.workers,
        "draws": [dict(d) for d in settings.draws],
        "quantile": settings.quantile,
        "rollouts": settings.rollouts,
        "seconds": None if settings.seconds == float("inf") else settings.seconds,
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "packages": packages,
    }


def _same(stored: Mapping[str, Any], about: Mapping[str, Any], folder: Path) -> None:
    """Raise where a search cannot go on in a folder: budgets may differ, and the machine."""
    free: Sequence[str] = ("rollouts", "seconds", "python", "machine", "packages")
    for key, value in about.items():
        if key not in free and stored.get(key) != value:
            raise ConfigError(
                f"The folder {folder} has a search with {key} {stored.get(key)!r}, not {value!r}.",
                "Name a new folder, or ask for the same search.",
            )
