"""The diagnosis of a rig against recordings: the function behind ``thinshell diagnose``.

1. The baseline is fitted through the pipeline of fits (:mod:`sysid.diagnosis.baseline`).
2. All effects are looked at where it is linearised, with one rollout a recording (:mod:`sysid.diagnosis.look`).
3. Sets of effects are fitted, best first, until those that are hold nearly all of the probability
   (:mod:`sysid.diagnosis.search`).
4. The verdict is what the posterior says (:mod:`sysid.diagnosis.verdict`).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sim_core.rigs import Rig
from sysid.comparison.ledger import Ledger
from sysid.comparison.posterior import Posterior, temper_of
from sysid.diagnosis import wording as words
from sysid.diagnosis.baseline import Baseline, fit_baseline
from sysid.diagnosis.candidates import drawn_shapes, recording_scales
from sysid.diagnosis.fitted_sets import FittedSet, SetFits
from sysid.diagnosis.next_motion import in_words, proposed
from sysid.diagnosis.report_notes import candidates_of, is_in_answer, limits, named_parameters, notes, outcome_by_effect
from sysid.diagnosis.residual_analysis import locate
from sysid.diagnosis.result import Diagnosis, Misfit, UnreliablePlace, missed_multiples
from sysid.diagnosis.search import leaves_misfit, ledger_with, searched
from sysid.diagnosis.unfinished import unfinished
from sysid.diagnosis.validation import beyond_noise, misfit_of, worst_quantity
from sysid.diagnosis.verdict import WHERE, Verdict, hidden_by_mesh, verdict_of
from sysid.fit.marker_field import marker_fields
from sysid.fit.result import plot_series
from sysid.io.checkpoints import Checkpoints
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.provenance import provenance
from sysid.observations.observations import Run, check_apart
from sysid.progress.callback import Progress
from sysid.progress.interrupts import on_interrupt
from sysid.progress.work import Work, work_of
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.settings.progress import PROGRESS
from sysid.settings.uncertainty import UNCERTAINTY
from sysid.solve.interruption import interrupts_ignored
from sysid.uncertainty.goodness_of_fit import no_success


def diagnose_runs(
    rig: Rig,
    runs: Sequence[Run],
    held_out: Sequence[Run] = (),
    *,
    on_progress: Progress | Work | None = None,
    kept: Checkpoints | None = None,
    on_known: Callable[[Diagnosis], None] | None = None,
) -> tuple[Diagnosis, Rig]:
    """Diagnose; the second value is the rig with the answer in it (the fitted baseline when none). Where no run is held
    out, the last of three or more is: what an effect predicts tells it from what follows noise and mesh.

    ``kept``: holds the stages that are done, by which an interrupted diagnosis goes on; ``on_known``: takes what is
    known where the baseline is fitted, where all effects have been looked at, and where Ctrl-C ends it. Raises
    ``RecordingError`` where two runs have readings in common, and ``KeyboardInterrupt``."""
    check_apart(runs, held_out)
    said: tuple[str, ...] = ()
    if not held_out and len(runs) >= DIAGNOSIS.hold_out_from:
        runs, held_out = runs[:-1], runs[-1:]
        said = (f"{held_out[0].name} was held out, to see what effects predict, since no recording was.",)
    started = time.monotonic()
    work = _work(on_progress, len(runs) + len(held_out))
    with ParallelPredictor(os.cpu_count(), costs=work.costs) as engine, on_interrupt(engine.end):
        fits, fitted, found = _searched(engine, rig, runs, held_out, work, kept or Checkpoints(), on_known)
        work.enter("report")
        ledger = replace(ledger_with(fitted), provenance=provenance(rig, list(runs), list(held_out)))
        diagnosis, amended = _collect(rig, fits.base, fits, fitted, found, ledger)
    diagnosis.notes = (*said, *diagnosis.notes)
    diagnosis.parted = {run.name: run.parted for run in (*runs, *held_out) if run.parted}
    diagnosis.seconds = time.monotonic() - started
    if work is not on_progress:
        work.done()
    return diagnosis, amended


def _work(on_progress: Progress | Work | None, recordings: int) -> Work:
    return work_of(on_progress, PROGRESS.diagnosis_rollouts, PROGRESS.diagnosis_between_s, recordings)


def _searched(
    engine: ParallelPredictor,
    rig: Rig,
    runs: Sequence[Run],
    held_out: Sequence[Run],
    work: Work,
    kept: Checkpoints,
    on_known: Callable[[Diagnosis], None] | None,
) -> tuple[SetFits, list[FittedSet], Posterior]:
    """The fits, the sets that were fitted, and the posterior."""
    kept.live("engine", engine)
    more = ""

    def know(base: Baseline, fitted: Sequence[FittedSet]) -> None:
        if on_known is not None:
            on_known(unfinished(base, fitted, provenance(rig, list(runs), list(held_out))))

    while True:
        work.enter("baseline", f"first simulations{more}")
        base = kept.stage("baseline", partial(fit_baseline, engine, rig, runs, held_out, work.say), _steps(runs))
        know(base, ())
        work.enter("effects", f"a look at all effects{more}")
        fits = SetFits(base, recording_scales([*base.problem.runs, *base.check.runs]), kept=kept)
        know(fits.base, [fits.baseline])
        work.enter("sets of effects")
        try:
            fitted, posterior, others = searched(fits, work.say)
        except KeyboardInterrupt:
            with interrupts_ignored():
                know(fits.base, fits.done)
            raise
        if posterior is not None:
            return fits, fitted, posterior
        runs, more = others, ", with shorter time steps"


def _steps(runs: Sequence[Run]) -> list[object]:
    """What a search may change in recordings that it is given: the time steps."""
    return [(run.name, run.steps) for run in runs]


def ledger_of(
    rig: Rig,
    runs: Sequence[Run],
    held_out: Sequence[Run] = (),
    *,
    shapes: np.random.Generator | None = None,
    on_progress: Progress | None = None,
) -> Ledger:
    """The ledger of a diagnosis: its baseline and its look at all effects, without a fit of one. ``shapes``: draws
    shapes of effects that no diagnosis looks at, of which it then has columns too."""
    rollouts = {name: PROGRESS.diagnosis_rollouts[name] for name in ("baseline", "effects")}
    work = work_of(on_progress, rollouts, PROGRESS.diagnosis_between_s, len(runs) + len(held_out))
    with ParallelPredictor(os.cpu_count(), costs=work.costs) as engine:
        work.enter("baseline", "first simulations")
        base = fit_baseline(engine, rig, runs, held_out, work.say)
        work.enter("effects", "a look at all effects")
        scales = recording_scales([*base.problem.runs, *base.check.runs])
        drawn = [] if shapes is None else drawn_shapes(base.fitted.rig, scales, shapes)
        ledger = SetFits(base, scales, drawn).baseline.ledger
    return replace(ledger, provenance=provenance(rig, list(runs), list(held_out)))


def _missed_there(base: Baseline, before: Misfit) -> str:
    """That recordings held out are missed by far by a baseline that was not fitted to them, given all that it leaves
    open of them; else empty."""
    if base.there is None or base.there.misfit <= UNCERTAINTY.failed_noise_multiple**2:
        return ""
    return no_success(missed_multiples(before.errors, True), ())


def _left_open(base: Baseline, before: Misfit) -> tuple[str, ...]:
    """That recordings held out are missed by far, and no further than the recordings given leave open, as where a strip
    may snap to either side; else nothing."""
    far = {w: n for w, n in missed_multiples(before.errors, True).items() if n > UNCERTAINTY.failed_noise_multiple}
    if base.there is None or not far or _missed_there(base, before):
        return ()
    worst = max(far, key=lambda w: far[w])
    return (
        f"Recordings held out are missed by up to {far[worst]:.3g} times the noise, in {worst}. Numbers that the "
        "recordings given cannot tell from the fitted ones predict as different readings there (a snap to the other "
        "side, say), so that this tells nothing for or against the model.",
    )


def _judged(base: Baseline, fitted: Sequence[FittedSet], found: Posterior, ledger: Ledger, missed: bool) -> Verdict:
    """The verdict, with what the recordings themselves and the mesh have to say to it. ``missed``: the baseline misses
    recordings held out by far."""
    verdict = verdict_of(found)
    if verdict.kind == "nothing_missing":
        faulty = any(o.kept for o in base.outliers)
        return replace(verdict, kind="recording_fault" if faulty else "unknown" if missed else "nothing_missing")
    if hidden_by_mesh(ledger):
        return replace(verdict, kind="refine_discretisation")
    if verdict.kind not in ("named", "one_of"):
        return verdict
    if not any(is_in_answer(one, verdict) for one in fitted):
        return replace(verdict, kind="unknown")
    if leaves_misfit(ledger):
        return replace(verdict, kind="partly")
    return verdict


def _collect(
    rig: Rig, base: Baseline, fits: SetFits, fitted: Sequence[FittedSet], found: Posterior, ledger: Ledger
) -> tuple[Diagnosis, Rig]:
    """The diagnosis as data, and the rig that it ends with."""
    before = misfit_of(base, base.fitted, base.there)
    missed = _missed_there(base, before)
    verdict = _judged(base, fitted, found, ledger, bool(missed))
    asks = verdict.kind in ("named", "one_of", "partly", "unknown")
    chances = {m.effects: m.probability for m in found.models}
    chosen = sorted((one for one in fitted if is_in_answer(one, verdict)), key=lambda one: -chances.get(one.names, 0.0))
    answer = chosen[0] if chosen and verdict.kind in ("named", "one_of", "partly") else None
    located = locate(base.problem, base.fitted, answer.fitted if answer else None)
    if verdict.kind == "nothing_missing":
        located = replace(located, windows=dict.fromkeys(located.windows, ()), phase=words.NOWHERE)
    model, there = (answer.fitted, answer.there) if answer else (base.fitted, base.there)
    after = misfit_of(base, answer.fitted, answer.there) if answer else None
    named, alternatives = candidates_of(base, fitted, found, verdict)
    if answer is None:
        named, alternatives = (), (*named, *alternatives)
    series = plot_series(base.problem, base.fitted, model, held_out=False)
    fields = marker_fields(base.problem, base.fitted, model, held_out=False)
    if base.there is not None and there is not None:
        series += plot_series(base.check, base.there, there, held_out=True)
        fields += marker_fields(base.check, base.there, there, held_out=True)
    numbers = [p for effect in named for p in effect.parameters]
    motion = proposed(rig, base.problem, base.fitted, numbers) if asks else None
    advice = [words.next_experiment(verdict), *([in_words(rig, motion, numbers)] if motion else [])]
    explained = beyond_noise(base.fitted, answer.fitted) if answer else 0.0
    became = outcome_by_effect(rig, verdict, fits.failed)
    faults = [o.sentence for o in base.outliers if o.kept]
    diagnosis = Diagnosis(
        verdict=verdict.kind,
        sentence=words.sentence(verdict, located, explained, len(became), missed, faults),
        rig=rig.name,
        effects=named,
        alternatives=alternatives,
        located=located,
        baseline=before,
        amended=after,
        noise_floor={c: float(np.median(n.sigma)) for c, n in base.noise.items()},
        upper_limits=limits(fits.baseline, temper_of(ledger), verdict.answer),
        baseline_parameters=named_parameters(base.fitted),
        amended_parameters=named_parameters(answer.fitted) if answer else (),
        not_explained=words.not_explained(verdict, worst_quantity(after or before)),
        next_experiment=" ".join(advice),
        provenance=dict(ledger.provenance),
        seconds=0.0,
        tried=became,
        notes=(*notes(base, chosen), *_left_open(base, before)),
        series=series,
        marker_fields=fields,
        explained=explained,
        places=_places(verdict) if asks else (),
        next_motion=motion,
        ledger=ledger,
        posterior=verdict,
    )
    if diagnosis.no_success and verdict.kind in ("named", "one_of"):
        diagnosis.verdict = "partly"
    return diagnosis, model.rig if base.reference is None else base.reference.fine(model.rig)


def _places(verdict: Verdict) -> tuple[UnreliablePlace, ...]:
    """Where something is missing, where that is not surely an effect of the library."""
    return tuple(
        UnreliablePlace(place, f"something is missing {WHERE.get(place, place)}", float(min(p, 1.0)))
        for place, p in verdict.places.items()
        if p >= 0.01
    )
