"""The table of tasks by methods, over seeds: made run by run, each in a folder of its own, so that it can go on.

DIR/runs/TASK_VARIANT_METHOD_SEED/   as :mod:`sim_core.optimise.run` has it
DIR/table.json, DIR/table.md         renewed after each run
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from sim_core.optimise.run import RESULT, Result, Settings, optimise
from sim_core.tasks.load import MadeTask, load_task
from sim_core.tasks.rollout import TaskRollouts

STILL = "still.json"
"""The reward of doing nothing but the approach, by task."""


@dataclass(frozen=True)
class Row:
    """One task by one method over its seeds. ``still``: reward without actions (None: it ended early); ``rollouts``:
    mean; ``to_success``: mean over runs that had one (None: none had); ``cpu_s``, ``wall_s``: mean of a run [s]."""

    task: str
    method: str
    seeds: int
    success_rate: float
    least_reward: float
    still: float | None
    mean: float
    sd: float
    best: float
    rollouts: float
    to_success: float | None
    cpu_s: float
    wall_s: float


OnRun = Callable[[float, str], None]


def benchmark(
    tasks: Sequence[str],
    methods: Sequence[str],
    seeds: Sequence[int],
    settings: Settings,
    folder: Path,
    on_run: OnRun | None = None,
) -> list[Row]:
    """Make all runs that are not there yet, and the table. Ctrl-C ends it with the table of what is there."""
    jobs = [(load_task(name), method, seed) for name in tasks for method in methods for seed in seeds]
    results: dict[tuple[str, str], tuple[MadeTask, list[dict[str, object]]]] = {}
    rows: list[Row] = []
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    for number, (made, method, seed) in enumerate(jobs):
        place = folder / "runs" / f"{made.task.name}_{made.variant_name}_{method}_{seed}"

        def tell(share: float, words: str, at: int = number, what: str = place.name) -> None:
            if on_run is not None:
                on_run((at + share) / len(jobs), f"{what}: {words}")

        stored = place / RESULT
        finished = json.loads(stored.read_text(encoding="utf-8")) if stored.exists() else None
        if finished is None or finished["interrupted"]:
            found: Result = optimise(made, replace(settings, method=method, seed=seed), place, tell)
            finished = json.loads(found.to_json())
        results.setdefault((made.name, method), (made, []))[1].append(finished)
        rows = [_row(own, by, runs, _still(folder, own)) for (_, by), (own, runs) in results.items()]
        (folder / "table.json").write_text(json.dumps([asdict(r) for r in rows], indent=1) + "\n", encoding="utf-8")
        (folder / "table.md").write_text(table(rows) + "\n", encoding="utf-8")
        if finished["interrupted"]:
            break
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


def _row(made: MadeTask, method: str, runs: Sequence[dict[str, object]], still: float | None) -> Row:
    def of(key: str) -> np.ndarray:
        return np.array([r[key] for r in runs], dtype=float)

    reached = [r["to_success"] for r in runs if r["to_success"] is not None]
    rewards = of("reward")
    return Row(
        made.name,
        method,
        len(runs),
        float(of("success").mean()),
        made.variant.success,
        still,
        float(rewards.mean()),
        float(rewards.std(ddof=1)) if len(runs) > 1 else 0.0,
        float(rewards.max()),
        float(of("rollouts").mean()),
        float(np.mean(np.array(reached, dtype=float))) if reached else None,
        float(of("cpu_s").mean()),
        float(of("wall_s").mean()),
    )


def table(rows: Sequence[Row]) -> str:
    """As Markdown."""
    lines = [
        "| task | method | seeds | success | success from | doing nothing | reward | best | rollouts | to success "
        "| CPU s | wall s |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        still = "ends early" if r.still is None else f"{r.still:.4g}"
        reached = "-" if r.to_success is None else f"{r.to_success:.0f}"
        lines.append(
            f"| {r.task} | {r.method} | {r.seeds} | {100 * r.success_rate:.0f} % | {r.least_reward:.4g} | {still} "
            f"| {r.mean:.4g} ± {r.sd:.2g} | {r.best:.4g} | {r.rollouts:.0f} | {reached} | {r.cpu_s:.0f} "
            f"| {r.wall_s:.0f} |"
        )
    return "\n".join(lines)
