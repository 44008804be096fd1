"""The comparison as a table or as JSON, and what to say where gradients differ."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from difflib import get_close_matches
from io import StringIO
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from sim_core.errors import ConfigError
from sim_core.rigs import Rig, list_parameters, resolve_name
from sim_core.rigs.motion import Experiment, compile_experiment
from sysid.gradients.beyond import KINDS, MEMORY, NODE_M, RATIO, SHIFT_M, SPEED_M_S, TURN_RAD, StateGradients
from sysid.gradients.compare import Comparison
from sysid.gradients.differences import STEPS, Row
from sysid.progress.callback import Progress

WIDTH = 150

FIELD = "fields."
"""Before the name of a single field."""

UNJUDGED = {
    "no effect": "without effect",
    "negligible": "of negligible effect",
    "unresolved": "hidden by round-off",
    "jumps": "next to a jump",
}
"""Verdicts of rows that are not judged, in words."""


def check_gradients(
    rig: Rig,
    experiment: Experiment,
    names: Sequence[str] | None = None,
    *,
    until_s: float | None = None,
    steps: Sequence[float] = STEPS,
    as_json: bool = False,
    on_progress: Progress | None = None,
) -> tuple[bool, str]:
    """Compare forward sensitivities, adjoint and central differences; whether all agree, and the table.

    ``names``: full or short names of parameters, and words of :data:`sysid.gradients.beyond.KINDS` for what is none, or
    ``fields.NAME`` for one field; None for all of the rig and all of those. ``until_s``: end of the rollout, None for
    that of the motion. ``steps``: of the differences, relative.
    """
    known = {p.name: p for p in list_parameters(rig)}
    fields = [n.removeprefix(FIELD) for n in names or () if n.startswith(FIELD)]
    kinds = [k for k in KINDS if names is None or k in names or (fields and k == "fields")]
    plain = [n for n in names or () if n not in KINDS and not n.startswith(FIELD)]
    chosen = list(known) if names is None else [_resolved(rig, n) for n in plain]
    if names is not None:
        for name in chosen:
            if known[name].value is None:
                raise ConfigError(
                    f"The parameter {name} has no value in the rig {rig.name!r}, so it has no derivative.",
                    "Write a value into the rig file.",
                )
    chosen = list(dict.fromkeys(n for n in chosen if known[n].value is not None))
    if not chosen and not kinds:
        raise ConfigError(f"The rig {rig.name!r} has no parameters with values.", "Name another rig.")
    poses = compile_experiment(experiment, rig)
    end = max([experiment.duration_s or 0.0, *(float(p.times[-1]) for p in poses.values())])
    if end <= 0.0:
        raise ConfigError(f"The experiment {experiment.name!r} moves nothing.", "Give it motions or waits.")
    if until_s is not None:
        if not rig.solver.dt_s <= until_s <= end:
            raise ConfigError(
                f"The rollout cannot end at {until_s:g} s.",
                f"Give a time from {rig.solver.dt_s:g} s, a time step, to {end:g} s, the end of {experiment.name}.",
            )
        end = until_s
    if not (rig.sensors or rig.cameras):
        raise ConfigError(f"The rig {rig.name!r} has nothing that is measured.", "Give it a sensor or a camera.")
    work, done = 1, 0

    def on_work(what: str) -> None:
        nonlocal done
        if on_progress is not None:
            on_progress(done / work, what)
        done += 1

    by_parameters = Comparison(rig, poses, end, chosen, on_work) if chosen else None
    only = () if names is None or "fields" in names else fields
    by_others = StateGradients(rig, poses, end, kinds, on_work, only) if kinds else None
    both = [found for found in (by_parameters, by_others) if found is not None]
    work = sum(found.amount_of_work(steps) for found in both)
    rows = [row for found in both for row in found.rows(steps)]
    if not rows:
        raise ConfigError(
            f"The rig {rig.name!r} has no {' and no '.join(kinds)}.", "Leave them out, or name another rig."
        )
    verdicts = {row.verdict for row in rows}
    passed = "agrees" in verdicts and not verdicts & {"differs", "one side"}
    return passed, _as_json(rows, steps, passed) if as_json else _as_text(rows, steps)


def _resolved(rig: Rig, name: str) -> str:
    """Full name of a parameter. Raises ``ConfigError``, also for a word that is nearly one of ``KINDS``."""
    try:
        return resolve_name(rig, name)
    except ConfigError as error:
        near = get_close_matches(name, KINDS, n=1)
        raise (ConfigError(error.problem, f"Did you mean {near[0]!r}?") if near else error) from None


def _as_json(rows: Sequence[Row], steps: Sequence[float], passed: bool) -> str:
    listed = [{key: _number(value) for key, value in asdict(row).items()} for row in rows]
    return json.dumps({"passed": passed, "steps": list(steps), "rows": listed}, indent=2, allow_nan=False)


def _number(value: Any) -> Any:
    """A value, or values, as JSON: None where it is no number."""
    if isinstance(value, tuple | list):
        return [_number(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _as_text(rows: Sequence[Row], steps: Sequence[float]) -> str:
    table = Table(title="Relative errors against central differences of whole rollouts, by their step", box=None)
    table.add_column("parameter", no_wrap=True)
    table.add_column("channel", no_wrap=True)
    for title in ("effect", *(f"{s:.0e}" for s in steps), "plateau", "adjoint"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    idle = [n for n in dict.fromkeys(r.parameter for r in rows) if _idle(n, rows)]
    for row in rows:
        if row.parameter in idle or row.verdict == "no effect":
            continue
        marks = [f"[{e:.1e}]" if e == row.best else f"{e:.1e}" for e in row.errors]
        plateau = f"{row.plateau[0]:.0e}..{row.plateau[-1]:.0e}" if row.plateau else "-"
        cells = [f"{row.effect:.2g} {row.unit}", *(m.replace("[", r"\[") for m in marks), plateau]
        adjoint = "" if row.adjoint is None else f"{row.adjoint:.0e}"
        table.add_row(row.parameter, row.channel, *cells, adjoint, row.verdict)
    out = StringIO()
    Console(file=out, width=WIDTH, color_system=None).print(table)
    lines = [line.rstrip() for line in out.getvalue().rstrip().splitlines()]
    lines += [
        "",
        "effect: change of the reading that changes most, per relative change of the parameter (where it is 0: per mm,",
        "10 ms or one unit, of which the steps are shares then, too); in brackets: the best step; plateau: steps of",
        "which the error is about as small; adjoint: its relative difference from the forward sensitivity. Bound: "
        f"{rows[0].bound:g}.",
    ]
    if any(row.value is None for row in rows):
        lines += [
            "Of poses, start and fields: errors of the adjoint along one random direction, and effects of a step of 1,",
            f"by {SHIFT_M:g} m, {TURN_RAD:g} rad, nodes by {NODE_M:g} m and {SPEED_M_S:g} m/s, plastic curvature by "
            f"{MEMORY['plastic_curvature']:g}/m, memory of",
            f"stress by {MEMORY['stress']:g} Pa, nu and angles by {RATIO:g}, others by their values (dampings of 0 by "
            "1/s and 1e-3 s, to one side).",
        ]
    lines += [f"{name} has no effect on any reading in this experiment." for name in idle]
    for row in rows:
        if row.verdict in ("differs", "one side"):
            worst = row.best if row.adjoint is None or not row.best <= row.bound else row.adjoint
            lines.append(
                f"{_named(row)} in {row.channel}: the error is {worst:.1e}, above {row.bound:g}. {row.reason}".rstrip()
            )
    lines += [
        f"{row.parameter} in {row.channel}: not judged, round-off of the rollouts hides so small an effect in their "
        "differences."
        for row in rows
        if row.verdict == "unresolved"
    ]
    lines += [
        f"{_named(row)} in {row.channel}: not judged, differences have no limit. The rollout jumps "
        "here, as where a motion leaves a plane of symmetry; the sensitivities are those of the branch that it took."
        for row in rows
        if row.verdict == "jumps"
    ]
    judged = [r for r in rows if r.verdict not in UNJUDGED]
    names = {r.parameter for r in judged}.union(idle)
    lines += [
        f"{name} is judged in no channel: its effects are negligible compared with those of others, or hidden."
        for name in dict.fromkeys(r.parameter for r in rows)
        if name not in names
    ]
    if judged:
        worst_of_all = max(judged, key=lambda r: r.best if np.isfinite(r.best) else np.inf)
        lines.append(
            f"{sum(r.verdict == 'agrees' for r in judged)} of {len(judged)} judged rows agree; the largest error is "
            f"{worst_of_all.best:.1e} ({worst_of_all.parameter}, {worst_of_all.channel}), that of the adjoint against "
            f"forward sensitivities {max((r.adjoint for r in judged if r.adjoint is not None), default=0.0):.0e}. "
            f"{_unjudged(rows)}"
        )
    else:
        lines.append(
            f"{_unjudged(rows)} Nothing could be judged: let the motion go on for longer, or name other parameters."
        )
    return "\n".join(lines)


def _unjudged(rows: Sequence[Row]) -> str:
    """How many rows were not judged, and why."""
    counts = Counter(row.verdict for row in rows)
    parts = [f"{counts[verdict]} {why}" for verdict, why in UNJUDGED.items() if counts[verdict]]
    total = sum(counts[verdict] for verdict in UNJUDGED)
    return f"Not judged: {total} of {len(rows)} rows" + (f" ({', '.join(parts)})." if parts else ".")


def _named(row: Row) -> str:
    """What a row is of, with its value if it has one."""
    return row.parameter if row.value is None else f"{row.parameter} = {row.value:g}"


def _idle(name: str, rows: Sequence[Row]) -> bool:
    """Whether a parameter changes no reading at all."""
    return all(r.verdict == "no effect" for r in rows if r.parameter == name)
