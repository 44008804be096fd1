"""The report of a fit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.fit.given_values import rose, worsened
from sysid.fit.result import LOOK_FIRST
from sysid.report.marker_pictures import with_marker_pictures
from sysid.report.numbers import MISSING, Number, seconds, significant, times, with_unit
from sysid.report.page import embedded_json, write_page
from sysid.report.panels import run_views, showcase
from sysid.report.profiles import profile_pictures
from sysid.report.strips import LEVELS
from sysid.report.tables import (
    ErrorRow,
    PlacedError,
    correlation_cells,
    error_row,
    estimate_row,
    level,
    merged_errors,
    nuisance_rows,
    over_noise,
    provenance_of,
)
from sysid.settings.noise import NOISE

if TYPE_CHECKING:
    from sysid.fit.result import ChannelError, FitResult

REACHES_NOISE = 1.5
"""Reduced chi-square up to which a fit is said to explain the recordings down to their noise."""

NEAR_NOISE = 4.0
"""Reduced chi-square up to which a fit is said to come near."""


SHORT_TABLE = 16
"""Rows up to which errors are shown for each recording at once."""


Shown = Number | str
"""A piece of a sentence on a page."""


@dataclass(frozen=True)
class Tile:
    """One number that sums up, with what it means, both in pieces. ``level``: 'good', 'fair', 'bad' or ''."""

    label: str
    value: tuple[Shown, ...]
    meaning: tuple[Shown, ...]
    level: str = ""


def write_fit_report(result: FitResult, path: Path) -> Path:
    """Write the report of a fit as one HTML file and return its path."""
    undetermined = result.undetermined
    names = ("before", "after")
    runs = with_marker_pictures(run_views(result.series, result.errors), result.marker_fields, names, both=True)
    return write_page(
        "fit.html.j2",
        path,
        result=result,
        headline=headline(result),
        level=overall_level(result),
        lead=lead(result, undetermined),
        tiles=tiles(result, undetermined),
        parameters=[estimate_row(e, e.name in undetermined) for e in result.estimates],
        nuisances=nuisance_rows([n for n in result.nuisances if n.informed]),
        profiles=profile_pictures(result.profiles),
        correlation=correlation_cells([e.name for e in result.estimates], result.correlation),
        runs=runs,
        names=names,
        error_caption="before and after the fit",
        first=showcase(result.series, result.errors),
        both=True,
        errors=ErrorTables.of(result.errors),
        noise=noise_rows(result),
        reduced=significant(result.reduced_chi2),
        noise_replaced_from=NOISE.declared_noise_ratio,
        level_edges=LEVELS,
        provenance=provenance_of(result.provenance),
        notes=result.notes,
        look_first=LOOK_FIRST,
        trusted=explains(result) != "bad",
        data=embedded_json(result.to_json()),
    )


@dataclass(frozen=True)
class ErrorTables:
    """``short``: over all recordings of a role; ``full``: each recording, empty where that says the same."""

    short: list[ErrorRow]
    full: list[ErrorRow]

    @staticmethod
    def of(errors: Sequence[ChannelError]) -> ErrorTables:
        """Errors as tables; training first."""
        full = [error_row(PlacedError(e)) for e in sorted(errors, key=lambda e: e.held_out)]
        short = merged_errors(errors)
        if len(full) <= SHORT_TABLE:
            return ErrorTables(full, [])
        return ErrorTables(short, full if len(full) > len(short) else [])


def explains(result: FitResult) -> str:
    """How near the fit comes to the noise: 'good', 'fair' or 'bad'; empty where that is not known."""
    chi2 = result.reduced_chi2
    if chi2 is None or not math.isfinite(chi2):
        return ""
    found = "good" if chi2 <= REACHES_NOISE else "fair" if chi2 <= NEAR_NOISE else "bad"
    return "fair" if result.unexplained and found == "good" else found


def overall_level(result: FitResult) -> str:
    """The colour of the headline."""
    if not result.converged or result.no_success or result.contradicted or rose(result.errors):
        return "bad"
    held_out = level(over_noise([e for e in result.errors if e.held_out], after=True, own=True))
    worst = {"bad": 2, "fair": 1}
    return max((explains(result), held_out), key=lambda x: worst.get(x, 0))


def headline(result: FitResult) -> str:
    """The outcome in one sentence."""
    if not result.converged:
        return "The fit did not converge: take its values as a start, not as a result."
    if not result.estimates:
        return "Nothing was fitted: the rig as it is, against the recordings."
    if result.no_success:
        return "This fit is no success: what it leaves is many times the noise. Take its values as no result."
    if result.contradicted:
        return "The recordings contradict what was known before, and the fit lies between the two."
    if rose(result.errors):
        return "The fitted rig errs more than the rig as it was given: do not take its values without knowing why."
    found = explains(result)
    held_out = [e for e in result.errors if e.held_out]
    there = level(over_noise(held_out, after=True, own=True))
    if found == "good" and there == "bad":
        return "The fitted rig explains the recordings it was fitted to, but not those held out."
    if found == "good":
        also = ", and predicts those held out as well" if there == "good" else ""
        left = over_noise(result.errors, after=True)
        own = "" if level(left) in ("", "good") else " and the error of its own mesh and time step"
        return f"The fitted rig explains the recordings down to their noise{own}{also}."
    if found == "fair":
        return "The fitted rig comes near the recordings, but leaves more than their noise."
    if found == "bad":
        return "The fitted rig does not explain the recordings: far more than noise is left."
    return "The rig was fitted; how well is not known, because the noise is not."


def lead(result: FitResult, undetermined: set[str]) -> list[str]:
    """What was fitted, to what, how well, and what could not be determined: a few sentences."""
    bags = result.provenance.get("bags") or []
    used = recordings(bags, result.errors, False)
    kept = recordings(bags, result.errors, True)
    n = len(result.estimates)
    first = f"{plural(n, 'parameter')} of the rig {result.rig} {'was' if n == 1 else 'were'} fitted to "
    first += f"{plural(used, 'recording')}; "
    first += (
        f"{plural(kept, 'recording')} {'was' if kept == 1 else 'were'} held out to check the prediction."
        if kept
        else "none was held out, so nothing here tests a prediction."
    )
    out = [first]
    training = [e for e in result.errors if not e.held_out]
    a, b = over_noise(training, after=False), over_noise(training, after=True)
    if a is not None and b is not None:
        sentence = f"The error {_went(a, b)} the noise"
        held_out = [e for e in result.errors if e.held_out]
        c, d = over_noise(held_out, after=False), over_noise(held_out, after=True)
        if c is not None and d is not None:
            sentence += f"; on held-out recordings it {_went(c, d)}"
        out.append(sentence + ".")
    out += [
        f"The error of {f'{e.channel} {e.quantity}'.strip()} in {e.run} rose from {with_unit(e.before, e.unit)} to "
        f"{with_unit(e.after, e.unit)}, from {times(e.before_over_noise)} to {times(e.after_over_noise)} the noise."
        for e in worsened(training)
    ]
    bounds = [e.name for e in result.estimates if e.at_bound]
    if undetermined:
        named = [e.name for e in result.estimates if e.name in undetermined]
        out.append(
            f"These recordings do not determine {_listed(named)} on {'its' if len(named) == 1 else 'their'} own."
        )
    elif n and result.converged and explains(result) != "bad":
        traded = ", though some are traded off against each other" if result.identifiability else ""
        every = "Every parameter" if not bounds else "Every other parameter" if len(bounds) < n else ""
        if every:
            out.append(f"{every} is determined by these recordings{traded}.")
    if bounds:
        out.append(f"{_listed(bounds)} ended at a bound: the true value may lie beyond.")
    if not result.converged and result.message:
        out.append(f"The search ended with: {result.message}")
    if explains(result) == "bad" and not result.unexplained:
        out.append(
            "Intervals are widened by the misfit, but a law that is missing can still pull values away from "
            "the truth; 'thinshell diagnose' looks for one."
        )
    return [*filter(None, [result.no_success]), *out, *result.contradicted, *result.unexplained, *result.cautions]


def _went(start: float, end: float) -> str:
    """How an error changed, by what is shown of it."""
    if times(start) == times(end):
        return f"stayed at {times(end)}"
    return f"{'fell' if end < start else 'rose'} from {times(start)} to {times(end)}"


def tiles(result: FitResult, undetermined: set[str]) -> list[Tile]:
    """The numbers that sum the fit up."""
    training = over_noise([e for e in result.errors if not e.held_out], after=True)
    held_out = over_noise([e for e in result.errors if e.held_out], after=True)
    n = len(result.estimates)
    open_ended = undetermined | {e.name for e in result.estimates if e.at_bound}
    out = [
        Tile(
            "Error, training",
            (times(training),),
            ("the noise",),
            level(over_noise([e for e in result.errors if not e.held_out], after=True, own=True)),
        ),
        Tile(
            "Error, held out",
            (times(held_out),),
            ("the noise" if held_out is not None else "no recording was held out",),
            level(over_noise([e for e in result.errors if e.held_out], after=True, own=True)),
        ),
        Tile(
            "Determined",
            (f"{n - len(open_ended)} of {n}",),
            ("parameters",),
            "good" if n and not open_ended else "fair" if n else "",
        ),
        Tile(
            "Search",
            ("converged" if result.converged else "not converged",),
            (f"{plural(result.evaluations, 'evaluation')} in {seconds(result.seconds)}",),
            "good" if result.converged else "bad",
        ),
    ]
    return out


@dataclass(frozen=True)
class NoiseRow:
    """Noise of one channel and quantity."""

    label: str
    sigma: str
    declared: str
    correlation: str
    source: str


def noise_rows(result: FitResult) -> list[NoiseRow]:
    """The noise that the fit worked with."""
    out: list[NoiseRow] = []
    seen = set()
    for e in result.errors:
        key = (e.channel, e.quantity)
        if key in seen:
            continue
        seen.add(key)
        model = result.noise.get(e.channel, {})
        declared = MISSING if e.declared is None else with_unit(e.declared, e.unit)
        out.append(_noise_row(f"{e.channel} {e.quantity}".strip(), with_unit(e.noise, e.unit), declared, model))
    measured = {channel for channel, _ in seen}
    for channel, model in result.noise.items():
        if channel not in measured:
            out.append(_noise_row(channel, significant(model.get("sigma")), MISSING, model))
    return out


def _noise_row(label: str, sigma: str, declared: str, model: dict[str, object]) -> NoiseRow:
    rho = model.get("correlation")
    if not isinstance(rho, int | float) or not math.isfinite(rho):
        colour = MISSING
    elif rho == 0.0:
        colour = "white"
    else:
        colour = f"{significant(float(rho), 2)} from one sample to the next"
    return NoiseRow(label, sigma, declared, colour, str(model.get("from", MISSING)))


def recordings(bags: list[dict[str, Any]], errors: Iterable[ChannelError], held_out: bool) -> int:
    """How many recordings of a role there are, from the provenance or else from the errors."""
    found = sum(bool(b.get("held_out")) == held_out for b in bags)
    return found or len({e.run for e in errors if e.held_out == held_out})


def plural(n: int, noun: str) -> str:
    """A number with its noun."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
