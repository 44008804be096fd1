"""The table of inverse tasks by methods: error of what is sought, and what it took. Each row is written as it is made,
and is not made again."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from sim_core.errors import ConfigError, nearest_match
from sim_core.rigs import Rig
from sim_core.rigs.motion import load_experiment
from sysid.inverse.methods import METHODS, Counted, begun_at
from sysid.inverse.task import InverseTask, load_inverse_task, rig_of
from sysid.io.atomic_folder import whole_file
from sysid.model.load import load_run
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import fit_parameters, start_of
from sysid.progress.callback import Progress
from sysid.simulate import simulate_to_bag


@dataclass(frozen=True)
class InverseRow:
    """One search. ``begins``: over the truth; ``error``: of what is found, over the truth; ``interval``: 95 %, where
    the method tells one, over the truth, and whether it is ``inside``; ``rollouts``, of which ``with_derivatives``;
    wall time [s]; ``of``: hash of rig, motion and what is sought."""

    task: str
    method: str
    begins: float
    seed: int
    error: float
    interval: tuple[float, float] | None
    inside: bool | None
    rollouts: int
    with_derivatives: int
    wall_s: float
    of: str


def inverse_benchmark(
    names: Sequence[str],
    methods: Sequence[str],
    seeds: Sequence[int],
    out: Path,
    *,
    workers: int | None = None,
    on_progress: Progress | None = None,
) -> list[InverseRow]:
    """Make all rows that ``out/rows.json`` does not have yet. A seed is that of the noise of the recording, and of what
    a method draws."""
    if not methods:
        raise ConfigError("No method is named.", f"Name some of {', '.join(METHODS)}.")
    for method in methods:
        if method not in METHODS:
            raise ConfigError(f"There is no method {method!r}.", nearest_match(method, list(METHODS)))
    tasks = [load_inverse_task(name) for name in names]
    jobs = [(t, m, b, s) for t in tasks for s in seeds for b in t.begins for m in methods]
    out.mkdir(parents=True, exist_ok=True)
    stored = out / "rows.json"
    known = [_row(r) for r in json.loads(stored.read_text(encoding="utf-8"))] if stored.exists() else []
    rows: list[InverseRow] = []
    with ParallelPredictor(workers or os.cpu_count() or 1) as engine:
        for number, (task, method, begins, seed) in enumerate(jobs):
            if on_progress is not None:
                on_progress(number / len(jobs), f"{task.name} by {method} from {begins:g} times the truth, seed {seed}")
            wanted = (task.name, method, begins, seed, _hash_of(task))
            same = [r for r in known if (r.task, r.method, r.begins, r.seed, r.of) == wanted]
            row = same[0] if same else _searched(Counted(engine), task, method, begins, seed, out)
            rows.append(row)
            known += [] if same else [row]
            for path, text in (
                (stored, json.dumps([asdict(r) for r in known], indent=1)),
                (out / "table.md", inverse_table(known)),
            ):
                with whole_file(path) as part:
                    part.write_text(text + "\n", encoding="utf-8")
    return rows


def _row(stored: dict[str, object]) -> InverseRow:
    interval = stored["interval"]
    return InverseRow(**{**stored, "interval": tuple(interval) if isinstance(interval, list) else None})  # type: ignore[arg-type]


def _searched(engine: Counted, task: InverseTask, method: str, begins: float, seed: int, out: Path) -> InverseRow:
    rig, experiment = rig_of(task), load_experiment(task.experiment)
    bag = out / f"{task.name}_{seed}_{_hash_of(task)}"
    if not bag.exists():
        simulate_to_bag(rig, experiment, bag, seed=seed)
    run, started = load_run(rig, bag), time.monotonic()
    truth = _truth(rig, task)
    found = METHODS[method](engine, begun_at(rig, task.seeks, begins), run, task, seed)
    interval = None if found.interval is None else (found.interval[0] / truth, found.interval[1] / truth)
    inside = None if interval is None else interval[0] <= 1.0 <= interval[1]
    return InverseRow(
        task.name,
        method,
        begins,
        seed,
        found.value / truth - 1.0,
        interval,
        inside,
        found.rollouts,
        found.with_derivatives,
        time.monotonic() - started,
        _hash_of(task),
    )


def _hash_of(task: InverseTask) -> str:
    """Of what is recorded: rig, motion and what is sought."""
    described = (rig_of(task).model_dump_json(), load_experiment(task.experiment).model_dump_json(), task.seeks)
    return hashlib.sha256(repr(described).encode()).hexdigest()[:12]


def _truth(rig: Rig, task: InverseTask) -> float:
    (parameter,) = fit_parameters(rig, [task.seeks])
    return parameter.physical(float(start_of(rig, [parameter])[0]))


def inverse_table(rows: Sequence[InverseRow]) -> str:
    """As Markdown: one line a task and method, over starts and seeds."""
    lines = [
        "| task | method | searches | median error | largest error | truth inside 95 % | rollouts | with derivatives "
        "| wall s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for task, method in dict.fromkeys((r.task, r.method) for r in rows):
        mine = [r for r in rows if (r.task, r.method) == (task, method)]
        errors = np.abs([r.error for r in mine])
        covered = [r.inside for r in mine if r.inside is not None]
        lines.append(
            f"| {task} | {method} | {len(mine)} | {100 * np.median(errors):.2g} % | {100 * errors.max():.2g} % "
            f"| {f'{sum(covered)} of {len(covered)}' if covered else '-'} | {np.mean([r.rollouts for r in mine]):.0f} "
            f"| {np.mean([r.with_derivatives for r in mine]):.0f} | {np.mean([r.wall_s for r in mine]):.0f} |"
        )
    return "\n".join(lines)
