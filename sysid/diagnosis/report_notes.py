"""The account that a diagnosis gives of itself: candidates, what became of each effect, limits, reservations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.effects import all_effects, split_key
from sim_core.rigs import Rig
from sysid.diagnosis.baseline import Baseline
from sysid.diagnosis.candidates import Hypothesis
from sysid.diagnosis.first_shapes import first_rests, other_first_shapes
from sysid.diagnosis.refits import Trial
from sysid.diagnosis.result import Candidate, NamedParameter
from sysid.diagnosis.screening import Score, Screen
from sysid.diagnosis.verdict import Case, Verdict, needless, probabilities, rejected, size_of
from sysid.diagnosis.wording import reason
from sysid.discretisation.refinement import large_discretisation_errors, unresolved_quantities
from sysid.model.windows import not_from_rest
from sysid.noise.data_quality import data_quality_warnings
from sysid.noise.estimate import FROM_DIFFERENCES
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.covariance import interval, uncertainty
from sysid.solve.optimum import Fitted


@dataclass(frozen=True)
class Screened:
    """The look at all effects: the screen beside the baseline, scores of single hypotheses, best first, and what could
    not be looked at."""

    screen: Screen
    singles: Sequence[Score]
    failed: dict[str, str]


def candidates_of(
    verdict: Verdict, trials: Sequence[Trial], case: Case
) -> tuple[tuple[Candidate, ...], tuple[Candidate, ...]]:
    """The effects of the answer, and the others that were refitted, as they are reported, each once."""
    chances = probabilities(trials, case)
    answers = verdict.named if verdict.kind in ("named", "one_of", "partly") else ()
    named: dict[str, Candidate] = {}
    for trial in answers:
        for h in trial.hypotheses:
            chance = sum(p for names, p in chances.items() if h.effect.name in names)
            named.setdefault(h.effect.name, _candidate(trial, h, chance, ""))
    rest: dict[str, Candidate] = {}
    for trial in trials:
        for h in trial.hypotheses:
            if h.effect.name not in named and (len(trial.hypotheses) == 1 or h.effect.name not in rest):
                rest[h.effect.name] = _candidate(trial, h, chances[trial.names], reason(trial, case))
    return tuple(named.values()), tuple(rest.values())


def _candidate(trial: Trial, h: Hypothesis, chance: float, why: str) -> Candidate:
    effect = h.effect
    return Candidate(
        effect.name, effect.title, effect.slot, effect.words, min(chance, 1.0),
        named_parameters(trial.fitted, f"effects.{h.key}."), float(trial.gain),
        None if trial.held_out is None else float(trial.held_out), why, float(size_of(trial)),
    )  # fmt: skip


def named_parameters(fitted: Fitted, prefix: str = "") -> tuple[NamedParameter, ...]:
    """Fitted values with intervals; only those whose name starts with ``prefix``."""
    known = uncertainty(fitted)
    return tuple(
        NamedParameter(p.name, p.physical(s), interval(p, s, sd), p.unit, p.words)
        for p, s, sd in zip(fitted.parameters, fitted.scaled, known.sd, strict=True)
        if p.name.startswith(prefix)
    )


def limits(screened: Screened, verdict: Verdict) -> dict[str, float]:
    """By amplitude, the size that the recordings would have shown (95 %) of effects that are not the answer: how far
    from the value at which the effect vanishes the best factor with its deviations ends, by the screening. Only where
    that is within reach of the response, and where the recordings tell more than what was known before."""
    named = {h.effect.name for t in verdict.named for h in t.hypotheses}
    found: dict[str, float] = {}
    screen = screened.screen
    for score in screened.singles:
        (number,) = score.numbers
        h = screen.hypotheses[number]
        if h.effect.name in named:
            continue
        for amplitude, factor, sd in zip(h.amplitudes, score.factors[0], screen.deviations(number), strict=True):
            name = f"effects.{h.key}.{amplitude.parameter.name}"
            if name in found or not np.isfinite(amplitude.none):
                continue
            most = abs(factor) + 1.645 * sd
            if most <= amplitude.limits[1] and sd < DIAGNOSIS.limited_sd_share * amplitude.sd:
                p = amplitude.parameter
                reach = max(amplitude.none - p.lower, p.upper - amplitude.none)
                found[name] = float(min(most * abs(amplitude.typical - amplitude.none), reach))
    return found


def fates(rig: Rig, verdict: Verdict, trials: Sequence[Trial], case: Case, screened: Screened) -> dict[str, str]:
    """What became of each effect of the library that the rig may lack, in a few words."""
    present = {split_key(key)[0] for key in rig.effects}
    apply = [e.name for e in all_effects().values() if e.name not in present and e.variants(rig)]
    became = dict.fromkeys(apply, "promised no better fit") | screened.failed
    fit = [t for t in trials if not rejected(t, case)]
    for trial in sorted(trials, key=lambda t: -len(t.names)):
        why = reason(trial, case) or needless(trial, fit, case) or "fits, but less well than the answer"
        for h in trial.hypotheses:
            others = " and that ".join(o.effect.title for o in trial.hypotheses if o is not h)
            became[h.effect.name] = f"tried beside the knowledge that {others} only: {why}" if others else why
    if verdict.kind in ("named", "one_of", "partly"):
        became |= {h.effect.name: "the answer" for t in verdict.named for h in t.hypotheses}
    return became


def other_branch(trial: Trial) -> str:
    """That recordings held out are predicted by other numbers than those of the answer
    (:func:`sysid.diagnosis.predictability.predicted_held_out`), in words; '' where they are not."""
    if trial.predicted is None or trial.predicted.rig == trial.fitted.rig:
        return ""
    return (
        f"With '{trial.title}' at the fitted numbers a body snaps the other way in a recording held out. What is shown "
        "there is the prediction by numbers that the recordings given cannot tell from these; the amended rig has the "
        "fitted ones, and may snap the other way again."
    )


def parts_alone(trials: Sequence[Trial], verdict: Verdict, case: Case) -> list[str]:
    """Of an answer of several effects, what each part of it that was fitted says by itself, in words."""
    named = verdict.named[:1] if verdict.kind in ("named", "partly") else ()
    said = []
    for whole in named:
        for part in (t for t in trials if t.names < whole.names):
            why = rejected(part, case)
            ending = f"it is no answer by itself: {why}" if why else "the rest takes away most of what that leaves"
            ending += "" if part.fitted.converged else " (its fit did not converge)"
            share = 100.0 * max(size_of(part), 0.0)
            said.append(f"That {part.title} alone explains {share:.0f} % of the misfit beyond noise; {ending}.")
    return said


def notes(base: Baseline, case: Case, verdict: Verdict, trials: Sequence[Trial]) -> tuple[str, ...]:
    """What a reader should know of the baseline, and of answers, before believing the verdict."""
    fitted, problem = base.fitted, base.problem
    said = [f"{run.name} does not begin at rest: {n}" for run in problem.runs for n in not_from_rest(fitted.rig, run)]
    if not fitted.converged:
        said.append(f"The baseline fit did not converge: {fitted.message}.")
    for trial in verdict.named if verdict.kind != "unknown" else ():
        if not trial.fitted.converged:
            said.append(
                f"The fit with '{trial.title}' did not converge: {trial.fitted.message}. The true values may lie "
                "outside of the intervals."
            )
    said += parts_alone(trials, verdict, case)
    said += [snap for trial in verdict.named if (snap := other_branch(trial))]
    lasts = [t for t in verdict.named if any(h.effect.lasting for h in t.hypotheses)]
    earlier = [run.name for run in problem.runs if run.earlier]
    if lasts and earlier:
        said.append(
            f"What '{lasts[0].title}' leaves in a body is there in the recordings that come after by their stamps: "
            f"{', '.join(earlier)}. If each shows a body of its own, say so (--fresh-bodies)."
        )
    if case.missing and not lasts:
        rests = first_rests(problem, fitted)
        if base.there is not None:
            rests += first_rests(base.check, base.there)
        said += other_first_shapes(rests)
    said += [o.sentence for o in base.outliers]
    said += case.coarse
    said += case.missed if verdict.kind == "refine_discretisation" else ()
    if case.before.hidden:
        said.append(
            "There is misfit beyond the noise, but no more than the error of mesh and time step could leave. "
            "Finer cells or a shorter solver.dt_s in the rig would tell."
        )
    if case.before.too_small:
        said.append(
            "There is misfit beyond the noise that adds up over many samples, but it changes no reading by more than "
            f"{DIAGNOSIS.least_size:g} times what noise, mesh, time step and careful models leave open, so it is not "
            "asked for."
        )
    said += (
        data_quality_warnings(fitted.rig, problem.runs)
        + large_discretisation_errors(problem)
        + unresolved_quantities(problem)
    )
    for name, noise in problem.noise.items():
        if noise.source == FROM_DIFFERENCES:
            said.append(
                f"Nothing stands still long enough to see the noise of {name}; it was taken from neighbouring "
                "samples. If it is smooth, misfit is overrated: record a rest of 15 samples, or declare it in the rig."
            )
    bound = set()
    for p, scaled in zip(fitted.parameters, fitted.scaled, strict=True):
        low, high = p.scaled_bounds
        if min(scaled - low, high - scaled) < 1e-3 * p.prior_sd:
            bound.add(p.name)
            value = f"{p.physical(scaled):.4g} {p.unit}".rstrip()
            said.append(f"The baseline ends at the bound of {p.name}, {value}; that itself needs explaining.")
    said += [
        f"The baseline needs {c.name} = {c.fitted} where the rig says {c.told:.4g}, {c.deviations:.1f} times as far "
        "off as is known of it; that itself needs explaining."
        for c in case.contradictions
        if c.name not in bound
    ]
    return (*said, *base.notes)
