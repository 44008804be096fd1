"""``thinshell policy``: one policy for a family of materials, learnt and tried."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid.cli.bounds import number, whole_number
from sysid.cli.options import SeedOption, parse_pairs
from sysid.progress import progress

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sim_core.policies.trial import Trial

TRIALS = "trials_{}.jsonl"
"""Trials of a policy by the number of its round, in its folder: a policy that has learnt on is tried anew."""

app = typer.Typer(
    name="policy",
    help="Learn a policy for a task over a family of materials, and try it on others.",
    rich_markup_mode=None,
)


@app.command("train")
def train(
    task: Annotated[str, typer.Argument(metavar="TASK", help="A name from 'thinshell tasks', or a file.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder: a new one, or one that goes on.")],
    rounds: Annotated[
        int, whole_number("--rounds", "Rounds in all, each of 3 episodes in each of 8 environments.", 1)
    ] = 10,
    algorithm: Annotated[str, typer.Option("--algorithm", metavar="NAME", help="sac or ppo.")] = "sac",
    around: Annotated[
        Path | None,
        typer.Option("--around", metavar="RUN", help="Folder of 'thinshell optimise': decide about its motion."),
    ] = None,
    reach: Annotated[
        float, number("--reach", "Share of the bounds by which decisions differ from it.", 0.0, 1.0)
    ] = 1.0,
    vary: Annotated[
        list[str] | None,
        typer.Option("--vary", metavar="NAME=LOW..HIGH", help="Materials; default: the family of the task."),
    ] = None,
    observe: Annotated[
        str, typer.Option("--observe", metavar="KIND", help="sensors: as a robot has them, or state.")
    ] = "sensors",
    minutes: Annotated[
        float | None, number("--minutes", "Wall time after which no round begins.", 0.0, metavar="MINUTES")
    ] = None,
    seed: SeedOption = 0,
    workers: Annotated[int, whole_number("--workers", "Threads; 0: one a core.", 0)] = 0,
) -> None:
    """Learn a policy. A checkpoint is written after each round, from which the same command goes on.

    Example: thinshell policy train folding_u --around runs/folding_u --reach 0.4 --out policies/folding_u
    """
    from sim_core.errors import ConfigError, nearest_match

    _check_installed()
    from sim_core.policies.train import Training
    from sim_core.policies.train import train as learn
    from sim_core.tasks import load_task

    if observe not in ("sensors", "state"):
        raise ConfigError(f"--observe is {observe!r}.", nearest_match(observe, ["sensors", "state"]))
    family = parse_pairs(vary, "--vary", "..") if vary else dict(load_task(task).task.family)
    if not family:
        raise ConfigError(f"The task {task} has no family of materials.", "Give one or more with --vary.")
    training = Training(
        task,
        algorithm,
        family,
        "state" if observe == "state" else "sensors",
        None if around is None else _motion(around),
        reach,
        seed,
    )
    with progress(f"policy {task}") as report:
        seconds = float("inf") if minutes is None else 60.0 * minutes
        done = learn(training, rounds, out, workers or os.cpu_count() or 1, report, seconds)
    print(
        f"{task}, {algorithm}, seed {seed}: {done.rounds} of {rounds} rounds, {done.lines} episodes, {done.decisions} "
        f"decisions, {done.steps} steps of simulation"
    )
    print(f"  {done.wall_s:.0f} s, {done.cpu_s:.0f} s of process time; written: {out}")


@app.command("test")
def test(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of 'thinshell policy train'.")],
    materials: Annotated[int, whole_number("--materials", "Number of materials that it has not seen.", 1)] = 100,
    searches: Annotated[int, whole_number("--searches", "On so many of them a search is made anew too.", 0)] = 0,
    budget: Annotated[int, whole_number("--budget", "Rollouts of such a search.", 1)] = 30,
    seed: SeedOption = 1,
    workers: Annotated[int, whole_number("--workers", "Threads; 0: one a core.", 0)] = 0,
) -> None:
    """Try a policy on materials that it has not seen, against replaying one motion on all of them (that about which it
    decides, and its own on the rig as its file has it) and against searching anew. What was tried is not tried again.

    Example: thinshell policy test policies/folding_u --materials 100 --searches 20
    """
    _check_installed()
    from sim_core.policies.train import load_policy, read_progress
    from sim_core.policies.trial import trials

    policy = load_policy(folder)
    with progress(f"policy {folder.name}") as report:

        def on_trial(done: int) -> None:
            report(done / materials, f"{done} of {materials}")

        path = folder / TRIALS.format(read_progress(folder).rounds)
        found = trials(
            policy,
            materials,
            path,
            seed=seed,
            searches=searches,
            budget=budget,
            workers=workers or os.cpu_count() or 1,
            on_trial=on_trial,
        )
    _print_share("policy", [not t.learnt for t in found], [t.learnt_reward for t in found])
    _print_share("its motion on the rig's file", [not t.open_loop for t in found], [t.open_loop_reward for t in found])
    _print_alone(found, [(t.open_loop, t.open_loop_reward) for t in found])
    if policy.training.around is not None:
        _print_share("replay", [not t.replayed for t in found], [t.replayed_reward for t in found])
        _print_alone(found, [(t.replayed, t.replayed_reward) for t in found])
    _print_searches(found)


def _check_installed() -> None:
    from importlib.util import find_spec

    from sim_core.errors import ConfigError

    if find_spec("stable_baselines3") is None:
        raise ConfigError(
            "Policies need Stable-Baselines3 and PyTorch, which are missing.",
            "Install them (pip install 'thinshell_ros[policies]', 3 GB).",
        )


def _print_share(words: str, successes: Sequence[bool], rewards: Sequence[float]) -> None:
    import numpy as np
    from scipy.stats import binomtest

    interval = binomtest(sum(successes), len(successes)).proportion_ci(method="wilson")
    ended = np.array([r for r in rewards if np.isfinite(r)])
    mean = f"reward {ended.mean():.4g} ± {ended.std():.2g}" if len(ended) else "no rollout came to its end"
    print(
        f"{words}: {sum(successes)} of {len(successes)} successes (95 %: {100 * interval.low:.0f} to "
        f"{100 * interval.high:.0f} %), {mean}"
    )


def _print_alone(found: Sequence[Trial], replays: Sequence[tuple[Sequence[str], float]]) -> None:
    """The policy against a replayed motion, of which each has its failures and its reward, material by material."""
    pairs = list(zip(found, replays, strict=True))
    alone = sum(not t.learnt and bool(failures) for t, (failures, _) in pairs)
    without = sum(bool(t.learnt) and not failures for t, (failures, _) in pairs)
    higher = sum(_or_least(t.learnt_reward) > _or_least(reward) for t, (_, reward) in pairs)
    print(
        f"  the policy alone on {alone}, the replay alone on {without}; "
        f"the policy has the higher reward on {higher} of {len(pairs)}"
    )


def _or_least(reward: float) -> float:
    """A reward, or less than any where a rollout ended early."""
    return reward if math.isfinite(reward) else -math.inf


def _print_searches(found: Sequence[Trial]) -> None:
    searched = [t for t in found if t.searched >= 0]
    if searched:
        mean = sum(t.searched for t in searched) / len(searched)
        print(f"search: {sum(t.found for t in searched)} of {len(searched)} successes, {mean:.1f} rollouts each")


def _motion(run: Path) -> tuple[float, ...]:
    """The best action of a folder of a search."""
    from sim_core.errors import ConfigError
    from sim_core.optimise.run import RESULT

    try:
        return tuple(float(x) for x in json.loads((run / RESULT).read_text(encoding="utf-8"))["action"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{run} is no folder of a search that came to its end: {error}.", "Name one of 'thinshell optimise'."
        ) from None
