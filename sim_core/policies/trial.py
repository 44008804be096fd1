"""A learnt policy on materials that it has not seen, against replayed motions and against searching anew.

Two motions are replayed: the one about which the policy decides, and the one that the policy makes on the rig as its
file has it. Where the latter does as well as the policy, what was learnt is a better motion for all materials, and not
how to change it from one material to another.

Each material is written down as it is tried, so that a trial goes on where it was ended. A success is one that
:class:`sim_core.tasks.check.Judge` has nothing against, with the cells and steps of the rig.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from queue import SimpleQueue

import numpy as np

from sim_core.errors import ConfigError
from sim_core.optimise.evaluators import LocalEvaluator
from sim_core.optimise.hybrid import hybrid
from sim_core.optimise.problem import Budget, BudgetSpent, Evaluation, Problem
from sim_core.policies.train import Policy, Training
from sim_core.rigs import list_parameters, resolve_name
from sim_core.tasks.check import Judge, judged
from sim_core.tasks.environment import TaskEnv
from sim_core.tasks.rollout import TaskRollouts
from sim_core.threads import worker_threads

UNSEEN = 7919
"""Sets materials of trials apart from those of trainings with the same seed."""


@dataclass(frozen=True)
class Trial:
    """One material. ``learnt``, ``replayed``, ``open_loop``: why the motions of the policy, the motion about which it
    decides and its motion on the rig as its file has it are no successes, in words, with their rewards (NaN where a
    rollout ended early); ``searched``: rollouts to a success of a search from the motion about which it decides, the
    budget where it had none, -1 where none was asked for; ``found``: whether it had."""

    parameters: Mapping[str, float]
    learnt: tuple[str, ...]
    learnt_reward: float
    open_loop: tuple[str, ...]
    open_loop_reward: float
    replayed: tuple[str, ...] = ()
    replayed_reward: float = float("nan")
    searched: int = -1
    found: bool = False


def materials(training: Training, count: int, seed: int) -> list[dict[str, float]]:
    """Drawn evenly from the intervals of a training, by another generator than its episodes."""
    rng = np.random.default_rng([UNSEEN, seed])
    return [{n: float(rng.uniform(low, high)) for n, (low, high) in training.vary.items()} for _ in range(count)]


def nominal(training: Training, env: TaskEnv) -> dict[str, float]:
    """The material that the file of the rig has, of the parameters that a training varies."""
    varied = {resolve_name(env.made.rig, name) for name in training.vary}
    return {p.name: p.value for p in list_parameters(env.made.rig) if p.name in varied and p.value is not None}


def trials(
    policy: Policy,
    count: int,
    path: Path,
    *,
    seed: int = 1,
    searches: int = 0,
    budget: int = 30,
    workers: int = 1,
    on_trial: Callable[[int], None] = lambda _: None,
) -> list[Trial]:
    """Try a policy on so many materials, and a search with a ``budget`` of rollouts on the first ``searches`` of them.

    ``workers``: threads; ``path``: where trials are written to, and taken from where they are the same. Raises
    ``ConfigError`` where it has others.
    """
    drawn = materials(policy.training, count, seed)
    known = read_trials(path)
    found = known[:count]
    for number, trial in enumerate(found):
        if trial.parameters != drawn[number] or (number < searches) != (trial.searched >= 0):
            raise ConfigError(f"{path} has trials of other materials.", "Name another file.")
    left = list(enumerate(drawn))[len(found) :]
    if not left:
        return found
    envs = [TaskEnv(policy.training.task, **policy.training.options()) for _ in range(min(workers, len(left)))]
    around = None if policy.training.around is None else np.array(policy.training.around)
    _motion(policy, envs[0], UNSEEN, nominal(policy.training, envs[0]))
    own, free = envs[0].action_so_far.copy(), SimpleQueue[TaskEnv]()
    for env in envs:
        free.put(env)

    def tried(number: int, parameters: Mapping[str, float]) -> Trial:
        env = free.get()
        try:
            return _tried(policy, env, number, parameters, around, own, budget if number < searches else 0)
        finally:
            free.put(env)

    with worker_threads(len(envs)) as threads:
        for future in [threads.submit(tried, *one) for one in left]:
            found.append(future.result())
            with path.open("a", encoding="utf-8") as stored:
                stored.write(json.dumps(asdict(found[-1])) + "\n")
            on_trial(len(found))
    return found


def _motion(policy: Policy, env: TaskEnv, seed: int, parameters: Mapping[str, float]) -> str:
    """Make an episode as the policy decides. Gives why it ended early; empty where it did not."""
    observation, info = env.reset(seed=seed, options={"parameters": parameters})
    over = False
    while not over:
        observation, _, over, _, info = env.step(policy.decision(observation))
    return str(info["stopped"])


def _tried(
    policy: Policy,
    env: TaskEnv,
    number: int,
    parameters: Mapping[str, float],
    around: np.ndarray | None,
    own: np.ndarray,
    budget: int,
) -> Trial:
    """One material. ``own``: the motion that the policy makes on the rig as its file has it."""
    judge = Judge(env.rollouts)
    env.look = judge.look
    seed = int(np.random.SeedSequence([UNSEEN, number]).generate_state(1)[0])
    learnt, learnt_reward = judge.failures(_motion(policy, env, seed, parameters))
    trial = Trial(dict(parameters), tuple(learnt), learnt_reward, *_judged(env, own))
    if around is not None:
        replayed, reward = _judged(env, around)
        trial = replace(trial, replayed=replayed, replayed_reward=reward)
    if not budget:
        return trial
    rollouts, success = searched(env.rollouts, np.zeros(env.rollouts.space.size) if around is None else around, budget)
    return replace(trial, searched=rollouts, found=success)


def _judged(env: TaskEnv, motion: np.ndarray) -> tuple[tuple[str, ...], float]:
    """Why a motion is no success on the present material, in words, and its reward."""
    failures, reward = judged(env.rollouts, motion)
    return tuple(failures), reward


def searched(rollouts: TaskRollouts, start: np.ndarray, budget: int) -> tuple[int, bool]:
    """Rollouts of a hybrid search from an action, up to its first success or the budget, and whether it had one."""

    def succeeds(evaluation: Evaluation) -> bool:
        return not judged(rollouts, evaluation.action)[0]

    problem = Problem(
        LocalEvaluator(rollouts),
        Budget(budget),
        stop_at_success=True,
        confirm=succeeds,
        motions=rollouts.space.generic(),
    )
    try:
        hybrid(problem, rollouts.space.executable(start), np.random.default_rng(0))
    except BudgetSpent:
        pass
    return problem.rollouts, problem.confirmed is not None


def read_trials(path: Path) -> list[Trial]:
    """Trials that a file has; a last line that was cut off is left out, and cut off the file."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    whole = [line for line in lines if line.endswith("\n")]
    if len(whole) < len(lines):
        path.write_text("".join(whole), encoding="utf-8")
    try:
        rows = [json.loads(line) for line in whole]
        words = ("learnt", "open_loop", "replayed")
        return [Trial(**{**row, **{name: tuple(row[name]) for name in words}}) for row in rows]
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path} has no trials of a policy: {error}.", "Name another file.") from None
