"""The report of a diagnosis.

Every number of the page stands in ``diagnosis.json`` as well: where, in the attribute ``data-at`` (a JSON pointer), and
in which unit it is shown, in ``data-unit``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.diagnosis.wording import NOWHERE
from sysid.report.fit_page import SHORT_TABLE, ErrorTables, Shown, Tile, plural, recordings
from sysid.report.marker_pictures import with_marker_pictures
from sysid.report.numbers import MISSING, Number, percent, raw_number, scale_for, seconds, significant
from sysid.report.page import embedded_json, write_page
from sysid.report.panels import Windows, run_views, showcase
from sysid.report.strips import LEVELS
from sysid.report.tables import (
    ErrorRow,
    ParameterRow,
    PlacedError,
    ShiftRow,
    bag_notes,
    error_row,
    named_row,
    provenance_of,
    shift_rows,
)

if TYPE_CHECKING:
    from sysid.diagnosis.result import Candidate, Diagnosis

KINDS = {
    "nothing_missing": ("Nothing is missing", "good"),
    "named": ("Named", "named"),
    "one_of": ("One of several", "fair"),
    "partly": ("Partly explained", "fair"),
    "unknown": ("Missing, but unknown", "bad"),
    "refine_discretisation": ("Refine the mesh first", "fair"),
    "recording_fault": ("The recordings are at fault", "bad"),
    "unfinished": ("Not finished", "fair"),
}
"""Short form and colour of each verdict."""

LIKELIHOOD = (
    (0.99, "practically certain"),
    (0.9, "very likely"),
    (0.66, "likely"),
    (0.33, "about as likely as not"),
    (0.1, "unlikely"),
    (0.01, "very unlikely"),
    (0.0, "practically excluded"),
)
"""Words for probabilities from so much on (after Mastrandrea et al., Guidance note on consistent treatment of
uncertainties, IPCC 2010)."""

SHORT_LIMITS = 12
"""Upper limits up to which their table is open."""

MOST_PLACES = 6
"""Places of the model that are shown where no law is known."""


def write_diagnosis_report(diagnosis: Diagnosis, path: Path) -> Path:
    """Write the report of a diagnosis as one HTML file and return its path.

    ``before`` of the series is the baseline, ``after`` the amended model. Errors of a model are the
    ``after`` values of its ``Misfit.errors``.
    """
    d = diagnosis
    kind, colour = KINDS.get(d.verdict, (d.verdict.replace("_", " "), ""))
    both = d.amended is not None
    names = ("baseline", "amended" if both else "baseline")
    placed = paired_errors(d)
    errors = [p.error for p in placed]
    windows = d.located.windows
    worst = max(d.located.channels, key=lambda c: _finite(c.share)) if d.located.channels else None
    shifts = shift_rows(d.baseline_parameters, d.amended_parameters)
    runs = run_views(d.series, errors, windows=windows, both=both, names=names, held_out_first=True)
    return write_page(
        "diagnosis.html.j2",
        path,
        d=d,
        kind=kind,
        level=colour,
        both=both,
        names=names,
        error_caption=f"of the baseline and of {amended_with(d)}" if both else "of the fitted rig",
        amended_with=amended_with(d),
        first=showcase(d.series, errors, windows=windows, both=both, names=names, place=worst, parted=d.parted),
        parted=spans(d.parted, "/parted"),
        lead=lead(d),
        tiles=tiles(d, placed),
        effects=[EffectView.of(c, f"/effects/{k}") for k, c in enumerate(d.effects)],
        shares=[
            _bar(f"{c.channel} {c.quantity}".strip(), "", c.share, f"/located/channels/{k}/share", True)
            for k, c in enumerate(d.located.channels)
        ],
        rivals=rivals(d),
        places=[
            _bar(p.words, p.place, p.probability, f"/places/{k}/probability", k == 0)
            for k, p in enumerate(d.places[:MOST_PLACES])
        ],
        windows=spans(windows, "/located/windows"),
        shifts=[s for s in shifts if not s.nuisance],
        nuisances=[s for s in shifts if s.nuisance],
        shift_sentences=shift_sentences(shifts),
        errors=error_tables(placed),
        prediction=prediction(d, placed),
        limits=limits(d),
        short_limits=SHORT_LIMITS,
        plan=plan_command(d),
        runs=with_marker_pictures(runs, d.marker_fields, names, both),
        level_edges=LEVELS,
        provenance=provenance_of(d.provenance),
        notes=bag_notes(d.provenance),
        data=embedded_json(d.to_json()),
    )


@dataclass(frozen=True)
class EffectView:
    """One effect with its parameters as rows."""

    candidate: Candidate
    parameters: list[ParameterRow]

    @staticmethod
    def of(candidate: Candidate, at: str) -> EffectView:
        """Prepare for showing; ``at``: where the result as JSON has it."""
        return EffectView(candidate, [named_row(p, f"{at}/parameters/{k}") for k, p in enumerate(candidate.parameters)])


@dataclass(frozen=True)
class Bar:
    """A share as a bar. ``percent``: 0 to 100, its length."""

    label: str
    detail: str
    value: Number
    percent: float
    accent: bool = False


def _bar(label: str, detail: str, share: float, at: str, accent: bool = False) -> Bar:
    length = 100.0 * min(max(share, 0.0), 1.0) if math.isfinite(share) else 0.0
    return Bar(label, detail, share_number(share, at), round(length, 2), accent)


def share_number(share: float, at: str) -> Number:
    """A share as a percentage, with its place."""
    return Number(raw_number(share), percent(share), "%", at)


def likelihood(probability: float) -> str:
    """A probability in words."""
    return next((words for least, words in LIKELIHOOD if probability >= least), "not known")


@dataclass(frozen=True)
class Rival:
    """One line of the ranking: probability in words, the shares of the misfit that it takes away."""

    bar: Bar
    effect: EffectView
    words: str
    explained: Number | None
    held_out: Number | None
    answer: bool


def rivals(d: Diagnosis) -> list[Rival]:
    """All that was tried, most probable first; those of the verdict are marked."""
    named = {(c.name, c.place) for c in d.effects}
    placed = [(f"/effects/{k}", c) for k, c in enumerate(d.effects)]
    rest = [(f"/alternatives/{k}", c) for k, c in enumerate(d.alternatives) if (c.name, c.place) not in named]
    out = []
    for at, c in [*placed, *sorted(rest, key=lambda found: -_finite(found[1].probability))]:
        answer = (c.name, c.place) in named
        gain = c.held_out_gain
        out.append(
            Rival(
                _bar(c.title, c.place, c.probability, f"{at}/probability", answer),
                EffectView.of(c, at),
                likelihood(c.probability),
                share_number(c.explained, f"{at}/explained") if c.explained > 0.0 else None,
                None if gain is None or gain <= 0.0 else share_number(gain, f"{at}/held_out_gain"),
                answer,
            )
        )
    return out


def amended_with(d: Diagnosis) -> str:
    """Which model 'amended' means, in words."""
    if d.amended is None:
        return ""
    if d.verdict == "one_of" and d.effects:
        return f"the rig amended with the more probable effect ({d.effects[0].title})"
    return "the amended rig"


def _finite(value: float) -> float:
    return value if math.isfinite(value) else -1.0


def tiles(d: Diagnosis, placed: Sequence[PlacedError]) -> list[Tile]:
    """The numbers that sum the diagnosis up."""
    out = []
    if d.effects:
        first = d.effects[0]
        chance = share_number(first.probability, "/effects/0/probability")
        out.append(Tile("How sure", (likelihood(first.probability),), ("probability ", chance)))
        out.append(
            Tile(
                "Explained", (share_number(d.explained, "/explained"),), ("of the misfit beyond noise is gone with it",)
            )
        )
    for label, held_out in (("Error", False), ("Error, held out", True)):
        row = telling_row(d, placed, held_out)
        if row is None:
            out.append(Tile(label, (MISSING,), ("no recording was held out" if held_out else "not known",)))
            continue
        before: tuple[Shown, ...] = (row.before, " → ") if d.amended else ()
        multiple: tuple[Shown, ...] = (row.first, " → ") if d.amended else ()
        out.append(
            Tile(
                label,
                (*before, row.after, f" {row.unit}"),
                (f"{row.label}: ", *multiple, row.last, " the noise"),
                row.level,
            )
        )
    if d.located.phase not in ("", NOWHERE) and d.located.channels:
        out.append(Tile("Mostly while", (d.located.phase,), ("phase of the motion",)))
    took = Number(raw_number(d.seconds), seconds(d.seconds), seconds(d.seconds).rpartition(" ")[2], "/seconds")
    out.append(Tile("Took", (took,), ("for the whole search",)))
    return out


def telling_row(d: Diagnosis, placed: Sequence[PlacedError], held_out: bool) -> ErrorRow | None:
    """The errors of the channel that says most, on recordings of one role: where most of the misfit is, and of several
    such recordings that which the baseline misses most."""
    known = [p for p in placed if p.error.held_out == held_out and p.error.before_over_noise is not None]
    share = {(c.channel, c.quantity): _finite(c.share) for c in d.located.channels}

    def says(p: PlacedError) -> tuple[float, float]:
        e = p.error
        where = share.get((e.channel, e.quantity or "position"), 0.0)
        return (where, e.before_over_noise or 0.0)

    return error_row(max(known, key=says)) if known else None


def lead(d: Diagnosis) -> list[str]:
    """What the verdict rests on: a few sentences."""
    bags = d.provenance.get("bags") or []
    used, kept = (recordings(bags, d.baseline.errors, held_out) for held_out in (False, True))
    out = [d.no_success] if d.no_success else []
    if used:
        more = f"; {kept} more {'was' if kept == 1 else 'were'} held out" if kept else ""
        out.append(f"The rig {d.rig} was fitted to {plural(used, 'recording')}{more}.")
    if not kept and d.baseline.held_out is None:
        out.append(
            "No recording was held out, so the finding rests on the recordings it was made from. "
            "Give some with --held-out to test it."
        )
    return out


def paired_errors(d: Diagnosis) -> list[PlacedError]:
    """Errors of the baseline (before) and of the amended model (after), with their places."""
    amended = {}
    for k, e in enumerate(d.amended.errors if d.amended else ()):
        amended[e.run, e.channel, e.quantity, e.held_out] = (k, e)
    out = []
    for k, e in enumerate(d.baseline.errors):
        at = f"/fit/baseline/errors/{k}/after"
        other = amended.pop((e.run, e.channel, e.quantity, e.held_out), None)
        if other is None:
            out.append(PlacedError(replace(e, before=e.after), at, at))
        else:
            found = replace(e, before=e.after, after=other[1].after)
            out.append(PlacedError(found, at, f"/fit/amended/errors/{other[0]}/after"))
    for k, e in amended.values():
        out.append(PlacedError(e, f"/fit/amended/errors/{k}/before", f"/fit/amended/errors/{k}/after"))
    return out


def error_tables(placed: Sequence[PlacedError]) -> ErrorTables:
    """Errors as tables; where there are many, first those of the recording of each role that has the largest."""
    rows = sorted(placed, key=lambda p: p.error.held_out)
    full = [error_row(p) for p in rows]
    if len(full) <= SHORT_TABLE:
        return ErrorTables(full, [])
    largest: dict[bool, tuple[float, str]] = {}
    for p in rows:
        e = p.error
        largest[e.held_out] = max(largest.get(e.held_out, (-1.0, "")), (e.before_over_noise or 0.0, e.run))
    short = [r for r in full if r.run == largest[r.held_out][1]]
    return ErrorTables(short, full if len(full) > len(short) else [])


def prediction(d: Diagnosis, placed: Sequence[PlacedError]) -> list[Shown]:
    """What the held-out recordings say, words and numbers in turns."""
    row = telling_row(d, placed, held_out=True)
    if row is None:
        return []
    if d.amended is None:
        return [f"On recordings that the fit has not seen, the error of {row.label} is ", row.after, f" {row.unit}, ",
                row.last, " the noise."]  # fmt: skip
    verb = "falls" if (row.last.raw or 0.0) < (row.first.raw or 0.0) else "rises"
    return [f"On recordings that no fit has seen, the error of {row.label} {verb} from ", row.before, " to ", row.after,
            f" {row.unit}, from ", row.first, " to ", row.last, " the noise."]  # fmt: skip


def spans(windows: Windows, where: str) -> list[tuple[str, list[tuple[Number, Number]]]]:
    """Windows of recordings in seconds, with their places: ``where`` the result as JSON has them."""
    out = []
    for run, found in windows.items():
        at = f"{where}/{run.replace('~', '~0').replace('/', '~1')}"
        ends = [
            [Number(float(t), f"{t:.2f}", "s", f"{at}/{k}/{i}") for i, t in enumerate(w)] for k, w in enumerate(found)
        ]
        if ends:
            out.append((run, [(a, b) for a, b in ends]))
    return out


def shift_sentences(shifts: Sequence[ShiftRow]) -> list[list[Shown]]:
    """What leaving the effect out did to the other parameters, words and numbers in turns."""
    out: list[list[Shown]] = []
    for s in shifts:
        if s.apart and s.baseline and s.amended:
            a, b = s.baseline, s.amended
            low = "low" if (a.value.raw or 0.0) < (b.value.raw or 0.0) else "high"
            out.append([f"{s.name} was fitted too {low} without it: ", a.value, f" {a.unit}".rstrip() + " instead of ",
                        b.value, f" {b.unit}".rstrip() + "."])  # fmt: skip
    return out


def plan_command(d: Diagnosis) -> str:
    """The command that says what a motion would tell of the answer."""
    names = [p.name for c in d.effects for p in c.parameters]
    return f"thinshell plan amended_rig.yaml motion.yaml --params {','.join(names)}" if names else ""


@dataclass(frozen=True)
class Limit:
    """An effect that was not found, and how large it can be at most."""

    title: str
    name: str
    words: str
    number: Number


def limits(d: Diagnosis) -> list[Limit]:
    """Upper limits of what is not an answer, with the words and units of the effects they belong to."""
    named = {c.name for c in d.effects}
    out = []
    for key, value in d.upper_limits.items():
        if key.removeprefix("effects.").split(".")[0] in named:
            continue
        title, words, unit = _effect_words(key)
        scale = scale_for(unit, value)
        number = Number(raw_number(value), significant(value * scale.factor, 2), scale.unit, f"/upper_limits/{key}")
        out.append(Limit(title, key, words, number))
    return out


def _effect_words(key: str) -> tuple[str, str, str]:
    """Title of the effect, words and unit of its parameter, from 'effect.parameter' or 'effect'."""
    from sim_core.effects import all_effects, split_key

    parts = key.removeprefix("effects.").split(".")
    for effect in all_effects().values():
        if effect.name != split_key(parts[0])[0]:
            continue
        for p in effect.parameters:
            if p.name == parts[-1] or (len(parts) == 1 and p is effect.parameters[0]):
                return effect.title, p.words, p.unit
        return effect.title, "", ""
    return parts[0].replace("_", " "), " ".join(parts[1:]).replace("_", " "), ""
