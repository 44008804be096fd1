"""Rows of the tables: parameters, errors, correlation, provenance."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.report.numbers import (
    MISSING,
    TIMES,
    Number,
    Scale,
    change,
    fixed,
    raw_number,
    scale_for,
    scale_of_interval,
    significant,
    times,
    value_and_interval,
)

if TYPE_CHECKING:
    from sysid.diagnosis.result import NamedParameter
    from sysid.fit.result import ChannelError, Estimate
    from sysid.uncertainty.nuisance_estimates import Nuisance


NUISANCES = re.compile(r"\.(latency_s|offset_r?[xyz]_(m|deg)|[fc][xy]_px|scale_m_per_px)$")
"""Names of the numbers of a rig that fits estimate with what they are asked for."""


@dataclass(frozen=True)
class ParameterRow:
    """One parameter. All numbers in ``unit``; ``remarks``: what a reader must not miss."""

    name: str
    words: str
    value: Number
    low: Number
    high: Number
    unit: str
    start: Number | None
    change: str
    remarks: tuple[str, ...]


def estimate_row(estimate: Estimate, undetermined: bool) -> ParameterRow:
    """Row of a fitted parameter."""
    e = estimate
    scale = scale_of_interval(e.unit, e.value, e.ci95, e.start)
    value, low, high = value_and_interval(e.value, e.ci95, scale.factor)
    remarks = []
    if e.at_bound:
        remarks.append("at its bound")
    if undetermined:
        remarks.append("not determined")
    start = Number(raw_number(e.start), significant(e.start * scale.factor, 4, strip=True))
    return ParameterRow(e.name, "", value, low, high, scale.unit, start, change(e.start, e.value), tuple(remarks))


def named_row(parameter: NamedParameter, at: str) -> ParameterRow:
    """Row of a fitted parameter of a diagnosis; ``at``: where the result as JSON has it."""
    p = parameter
    scale = scale_of_interval(p.unit, p.value, p.ci95)
    found = value_and_interval(p.value, p.ci95, scale.factor)
    places = (f"{at}/value", f"{at}/ci95/0", f"{at}/ci95/1")
    value, low, high = (n.found_at(place, scale.unit) for n, place in zip(found, places, strict=True))
    return ParameterRow(p.name, p.words, value, low, high, scale.unit, None, "", ())


def nuisance_rows(nuisances: Sequence[Nuisance]) -> list[ParameterRow]:
    """Rows of what was estimated with the parameters; those of a unit share its prefix."""
    sizes: dict[str, list[float]] = {}
    for n in nuisances:
        sizes.setdefault(n.unit, []).append(max(abs(end) for end in n.ci95))
    scales = {unit: scale_for(unit, float(np.median(found))) for unit, found in sizes.items()}
    return [_nuisance_row(n, scales[n.unit]) for n in nuisances]


def _nuisance_row(n: Nuisance, scale: Scale) -> ParameterRow:
    value, low, high = value_and_interval(n.value, n.ci95, scale.factor)
    words = f"in {n.run}" if n.run else ", ".join(f"with {t} in proportion" for t in n.tied)
    return ParameterRow(n.name, words, value, low, high, scale.unit, None, "", ())


@dataclass(frozen=True)
class ShiftRow:
    """One parameter in the baseline and in the amended model; either may lack it. ``nuisance``: of clocks, cameras and
    tool poses, which every fit allows for."""

    name: str
    words: str
    baseline: ParameterRow | None
    amended: ParameterRow | None
    apart: bool
    nuisance: bool


def shift_rows(baseline: Sequence[NamedParameter], amended: Sequence[NamedParameter]) -> list[ShiftRow]:
    """Both models' parameters side by side. ``apart``: the intervals do not overlap."""
    first = {p.name: (k, p) for k, p in enumerate(baseline)}
    second = {p.name: (k, p) for k, p in enumerate(amended)}
    rows = []
    for name in dict.fromkeys([*first, *second]):
        a, b = first.get(name), second.get(name)
        apart = a is not None and b is not None and (a[1].ci95[1] < b[1].ci95[0] or b[1].ci95[1] < a[1].ci95[0])
        rows.append(
            ShiftRow(
                name,
                (b or a)[1].words,  # type: ignore[index]
                named_row(a[1], f"/baseline_parameters/{a[0]}") if a else None,
                named_row(b[1], f"/amended_parameters/{b[0]}") if b else None,
                apart,
                bool(NUISANCES.search(name)),
            )
        )
    return rows


@dataclass(frozen=True)
class ErrorRow:
    """Root-mean-square errors of one channel, all in ``unit``; ``first``, ``last``: the errors over the noise; ``own``:
    error of mesh and time step; ``level``: 'good', 'fair' or 'bad'."""

    run: str
    held_out: bool
    label: str
    unit: str
    before: Number
    after: Number
    noise: Number
    own: Number
    first: Number
    last: Number
    level: str


@dataclass(frozen=True)
class PlacedError:
    """Errors of a channel before and after; ``first``, ``last``: where the result as JSON has them, '' nowhere."""

    error: ChannelError
    first: str = ""
    last: str = ""


def error_row(placed: PlacedError) -> ErrorRow:
    """Row of one channel of one run."""
    e = placed.error
    scale = scale_for(e.unit, e.after, e.noise, e.before)
    entry = placed.last.rpartition("/")[0]

    def shown(value: float, at: str) -> Number:
        return Number(raw_number(value), significant(value * scale.factor, 3), scale.unit, at)

    def multiple(value: float | None, at: str) -> Number:
        return Number(value, times(value), TIMES, at and f"{at}_over_noise")

    return ErrorRow(
        e.run, e.held_out, f"{e.channel} {e.quantity}".strip(), scale.unit, shown(e.before, placed.first),
        shown(e.after, placed.last), shown(e.noise, entry and f"{entry}/noise"), shown(e.own, entry and f"{entry}/own"),
        multiple(e.before_over_noise, placed.first), multiple(e.after_over_noise, placed.last),
        level(over_noise([e], after=True, own=True)),
    )  # fmt: skip


def level(ratio: float | None) -> str:
    """How good an error is that is ``ratio`` times what may be left."""
    if ratio is None or not math.isfinite(ratio):
        return ""
    return "good" if ratio <= 1.25 else "fair" if ratio <= 2.0 else "bad"


def over_noise(errors: Iterable[ChannelError], after: bool, own: bool = False) -> float | None:
    """Error over noise, root mean square over channels; None where neither is known. ``own``: over noise and the error
    of mesh and time step together."""
    ratios = []
    for e in errors:
        value = e.after if after else e.before
        if value is not None and e.noise and math.isfinite(value) and math.isfinite(e.noise):
            ratios.append(value / math.hypot(e.noise, e.own if own else 0.0))
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None


def merged_errors(errors: Sequence[ChannelError]) -> list[ErrorRow]:
    """One row for each channel over all runs of the same role (root mean square over runs)."""
    groups: dict[tuple[bool, str, str, str], list[ChannelError]] = {}
    for e in errors:
        groups.setdefault((e.held_out, e.channel, e.quantity, e.unit), []).append(e)
    rows = []
    for members in groups.values():
        first = members[0]
        runs = len({e.run for e in members})
        rows.append(
            error_row(
                PlacedError(
                    type(first)(
                        run=f"{runs} recordings" if runs > 1 else first.run,
                        channel=first.channel,
                        quantity=first.quantity,
                        unit=first.unit,
                        before=_mean([e.before for e in members]),
                        after=_mean([e.after for e in members]),
                        noise=_mean([e.noise for e in members]),
                        own=_mean([e.own for e in members]),
                        held_out=first.held_out,
                    )
                )
            )
        )
    return sorted(rows, key=lambda r: r.held_out)


def _mean(values: list[float]) -> float:
    good = [v for v in values if v is not None and math.isfinite(v)]
    return float(np.sqrt(np.mean(np.square(good)))) if good else float("nan")


@dataclass(frozen=True)
class CorrelationCell:
    """``level``: -5 to 5, the colour; None on the diagonal."""

    text: str
    level: int | None
    words: str


def correlation_cells(names: Sequence[str], matrix: Sequence[Sequence[float]]) -> list[list[CorrelationCell]]:
    """Rows of the correlation matrix with their colours."""
    out = []
    for i, row in enumerate(matrix):
        cells = []
        for k, value in enumerate(row):
            if i == k:
                cells.append(CorrelationCell("1", None, names[i]))
                continue
            known = value is not None and math.isfinite(value)
            digits = 3 if known and 0.945 <= abs(value) < 0.9995 else 2
            text = fixed(value, digits) if known else MISSING
            colour = max(-5, min(5, round(5 * value))) if known else 0
            cells.append(CorrelationCell(text, colour, f"{names[i]} and {names[k]}: {text}"))
        out.append(cells)
    return out


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from. ``facts``: label and value; ``others``: entries without a place above."""

    bags: list[dict[str, Any]]
    rig: str
    versions: list[tuple[str, str]]
    facts: list[tuple[str, str]]


def provenance_of(data: dict[str, Any]) -> Provenance:
    """Sort the provenance for showing; anything may be missing. Settings are the same for all and left to JSON."""
    bags = []
    for bag in data.get("bags") or []:
        digests = bag.get("sha256") or []
        window = bag.get("window_s")
        part = f" from {window[0]:g} to {window[1]:g} s" if window else ""
        bags.append(
            {
                "path": str(bag.get("path", "")) + part,
                "sha256": [digests] if isinstance(digests, str) else [str(d) for d in digests],
                "held_out": bool(bag.get("held_out")),
            }
        )
    facts = []
    for key, value in data.items():
        if key not in ("bags", "rig", "settings", "versions") and value is not None and value != "":
            facts.append((key.replace("_", " "), _plain(value)))
    versions = [(str(k), str(v)) for k, v in (data.get("versions") or {}).items()]
    return Provenance(bags, str(data.get("rig") or ""), versions, facts)


def _plain(value: Any) -> str:
    """A value of the provenance in words; what was not chosen is left out."""
    if isinstance(value, dict):
        return "; ".join(f"{k.replace('_', ' ')}: {_plain(v)}" for k, v in value.items() if v not in (None, [], {}, ""))
    if isinstance(value, (list, tuple)):
        return ", ".join(_plain(v) for v in value)
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)


def bag_notes(data: dict[str, Any]) -> list[str]:
    """Remarks made while the bags were read."""
    return [
        f"{str(bag.get('path', '')).rstrip('/').rsplit('/', 1)[-1]}: {note}"
        for bag in data.get("bags") or []
        for note in bag.get("notes") or []
    ]
