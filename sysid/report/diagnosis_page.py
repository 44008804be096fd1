"""The report of a diagnosis."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.report.fit_page import ErrorTables, Tile, plural, recordings
from sysid.report.numbers import MISSING, TIMES, Number, percent, raw_number, seconds, significant, times, with_unit
from sysid.report.page import embedded_json, write_page
from sysid.report.panels import run_views, showcase
from sysid.report.strips import LEVELS
from sysid.report.tables import (
    ParameterRow,
    bag_notes,
    level,
    named_row,
    over_noise,
    provenance_of,
    shift_rows,
)

if TYPE_CHECKING:
    from sysid.diagnosis.result import Candidate, Diagnosis
    from sysid.fit.result import ChannelError

KINDS = {
    "nothing_missing": ("Nothing is missing", "good"),
    "named": ("Named", "named"),
    "one_of": ("One of several", "fair"),
    "partly": ("Partly explained", "fair"),
    "unknown": ("Missing, but unknown", "bad"),
    "refine_discretisation": ("Refine the mesh first", "fair"),
    "recording_fault": ("The recordings are at fault", "bad"),
}
"""Short form and colour of each verdict."""

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
    errors = paired_errors(d)
    windows = d.located.windows
    worst = max(d.located.channels, key=lambda c: _finite(c.share)) if d.located.channels else None
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
        first=showcase(d.series, errors, windows=windows, both=both, names=names, place=worst),
        lead=lead(d),
        tiles=tiles(d),
        effects=[EffectView.of(c) for c in d.effects],
        shares=shares(d),
        rivals=rivals(d),
        rest=remainder(d),
        place_and_time=place_and_time(d),
        places=[_bar(p.words, p.place, p.explained, k == 0) for k, p in enumerate(d.places[:MOST_PLACES])],
        windows=[(run, w) for run, w in windows.items() if w],
        shifts=shift_rows(d.baseline_parameters, d.amended_parameters),
        shift_sentences=shift_sentences(d),
        errors=ErrorTables.of(errors),
        held_out_sentence=held_out_sentence(d),
        budget=budget(d),
        limits=limits(d),
        discretisation=discretisation_facts(d),
        noise=[(k, significant(v), raw_number(v)) for k, v in d.noise_floor.items()],
        runs=run_views(d.series, errors, windows=windows, both=both, names=names, held_out_first=True),
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
    def of(candidate: Candidate) -> EffectView:
        """Prepare for showing."""
        return EffectView(candidate, [named_row(p) for p in candidate.parameters])


@dataclass(frozen=True)
class Bar:
    """A share as a bar. ``percent``: 0 to 100, its length."""

    label: str
    detail: str
    text: str
    percent: float
    accent: bool = False


def _bar(label: str, detail: str, share: float, accent: bool = False) -> Bar:
    length = 100.0 * min(max(share, 0.0), 1.0) if math.isfinite(share) else 0.0
    return Bar(label, detail, percent(share), round(length, 2), accent)


def shares(d: Diagnosis) -> list[Bar]:
    """Where the baseline's excess misfit is, or what the answer changes."""
    return [_bar(f"{c.channel} {c.quantity}".strip(), "", c.share, True) for c in d.located.channels]


@dataclass(frozen=True)
class Rival:
    """One line of the ranking."""

    bar: Bar
    effect: EffectView
    gain: str
    held_out: str
    answer: bool


def rivals(d: Diagnosis) -> list[Rival]:
    """All that was tried, most probable first; the answer or answers are marked."""
    answers = {(c.name, c.place) for c in d.effects}
    rest = [c for c in d.alternatives if (c.name, c.place) not in answers]
    out = []
    for c in [*d.effects, *sorted(rest, key=lambda c: -_finite(c.probability))]:
        answer = (c.name, c.place) in answers
        out.append(
            Rival(
                _bar(c.title, c.place, c.probability, answer),
                EffectView.of(c),
                _signed(c.log_evidence_gain),
                MISSING if c.held_out_gain is None else percent(c.held_out_gain),
                answer,
            )
        )
    return out


def remainder(d: Diagnosis) -> Bar | None:
    """Probability that none of the effects takes; None where it is next to nothing."""
    known = [c.probability for c in {(c.name, c.place): c for c in (*d.alternatives, *d.effects)}.values()]
    left = 1.0 - sum(p for p in known if math.isfinite(p))
    if d.verdict not in ("nothing_missing", "unknown", "refine_discretisation") or not known or left < 0.005:
        return None
    return _bar("The rig as it is" if d.verdict != "unknown" else "None of these", "", left, True)


def amended_with(d: Diagnosis) -> str:
    """Which model 'amended' means, in words."""
    if d.amended is None:
        return ""
    if d.verdict == "one_of" and d.effects:
        return f"the rig amended with the more probable effect ({d.effects[0].title})"
    return "the amended rig"


def _finite(value: float) -> float:
    return value if math.isfinite(value) else -1.0


def _signed(value: float) -> str:
    text = significant(value)
    return f"+{text}" if math.isfinite(value) and value > 0 else text


def tiles(d: Diagnosis) -> list[Tile]:
    """The numbers that sum the diagnosis up."""
    out = []
    if d.effects:
        total = sum(c.probability for c in d.effects if math.isfinite(c.probability))
        together = "together" if len(d.effects) > 1 else "among all that was tried"
        out.append(Tile("Probability", percent(min(total, 1.0)), together))
    for label, before, after in (
        ("Misfit, training", d.baseline.training, d.amended.training if d.amended else None),
        ("Misfit, held out", d.baseline.held_out, d.amended.held_out if d.amended else None),
    ):
        if before is None:
            out.append(Tile(label, MISSING, "no recording was held out"))
            continue
        last = before if after is None else after
        shown = significant(before) if after is None else f"{significant(before)} → {significant(after)}"
        out.append(Tile(label, shown, "mean square over noise; 1 = noise", level(math.sqrt(max(last, 0.0)))))
    gains = [c.held_out_gain for c in d.effects if c.held_out_gain is not None]
    if gains and d.verdict == "named":
        out.append(Tile("Held-out gain", percent(max(gains)), "of the misfit is removed"))
    if d.located.phase and d.located.channels:
        out.append(Tile("Mostly while", d.located.phase, "phase of the motion"))
    out.append(Tile("Took", seconds(d.seconds), "for the whole search"))
    return out


def lead(d: Diagnosis) -> list[str]:
    """What the verdict rests on: a few sentences."""
    bags = d.provenance.get("bags") or []
    used, kept = (recordings(bags, d.baseline.errors, held_out) for held_out in (False, True))
    out = []
    if used:
        more = f"; {kept} more {'was' if kept == 1 else 'were'} held out" if kept else ""
        out.append(f"The rig {d.rig} was fitted to {plural(used, 'recording')}{more}.")
    if d.verdict != "nothing_missing":
        out.append(place_and_time(d))
    out.append(held_out_sentence(d))
    return [s for s in out if s]


def paired_errors(d: Diagnosis) -> list[ChannelError]:
    """Errors of the baseline (before) and of the amended model (after)."""
    amended = {(e.run, e.channel, e.quantity, e.held_out): e for e in d.amended.errors} if d.amended else {}
    out = []
    for e in d.baseline.errors:
        other = amended.pop((e.run, e.channel, e.quantity, e.held_out), None)
        out.append(replace(e, before=e.after, after=other.after if other else e.after))
    return [*out, *amended.values()]


def held_out_sentence(d: Diagnosis) -> str:
    """What the held-out recordings say."""
    pairs = [e for e in paired_errors(d) if e.held_out]
    before, after = over_noise(pairs, after=False), over_noise(pairs, after=True)
    if d.baseline.held_out is None and before is None:
        return (
            "No recording was held out, so the finding rests on the recordings it was made from. "
            "Give some with --held-out to test it."
        )
    if d.amended is None:
        text = significant(before) if before is not None else MISSING
        return f"On recordings that the fit has not seen, the baseline errs by {text} times the noise."
    if before is None or after is None:
        return ""
    verb = "falls" if after < before else "rises"
    return (
        f"On recordings that no fit has seen, the error {verb} from {significant(before)} to "
        f"{significant(after)} times the noise."
    )


def place_and_time(d: Diagnosis) -> str:
    """Where and when the baseline fails, in one sentence."""
    channels = [c for c in d.located.channels if math.isfinite(c.share)]
    if not channels:
        return ""
    top = max(channels, key=lambda c: c.share)
    name = f"{top.channel} {top.quantity}".strip()
    what = "what the answer changes" if d.effects and d.amended else "the baseline's excess misfit"
    sentence = f"{percent(top.share)} of {what} is in {name}"
    if d.located.phase:
        sentence += f", mostly while {d.located.phase}"
    total = sum(b - a for spans in d.located.windows.values() for a, b in spans)
    if total > 0.0:
        runs = sum(1 for spans in d.located.windows.values() if spans)
        sentence += f"; it shows for {significant(total, 2)} s in {runs} recording{'s' if runs > 1 else ''}"
    return sentence + "."


def shift_sentences(d: Diagnosis) -> list[str]:
    """What leaving the effect out did to the other parameters."""
    after = {p.name: p for p in d.amended_parameters}
    out = []
    for p in d.baseline_parameters:
        q = after.get(p.name)
        if q is None or not all(map(math.isfinite, (p.value, q.value))) or q.value == 0.0:
            continue
        apart = p.ci95[1] < q.ci95[0] or q.ci95[1] < p.ci95[0]
        if not apart:
            continue
        off = p.value / q.value - 1.0
        low = "low" if p.value < q.value else "high"
        amount = (
            f"{significant(100.0 * abs(off), 2)} %" if abs(off) < 2.0 else f"{significant(p.value / q.value, 2)}{TIMES}"
        )
        out.append(
            f"{p.name} was {amount} too {low} without it: {with_unit(p.value, p.unit)} instead of "
            f"{with_unit(q.value, q.unit)}."
        )
    return out


def budget(d: Diagnosis) -> list[Bar]:
    """The baseline's mean squared misfit, split into what explains it; empty where it is only noise."""
    if not math.isfinite(d.baseline.training) or d.baseline.training <= 1.0 or d.amended is None:
        return []
    total = d.baseline.training
    left = min(max(d.amended.training, 0.0), total)
    parts = [
        ("noise", min(1.0, left)),
        ("explained by the effect", total - left),
        ("not explained", max(left - 1.0, 0.0)),
    ]
    return [_bar(name, significant(value), value / total) for name, value in parts]


@dataclass(frozen=True)
class Fact:
    """One number with what it says. ``raw``: as computed, None where there is none."""

    label: str
    text: str
    raw: float | None
    meaning: str


def discretisation_facts(d: Diagnosis) -> list[Fact]:
    """The discretisation error beside the baseline's misfit, both as structured energies."""
    energy, misfit = d.discretisation.get("structured_energy"), d.discretisation.get("structured_misfit")
    per_score = d.discretisation.get("structured_misfit_per_score")
    if energy is None or misfit is None or per_score is None:
        return []
    ratio = misfit / energy if energy > 0.0 else math.nan
    squares = "squared noise units, summed over blocks of time and all columns"
    return [
        Fact("Error of mesh and time step", significant(energy), raw_number(energy), squares),
        Fact("Baseline's misfit beyond noise", significant(misfit), raw_number(misfit), squares),
        Fact(
            "Misfit over discretisation error",
            times(ratio),
            raw_number(ratio),
            "far below 1: the simulator itself may be to blame; far above: something is missing",
        ),
        Fact("Baseline's misfit per score", significant(per_score), raw_number(per_score), "mean square; 1 = noise"),
    ]


@dataclass(frozen=True)
class Limit:
    """An effect that was not found, and how large it can be at most."""

    title: str
    name: str
    words: str
    number: Number
    unit: str


def limits(d: Diagnosis) -> list[Limit]:
    """Upper limits of what is not an answer, with the words and units of the effects they belong to."""
    answers = {c.name for c in d.effects}
    out = []
    for key, value in d.upper_limits.items():
        if key.removeprefix("effects.").split(".")[0] in answers:
            continue
        title, words, unit = _effect_words(key)
        text = with_unit(value, unit)
        out.append(Limit(title, key, words, Number(raw_number(value), text), ""))
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
