"""The diagnosis of a rig against recordings: the function behind ``thinshell diagnose``.

1. The baseline is fitted through the pipeline of fits (:mod:`sysid.diagnosis.baseline`).
2. All effects are looked at along its frozen path, with one rollout a recording (:mod:`sysid.diagnosis.screening`), and
   what evidence chance reaches is simulated for the very case.
3. The few that promise something are refitted, alone and in sets of up to three (:mod:`sysid.diagnosis.refits`).
4. The verdict follows from evidence, from what they predict, and from their size (:mod:`sysid.diagnosis.verdict`).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from sim_core.effects import RecordingScales
from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.comparison.ledger import Ledger
from sysid.diagnosis import wording as words
from sysid.diagnosis.baseline import Baseline, fit_baseline
from sysid.diagnosis.candidates import Hypothesis, drawn_shapes, hypotheses, recording_scales
from sysid.diagnosis.closures import Closures
from sysid.diagnosis.confirmation import confirmed, confirmed_without, fitted_to_the_end, parts_to_fit
from sysid.diagnosis.contradictions import contradictions
from sysid.diagnosis.evidence import log_evidence
from sysid.diagnosis.next_motion import in_words, proposed
from sysid.diagnosis.one_model import one_model
from sysid.diagnosis.refits import Trial, refits_of, tempered, trials_of, without_idle
from sysid.diagnosis.report_notes import Screened, candidates_of, fates, limits, named_parameters, notes
from sysid.diagnosis.residual_analysis import locate, structure
from sysid.diagnosis.result import Diagnosis, Misfit, StructuredMisfit, UnreliablePlace
from sysid.diagnosis.screening import Score, Screen, look
from sysid.diagnosis.slots import slot_evidence
from sysid.diagnosis.starts import Start
from sysid.diagnosis.validation import of_readings, seen_by_both
from sysid.diagnosis.verdict import Case, Verdict, answers, cut_off, decide, missed_beside_mesh, size_of
from sysid.discretisation.approximations import Approximations
from sysid.discretisation.refinement import coarse_quantities, error_sizes
from sysid.fit.marker_field import marker_fields
from sysid.fit.result import ChannelError, plot_series, rms_errors
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.prediction_source import Responding
from sysid.model.provenance import provenance
from sysid.observations.observations import Run, check_apart
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted

Progress = Callable[[float, str], None]


def diagnose_runs(
    rig: Rig,
    runs: Sequence[Run],
    held_out: Sequence[Run] = (),
    *,
    on_progress: Progress | None = None,
) -> tuple[Diagnosis, Rig]:
    """Diagnose; the second value is the rig with the answer in it (the fitted baseline when none). Where no run is held
    out, the last of three or more is: what an effect predicts tells it from what follows noise and mesh. Raises
    ``RecordingError`` where two runs have readings in common."""
    check_apart(runs, held_out)
    told: tuple[str, ...] = ()
    if not held_out and len(runs) >= DIAGNOSIS.hold_out_from:
        runs, held_out = runs[:-1], runs[-1:]
        told = (f"{held_out[0].name} was held out, to see what effects predict, since no recording was.",)
    started = time.monotonic()
    tell = on_progress or (lambda share, text: None)
    with ParallelPredictor(os.cpu_count()) as engine:
        tell(0.0, "first simulations")
        base = fit_baseline(engine, rig, runs, held_out, tell)
        tell(0.42, "a look at all effects")
        screen, failed, scales = _looked(base)
        screen.temper(base.fitted.misfit)
        singles = screen.singles()
        case = Case(
            structure(base.problem, base.fitted),
            base.held_out,
            screen.threshold(),
            coarse_quantities(base.problem),
            tuple(o.sentence for o in base.outliers if o.kept),
            contradictions(base.fitted),
            missed_beside_mesh(_errors(base, base.fitted, None if base.together is not None else base.there)),
        )
        tell(0.55, "fits of the promising effects")
        trials = _trials(base, screen, singles, case, scales, failed, tell)
        verdict, trials = _confirmed(base, trials, case, failed, tell)
        places = _places(base, verdict, tell)
        tell(0.97, "report")
        diagnosis, amended = _collect(rig, base, case, verdict, trials, Screened(screen, singles, failed), places)
    diagnosis.notes = (*told, *diagnosis.notes)
    diagnosis.provenance = provenance(rig, list(runs), list(held_out))
    if diagnosis.ledger is not None:
        diagnosis.ledger = replace(diagnosis.ledger, provenance=diagnosis.provenance)
        diagnosis.one_model = one_model(diagnosis.ledger)
    diagnosis.parted = {run.name: run.parted for run in (*runs, *held_out) if run.parted}
    diagnosis.seconds = time.monotonic() - started
    tell(1.0, "done")
    return diagnosis, amended


def ledger_of(
    rig: Rig,
    runs: Sequence[Run],
    held_out: Sequence[Run] = (),
    *,
    shapes: np.random.Generator | None = None,
    on_progress: Progress | None = None,
) -> Ledger:
    """The ledger of a diagnosis: its baseline and its look at all effects, without a refit. ``shapes``: draws shapes of
    effects that no diagnosis looks at, of which it then has columns too."""
    tell = on_progress or (lambda share, text: None)
    with ParallelPredictor(os.cpu_count()) as engine:
        base = fit_baseline(engine, rig, runs, held_out, tell)
        tell(0.42, "a look at all effects")
        screen, _, _ = _looked(base, shapes)
    return replace(screen.ledger(base.fitted), provenance=provenance(rig, list(runs), list(held_out)))


def _looked(
    base: Baseline, shapes: np.random.Generator | None = None
) -> tuple[Screen, dict[str, str], RecordingScales]:
    """A look at all effects and closures from a baseline, what could not be looked at, and the scales of recordings."""
    scales = recording_scales([*base.problem.runs, *base.check.runs])
    fitted, problem = base.fitted, base.problem
    free = Closures(fitted.rig, problem), Approximations(base.engine, fitted, problem)
    wanted = hypotheses(fitted.rig, scales) + ([] if shapes is None else drawn_shapes(fitted.rig, scales, shapes))
    screen, failed = look(base.engine, fitted, problem, wanted, *free)
    return screen, failed, scales


def _trials(
    base: Baseline,
    screen: Screen,
    singles: Sequence[Score],
    case: Case,
    scales: RecordingScales,
    failed: dict[str, str],
    tell: Progress,
) -> list[Trial]:
    """Refits of single effects, of pairs that the screening shows, and of what the best of these leave."""
    least = (
        case.needed
        if case.missing
        else DIAGNOSIS.worth_trying_share * DIAGNOSIS.threshold_factor_without_misfit * case.needed
    )
    promising = [s for s in singles if s.gain > least]
    apart = [s for s in screen.by_recording() if s.gain > least]
    contradicted = any(c.deviations > DIAGNOSIS.certainly_far_sd for c in case.contradictions)
    if not promising and not apart and not contradicted:
        return []
    chosen = _distinct(screen, promising, DIAGNOSIS.simulated_effects, DIAGNOSIS.simulated_second_starts)
    names = {_effect(screen, s) for s in chosen}
    apart = [s for s in apart if _effect(screen, s) not in names]
    starts = [_start(screen, s) for s in (*chosen, *_distinct(screen, apart, DIAGNOSIS.refitted_by_recording, 0))]
    pair = _best_pair(screen, promising)
    if pair is not None and pair.gain > singles[0].gain + case.needed:
        starts.append(_start(screen, pair))
    trials = trials_of(base, base.fitted, starts, scales, failed) if starts else []
    untried = _only_in_pairs(trials, case)
    alone = _distinct(screen, [s for s in singles if _effect(screen, s) in untried], len(singles), 0)
    if alone:
        trials += trials_of(base, base.fitted, [_start(screen, s) for s in alone], scales, failed)
    if contradicted:
        tell(0.7, "the same from the rig's own numbers")
        trials = _best_of_each([*trials, *_from_the_rig(base, case, scales, failed)])
    trials = _pruned(base, trials, failed)
    looked_beside: list[frozenset[str]] = []
    for count in range(2, DIAGNOSIS.most_effects + 1):
        best = next(iter(answers(trials, case)), None)
        if best is None or not best.left.missing or len(best.hypotheses) >= count or best.names in looked_beside:
            break
        looked_beside.append(best.names)
        tell(0.65 + 0.1 * count, f"what '{best.title}' leaves")
        wanted = [h for h in hypotheses(best.fitted.rig, scales) if h.effect.name not in best.names]
        beside, _ = look(base.engine, best.fitted, base.problem, wanted)
        beside.temper(best.fitted.misfit)
        needed = max(case.needed, beside.threshold())
        worth = DIAGNOSIS.could_take_share * DIAGNOSIS.worth_adding_share * best.left.whole.excess
        promising = [s for s in beside.singles() if s.gain > needed and s.fall > worth]
        if not promising:
            break
        further = [_beside(best, _start(beside, s)) for s in _distinct(beside, promising, DIAGNOSIS.tried_beside, 0)]
        more = trials_of(base, best.fitted, further, scales, failed)
        trials = _pruned(base, [*trials, *more], failed)
        if trials[0].gain < best.gain + case.needed:
            break
    return trials


def _from_the_rig(base: Baseline, case: Case, scales: RecordingScales, failed: dict[str, str]) -> list[Trial]:
    """The best effect of a look from the rig's own numbers, fitted from there to the end.

    A baseline that took up an effect by numbers which contradict what is known, a camera that was knocked by its
    principal point say, has bent its materials to what these leave. What it would take to come back is no matter of
    one linear step, and what the reference model adds was measured where it stands. Refits from the rig's numbers are
    compared among themselves; the best of them is fitted on beside the errors that all other trials stand beside.
    """
    try:
        problem, begun = base.at_the_rigs_numbers()
        screen, _ = look(cast(Responding, problem.engine), begun, problem, hypotheses(begun.rig, scales))
    except ThinshellError as error:
        failed["effects from the rig's own numbers"] = f"could not be simulated: {error}"
        return []
    screen.temper(base.fitted.misfit)
    promising = [s for s in screen.singles() if s.gain > case.needed]
    starts = [_start(screen, s) for s in _distinct(screen, promising, DIAGNOSIS.refitted_from_the_rig, 0)]
    found = refits_of(base, problem, begun, starts, scales, failed) if starts else []
    if not found:
        return []
    temper = max(1.0, min(fitted.misfit for _, fitted, _ in found))
    start, best, _ = max(found, key=lambda refit: log_evidence(refit[1], temper))
    ended = fitted_to_the_end(base, start.whole, best, failed)
    return [] if ended is None else [ended]


def _only_in_pairs(trials: Sequence[Trial], case: Case) -> set[str]:
    """Where misfit stands out and no set of effects is an answer, the effects of pairs with enough evidence that were
    not refitted alone: a companion that predicts recordings held out worse must not take a true effect along."""
    if not case.missing or answers(trials, case):
        return set()
    alone = {name for t in trials if len(t.names) == 1 for name in t.names}
    return {name for t in trials if len(t.names) > 1 and t.gain > case.needed for name in t.names} - alone


def _effect(screen: Screen, score: Score) -> str:
    """Name of the effect of a single score."""
    return screen.hypotheses[score.numbers[0]].effect.name


def _best_of_each(trials: Sequence[Trial]) -> list[Trial]:
    """The trial of each set of effects that has most evidence."""
    best: dict[frozenset[str], Trial] = {}
    for t in trials:
        if t.names not in best or t.gain > best[t.names].gain:
            best[t.names] = t
    return list(best.values())


def _pruned(base: Baseline, trials: Sequence[Trial], failed: dict[str, str]) -> list[Trial]:
    """The trials, best first, that set of which is best without the effects that are not told from none beside its
    others: fitted from there, an effect may be better explained than from where it was first looked at."""
    trials = tempered(base, trials)
    best = trials[0] if trials else None
    while best is not None and best.idle and len(best.hypotheses) > 1:
        best = without_idle(base, best, failed)
        if best is not None:
            known = [t for t in trials if t.names == best.names]
            if all(best.fitted.chi2 < t.fitted.chi2 for t in known):
                trials = tempered(base, [best, *(t for t in trials if t not in known)])
    return trials


def _confirmed(
    base: Baseline, trials: list[Trial], case: Case, failed: dict[str, str], tell: Progress
) -> tuple[Verdict, list[Trial]]:
    """The verdict, with every set of effects that it names fitted to the end, beside the reference model where there is
    one, and with the parts of these that matter (:func:`parts_to_fit`). Where none is named, the one with most evidence
    is: a refit that was cut off may be no answer yet."""
    trials = tempered(base, _best_of_each(trials))
    verdict = decide(trials, case)
    left_out: set[frozenset[str]] = set()
    while True:
        wanted = [t for t in verdict.named if not t.confirmed] or cut_off(trials, verdict, case)
        part = None if wanted else _part_to_fit(verdict, trials, left_out)
        if wanted:
            tell(0.9, "the answer" if base.reference is None else "the answer with finer cells")
            found = [confirmed(base, t, failed) for t in wanted]
            gone = {t.names for t in wanted}
        elif part is not None:
            whole, one = part
            tell(0.91, f"whether the answer needs that {one.effect.title}")
            names = whole.names - {one.effect.name}
            left_out.add(names)
            known = next((t for t in trials if t.names == names), None)
            found = [confirmed_without(base, whole, one, known, failed)]
            gone = {names} if found[0] is not None else set()
        else:
            break
        trials = tempered(base, [*(t for t in trials if t.names not in gone), *(t for t in found if t is not None)])
        verdict = decide(trials, case)
    return verdict, trials


def _part_to_fit(
    verdict: Verdict, trials: Sequence[Trial], left_out: Collection[frozenset[str]]
) -> tuple[Trial, Hypothesis] | None:
    """An answer of several effects with the effect that has to be left out of it next: the part that is known to be
    best first, those that are not known last. None where all have been."""
    if verdict.kind == "unknown":
        return None
    pairs = [(whole, one) for whole in verdict.named for one in parts_to_fit(whole, trials)]
    known = {t.names: t.gain for t in trials}

    def promised(pair: tuple[Trial, Hypothesis]) -> float:
        return known.get(pair[0].names - {pair[1].effect.name}, -np.inf)

    pairs = [(whole, one) for whole, one in pairs if whole.names - {one.effect.name} not in left_out]
    return max(pairs, key=promised, default=None)


def _distinct(screen: Screen, scores: Sequence[Score], effects: int, second: int) -> list[Score]:
    """The best start of each effect, best first, and a few further ones of these effects: a law with a threshold has a
    misfit with several minima."""
    first: dict[str, Score] = {}
    for score in scores:
        first.setdefault(_effect(screen, score), score)
    leading = dict(list(first.items())[:effects])
    others = [s for s in scores if _effect(screen, s) in leading and s not in leading.values()]
    return [*leading.values(), *others[:second]]


def _best_pair(screen: Screen, promising: Sequence[Score]) -> Score | None:
    """The two effects that fit best together, by the screening."""
    numbers = [s.numbers[0] for s in _distinct(screen, promising, DIAGNOSIS.paired_effects, 0)]
    pairs = [screen.score([a, b]) for k, a in enumerate(numbers) for b in numbers[k + 1 :]]
    return max(pairs, key=lambda s: s.gain, default=None)


def _start(screen: Screen, score: Score) -> Start:
    return Start(tuple(screen.hypotheses[k] for k in score.numbers), score.factors, score.shift)


def _beside(best: Trial, start: Start) -> Start:
    """A further effect beside those of a trial, which stay where they are fitted."""
    return replace(start, earlier=best.hypotheses)


def _places(base: Baseline, verdict: Verdict, tell: Progress) -> tuple[UnreliablePlace, ...]:
    """Where what remains unknown may be, without a law."""
    if verdict.kind not in ("unknown", "partly"):
        return ()
    tell(0.92, "which place of the model is unreliable")
    model = verdict.named[0].fitted if verdict.kind == "partly" else base.fitted
    found = slot_evidence(base.engine, base.problem, model, max(1.0, model.misfit))
    shares: dict[str, float] = {}
    for channel in locate(base.problem, model).channels:
        shares[channel.channel] = shares.get(channel.channel, 0.0) + channel.share
    return tuple(
        UnreliablePlace(s.slot.place, s.slot.name, s.slot.words, float(s.gain), float(s.explained))
        for s in found
        if s.gain > 0.0 and shares.get(s.slot.name, 1.0) > DIAGNOSIS.sensor_misfit_share
    )


def _misfit(base: Baseline, shown: Trial | None) -> Misfit:
    """Misfit of the baseline or of an answer, with the errors of the baseline beside its own."""
    fitted = base.fitted if shown is None else shown.fitted
    predicted = base.there if shown is None else shown.predicted
    both = seen_by_both(base.check, base.there, predicted)
    return Misfit(
        of_readings(fitted), None if both is None else both[1].misfit, tuple(_errors(base, fitted, predicted))
    )


def _errors(base: Baseline, fitted: Fitted, predicted: Fitted | None) -> list[ChannelError]:
    """Errors of a model, and of the baseline beside it, by recording and quantity."""
    own = error_sizes(base.problem)
    errors = rms_errors(base.problem, base.fitted, fitted, held_out=False, own=own)
    if base.there is not None and predicted is not None:
        errors += rms_errors(base.check, base.there, predicted, held_out=True, own=own)
    return errors


def _structured(case: Case) -> tuple[StructuredMisfit, ...]:
    """What the baseline leaves, quantity by quantity."""
    parts = [(False, p) for p in case.before.parts] + [(True, p) for p in (case.there.parts if case.there else ())]
    return tuple(
        StructuredMisfit(p.run, p.channel, p.quantity, held_out, p.per_score, p.own / p.count, p.size)
        for held_out, p in parts
        if p.count
    )


def _collect(
    rig: Rig,
    base: Baseline,
    case: Case,
    verdict: Verdict,
    trials: Sequence[Trial],
    screened: Screened,
    places: tuple[UnreliablePlace, ...] = (),
) -> tuple[Diagnosis, Rig]:
    """The diagnosis as data, and the rig that it ends with."""
    answer = verdict.named[0] if verdict.kind in ("named", "one_of", "partly") else None
    located = locate(base.problem, base.fitted, answer.fitted if answer else None)
    if verdict.kind == "nothing_missing":  # What is significant but too small to be seen is no place to look at.
        located = replace(located, windows=dict.fromkeys(located.windows, ()), phase=words.NOWHERE)
    named, alternatives = candidates_of(verdict, trials, case)
    became = fates(rig, verdict, trials, case, screened)
    fitted, predicted = (answer.fitted, answer.predicted) if answer else (base.fitted, base.there)
    series = plot_series(base.problem, base.fitted, fitted, held_out=False)
    fields = marker_fields(base.problem, base.fitted, fitted, held_out=False)
    if base.there is not None and predicted is not None:
        series += plot_series(base.check, base.there, predicted, held_out=True)
        fields += marker_fields(base.check, base.there, predicted, held_out=True)
    size = size_of(answer) if answer else 0.0
    numbers = [p for effect in named for p in effect.parameters]
    asks = verdict.kind in ("named", "one_of", "partly", "unknown")
    motion = proposed(rig, base.problem, base.fitted, numbers) if asks else None
    advice = [words.next_experiment(verdict, case), *([in_words(rig, motion, numbers)] if motion else [])]
    diagnosis = Diagnosis(
        verdict=verdict.kind,
        sentence=words.sentence(verdict, located, became, case, places),
        rig=rig.name,
        effects=named,
        alternatives=alternatives,
        located=located,
        baseline=_misfit(base, None),
        amended=_misfit(base, answer) if answer else None,
        noise_floor={c: float(np.median(n.sigma)) for c, n in base.noise.items()},
        discretisation={
            "structured_energy": case.before.whole.own,
            "structured_misfit": case.before.whole.excess,
            "structured_misfit_per_score": case.before.whole.per_score,
        },
        upper_limits=limits(screened, verdict),
        baseline_parameters=named_parameters(base.fitted),
        amended_parameters=named_parameters(fitted) if answer else (),
        not_explained=words.not_explained(verdict, case),
        next_experiment=" ".join(advice),
        provenance={},
        seconds=0.0,
        tried=became,
        notes=notes(base, case, verdict, trials),
        series=series,
        marker_fields=fields,
        explained=size,
        threshold=case.needed,
        places=places,
        next_motion=motion,
        structured=_structured(case),
        ledger=screened.screen.ledger(base.fitted),
    )
    return diagnosis, fitted.rig if base.reference is None else base.reference.fine(fitted.rig)
