"""The table of tasks by methods, over seeds: made run by run, each in a folder of its own, so that it can go on.

DIR/runs/TASK_VARIANT_METHOD_SEED/   as :mod:`sim_core.optimise.run` has it
DIR/table.json, DIR/table.md         renewed after each run

All tasks and methods get their first seed before any gets its second, so that a table that was ended early has
something of each. What was not run is said in it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.errors import ConfigError
from sim_core.optimise.cluster import check_cluster
from sim_core.optimise.run import RESULT, Settings, optimise
from sim_core.tasks.load import MadeTask, load_task
from sim_core.tasks.rollout import TaskRollouts
from sim_core.tasks.schema import Published

STILL = "still.json"
"""The reward of doing nothing but the approach, by task."""

RUNS = "runs"


@dataclass(frozen=True)
class Row:
    """One task by one method over its seeds, of which ``made`` were run.

    ``successes``: runs whose motion passed the check (:mod:`sim_core.tasks.check`), ``reached``: whose reward is that
    of a success, ``least_reward``; ``failures``: why motions did not pass, each once; ``still``: reward without actions
    (None: it ended early); ``rewards``: of the runs, nan where none came to its end; ``rollouts``: mean of a run,
    ``cpu_s`` their process time and ``check_s`` that of the checks, mean of a run [s]; ``published``: what the source
    of the variant says, or of another variant of the task.
    """

    task: str
    method: str
    seeds: int
    made: int
    successes: int
    reached: int
    failures: tuple[str, ...]
    least_reward: float
    still: float | None
    rewards: tuple[float, ...]
    rollouts: float
    cpu_s: float
    check_s: float
    published: Published | None


OnRun = Callable[[float, str], None]


def benchmark(
    tasks: Sequence[str],
    methods: Sequence[str],
    seeds: Sequence[int],
    settings: Settings,
    folder: Path,
    on_run: OnRun | None = None,
    seconds: float = float("inf"),
) -> list[Row]:
    """Make all runs that are not there yet, and the table. ``seconds``: wall time after which no run begins; Ctrl-C
    ends it too, with the table of what is there."""
    if settings.cluster:
        check_cluster(settings.cluster)
    made_tasks = {name: load_task(name) for name in tasks}
    jobs = [(name, method, seed) for seed in seeds for name in tasks for method in methods]
    (folder / RUNS).mkdir(parents=True, exist_ok=True)
    began, rows = time.monotonic(), _written(folder, made_tasks, methods, len(seeds))
    for number, (name, method, seed) in enumerate(jobs):
        made = made_tasks[name]
        place = run_folder(folder, made, method, seed)
        known = _finished(place)
        if known is not None and not known["interrupted"]:
            continue
        if time.monotonic() - began > seconds:
            break

        def tell(share: float, words: str, at: int = number, what: str = place.name) -> None:
            if on_run is not None:
                on_run((at + share) / len(jobs), f"{what}: {words}")

        try:
            interrupted = optimise(made, replace(settings, method=method, seed=seed), place, tell).interrupted
        except ConfigError as error:
            if not error.problem.startswith("No rollout of"):
                raise
            interrupted = False  # a search that found nothing is a row of the table too
            (place / RESULT).write_text(json.dumps(_nothing(place, error.problem), indent=1) + "\n", encoding="utf-8")
        rows = _written(folder, made_tasks, methods, len(seeds))
        if interrupted:
            break
    return rows


def run_folder(folder: Path, made: MadeTask, method: str, seed: int) -> Path:
    """The folder of one run."""
    return folder / RUNS / f"{made.task.name}_{made.variant_name}_{method}_{seed}"


def _finished(place: Path) -> dict[str, Any] | None:
    """The result of a run; None where there is none."""
    stored = place / RESULT
    found: dict[str, Any] | None = json.loads(stored.read_text(encoding="utf-8")) if stored.exists() else None
    return found


def _nothing(place: Path, why: str) -> dict[str, Any]:
    """The result of a run of which no rollout came to its end."""
    from sim_core.optimise.problem import read_log
    from sim_core.optimise.run import LOG

    tried = [o for e in read_log(place / LOG) for o in e.outcomes]
    return {
        "reward": float("nan"), "reached": False, "success": False, "failures": [why], "rollouts": len(tried),
        "cpu_s": sum(o.cpu_s for o in tried), "check_s": 0.0, "interrupted": False, "curve": [],
    }  # fmt: skip


def results_of(folder: Path, made: MadeTask, method: str, seeds: int) -> list[dict[str, Any]]:
    """Results of the runs of a task by a method that were made to their end."""
    found = (_finished(run_folder(folder, made, method, seed)) for seed in range(seeds))
    return [result for result in found if result is not None and not result["interrupted"]]


def _written(folder: Path, tasks: dict[str, MadeTask], methods: Sequence[str], seeds: int) -> list[Row]:
    """The rows of what is there, written as a table."""
    rows = []
    for made in tasks.values():
        for method in methods:
            runs = results_of(folder, made, method, seeds)
            rows.append(_row(made, method, seeds, runs, _still(folder, made) if runs else None))
    data = [{**asdict(r), "published": None if r.published is None else r.published.model_dump()} for r in rows]
    (folder / "table.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    (folder / "table.md").write_text(table(rows) + "\n", encoding="utf-8")
    return rows


def _still(folder: Path, made: MadeTask) -> float | None:
    """Reward without actions, made once."""
    path = folder / STILL
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if made.name not in known:
        rollouts = TaskRollouts(made)
        outcome = rollouts.outcome(np.zeros(rollouts.space.size))
        known[made.name] = None if outcome.stopped else outcome.reward
        path.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
    value: float | None = known[made.name]
    return value


def _row(made: MadeTask, method: str, seeds: int, runs: Sequence[dict[str, Any]], still: float | None) -> Row:
    def mean(key: str) -> float:
        return float(np.mean([float(r[key]) for r in runs])) if runs else 0.0

    failures = dict.fromkeys(words for r in runs for words in r["failures"])
    return Row(
        made.name,
        method,
        seeds,
        len(runs),
        sum(bool(r["success"]) for r in runs),
        sum(bool(r["reached"]) for r in runs),
        tuple(failures),
        made.variant.success,
        still,
        tuple(float(r["reward"]) for r in runs),
        mean("rollouts"),
        mean("cpu_s"),
        mean("check_s"),
        next((v.published for v in (made.variant, *made.task.variants.values()) if v.published), None),
    )


HEADS = (
    "task", "method", "seeds run", "success", "reward reached", "success from", "doing nothing", "reward", "rollouts",
    "CPU s", "CPU s of checks", "published success", "published human, oracle",
)  # fmt: skip
"""Heads of the columns of the table."""


def cells(row: Row) -> list[str]:
    """A row in words, in the order of :data:`HEADS`."""
    published = row.published
    figures = ["-", "-"] if published is None else [
        f"{100 * published.success_rate:.0f} %", f"{published.human:g}, {published.oracle:g}"
    ]  # fmt: skip
    if not row.made:
        return [
            row.task,
            row.method,
            f"0 of {row.seeds}",
            "not run",
            "-",
            f"{row.least_reward:.4g}",
            *["-"] * 5,
            *figures,
        ]
    rewards = np.array([r for r in row.rewards if np.isfinite(r)])
    spread = f" ± {rewards.std(ddof=1):.2g}" if len(rewards) > 1 else ""
    return [
        row.task,
        row.method,
        f"{row.made} of {row.seeds}",
        f"{row.successes} of {row.made}",
        f"{row.reached} of {row.made}",
        f"{row.least_reward:.4g}",
        "ends early" if row.still is None else f"{row.still:.4g}",
        f"{rewards.mean():.4g}{spread}" if len(rewards) else "none to its end",
        f"{row.rollouts:.0f}",
        f"{row.cpu_s:.0f}",
        f"{row.check_s:.0f}",
        *figures,
    ]


def table(rows: Sequence[Row]) -> str:
    """As Markdown, with what kept motions from being successes below it."""
    lines = [f"| {' | '.join(HEADS)} |", "|---" * len(HEADS) + "|"]
    lines += [f"| {' | '.join(cells(row))} |" for row in rows]
    for row in rows:
        lines += [f"\n{row.task}, {row.method}: {words}." for words in row.failures]
    return "\n".join(lines)
