"""The account that a diagnosis gives of itself: candidates, what became of each effect, limits, reservations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim_core.effects import all_effects, split_key
from sim_core.rigs import Rig
from sysid.comparison.evidence import Evidence
from sysid.comparison.posterior import Posterior
from sysid.diagnosis.baseline import Baseline
from sysid.diagnosis.candidates import Hypothesis
from sysid.diagnosis.contradictions import contradictions
from sysid.diagnosis.first_shapes import first_rests, other_first_shapes
from sysid.diagnosis.fitted_sets import FittedSet
from sysid.diagnosis.result import Candidate, NamedParameter
from sysid.diagnosis.validation import beyond_noise, gain_of, seen_by_both
from sysid.diagnosis.verdict import Verdict, in_percent
from sysid.discretisation.refinement import coarse_quantities, large_discretisation_errors
from sysid.model.windows import not_from_rest
from sysid.noise.data_quality import data_quality_warnings
from sysid.noise.estimate import FROM_DIFFERENCES
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.covariance import interval, uncertainty
from sysid.solve.optimum import Fitted


def candidates_of(
    base: Baseline, fitted: Sequence[FittedSet], found: Posterior, verdict: Verdict
) -> tuple[tuple[Candidate, ...], tuple[Candidate, ...]]:
    """The effects of the answer, and the others that were fitted, as they are reported, each once, in the set that is
    most probable."""
    sizes = {m.effects: m for m in found.models}
    order = sorted(fitted[1:], key=lambda s: -(sizes[s.names].probability if s.names in sizes else 0.0))
    named: dict[str, Candidate] = {}
    rest: dict[str, Candidate] = {}
    for one in order:
        model = sizes.get(one.names)
        for h in one.hypotheses:
            into = named if h.effect.name in verdict.answer else rest
            if h.effect.name not in into and (into is rest or is_in_answer(one, verdict)):
                chance = verdict.effects.get(h.effect.name, 0.0)
                factor = model.log_bayes_factor if model else -np.inf
                into[h.effect.name] = _candidate(base, one, h, chance, float(max(factor, -1e9)))
    return tuple(named.values()), tuple(rest.values())


def is_in_answer(one: FittedSet, verdict: Verdict) -> bool:
    """Whether a fitted set is what the verdict says is missing, or may be."""
    chosen = verdict.sets if verdict.kind == "one_of" else verdict.sets[:1]
    return any(one.names and set(one.names) == set(s.effects) for s in chosen)


def _candidate(base: Baseline, one: FittedSet, h: Hypothesis, chance: float, factor: float) -> Candidate:
    effect = h.effect
    return Candidate(
        effect.name, effect.title, effect.slot, effect.words, min(chance, 1.0),
        named_parameters(one.fitted, f"effects.{h.key}."), factor,
        gain_of(seen_by_both(base.check, base.there, one.there)), beyond_noise(base.fitted, one.fitted),
    )  # fmt: skip


def named_parameters(fitted: Fitted, prefix: str = "") -> tuple[NamedParameter, ...]:
    """Fitted values with intervals; only those whose name starts with ``prefix``."""
    known = uncertainty(fitted)
    return tuple(
        NamedParameter(p.name, p.physical(s), interval(p, s, sd), p.unit, p.words)
        for p, s, sd in zip(fitted.parameters, fitted.scaled, known.sd, strict=True)
        if p.name.startswith(prefix)
    )


def limits(plain: FittedSet, temper: float, named: Sequence[str]) -> dict[str, float]:
    """By amplitude, the size that an effect which is not ``named`` has at most (95 %) if it alone is missing: of the
    shape that the recordings limit least. Only where they tell more than what was known before."""
    evidence = Evidence(plain.ledger, temper=temper)
    found: dict[str, float] = {}
    lost: set[str] = set()
    for (effect, label), h in plain.seen.hypotheses.items():
        if effect in named or h.drawn:
            continue
        amplitudes = evidence.amplitudes(evidence.directions((effect, label)))
        for known, a in zip(amplitudes, h.amplitudes, strict=True):
            name = f"effects.{h.key}.{a.parameter.name}"
            if not np.isfinite(a.none):
                continue
            most = max(abs(end - a.none) for end in known.interval)
            before = 1.96 * a.sd * abs(a.typical - a.none)
            if a.parameter.log or most >= DIAGNOSIS.limited_sd_share * before:
                lost.add(name)
            found[name] = max(found.get(name, 0.0), float(most))
    return {name: value for name, value in found.items() if name not in lost}


def outcome_by_effect(rig: Rig, verdict: Verdict, failed: Mapping[str, str]) -> dict[str, str]:
    """What became of each effect of the library that the rig may lack, in a few words."""
    present = {split_key(key)[0] for key in rig.effects}
    apply = [e.name for e in all_effects().values() if e.name not in present and e.variants(rig)]
    became = {name: f"probability {in_percent(verdict.effects.get(name, 0.0))}" for name in apply}
    became |= {name: why for name, why in failed.items() if verdict.effects.get(name, 0.0) < 0.01}
    return became | dict.fromkeys(verdict.answer, "the answer")


def notes(base: Baseline, chosen: Sequence[FittedSet]) -> tuple[str, ...]:
    """What a reader should know of the baseline, and of the sets that are the answer, before relying on the verdict."""
    fitted, problem = base.fitted, base.problem
    said = [f"{run.name} does not begin at rest: {n}" for run in problem.runs for n in not_from_rest(fitted.rig, run)]
    if not fitted.converged:
        said.append(f"The baseline fit did not converge: {fitted.message}.")
    if base.undecided:
        names = " and ".join(base.undecided)
        said.append(
            f"{names}: the time steps are those of the rig. Readings change with shorter ones, but so much of them is "
            "not explained without an effect that they cannot tell which they follow. Repeat the diagnosis with half "
            "the solver.dt_s to see what depends on it."
        )
    for one in chosen:
        if not one.fitted.converged:
            said.append(
                f"The fit with '{one.title}' did not converge: {one.fitted.message}. The true values may lie outside "
                "of the intervals."
            )
        if one.there is not None and one.there.rig != one.fitted.rig:
            said.append(
                f"With '{one.title}' at the fitted numbers a body snaps the other way in a recording held out. What is "
                "shown there is the prediction by numbers that the recordings given cannot tell from these; the "
                "amended rig has the fitted ones, and may snap the other way again."
            )
    lasts = [one for one in chosen if any(h.effect.lasting for h in one.hypotheses)]
    earlier = [run.name for run in problem.runs if run.earlier]
    if lasts and earlier:
        said.append(
            f"What '{lasts[0].title}' leaves in a body is there in the recordings that come after by their stamps: "
            f"{', '.join(earlier)}. If each shows a body of its own, say so (--fresh-bodies)."
        )
    if not lasts:
        rests = first_rests(problem, fitted)
        if base.there is not None:
            rests += first_rests(base.check, base.there)
        said += other_first_shapes(rests)
    said += [o.sentence for o in base.outliers]
    said += coarse_quantities(problem)
    said += data_quality_warnings(fitted.rig, problem.runs)
    said += large_discretisation_errors(problem)
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
        f"The baseline needs {c.name} = {c.fitted} where the rig says {c.nominal:.4g}, {c.deviations:.1f} times as far "
        "off as is known of it; that itself needs explaining."
        for c in contradictions(fitted)
        if c.name not in bound
    ]
    return (*said, *base.notes)
