"""From screened and refitted sets of effects to a verdict.

An answer has to be significant against the null that is simulated for the case, to predict recordings it was not fitted
to, and to have size: it explains most of what the baseline leaves beyond noise, the discretisation error and what
careful models differ in. What is real but small beside what is left is said to be just that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.diagnosis.contradictions import Contradiction
from sysid.diagnosis.refits import Trial
from sysid.diagnosis.residual_analysis import Structure
from sysid.fit.result import ChannelError
from sysid.settings.diagnosis import DIAGNOSIS


@dataclass(frozen=True)
class Case:
    """What the verdict rests on beside the trials. ``before``, ``there``: structured misfit of the baseline, and on
    recordings held out (None without); ``threshold`` [nats]: of the simulated null; ``coarse``: quantities whose
    discretisation error is too large for the question, in words; ``faults``: of the recordings, in words;
    ``contradictions``: of the baseline and what the rig says; ``missed``: quantities that it misses by far where mesh
    and time step err by far, in words (:func:`missed_beside_mesh`)."""

    before: Structure
    there: Structure | None
    threshold: float
    coarse: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    contradictions: tuple[Contradiction, ...] = ()
    missed: tuple[str, ...] = ()

    @property
    def needed(self) -> float:
        """Evidence [nats] that a set of effects must have."""
        return max(DIAGNOSIS.least_gain_nats, self.threshold)

    @property
    def missing(self) -> bool:
        """The baseline leaves misfit that nothing known explains."""
        return self.before.missing or (self.there is not None and self.there.missing)


@dataclass(frozen=True)
class Verdict:
    """``kind``: as in :data:`sysid.diagnosis.result.VERDICTS`; ``named``: trials of the answer, best first."""

    kind: str
    named: tuple[Trial, ...]


def missed_beside_mesh(errors: Sequence[ChannelError]) -> tuple[str, ...]:
    """A sentence for each quantity that the baseline misses by ``DIAGNOSIS.missed_over_noise`` where mesh and time step
    err by ``DIAGNOSIS.mesh_over_noise`` of the noise, and by less than is missed, but not so much less that they cannot
    be the reason: that of the recording in which it misses most."""
    worst: dict[tuple[str, str], ChannelError] = {}
    for e in errors:
        known = worst.get((e.channel, e.quantity))
        if e.before > DIAGNOSIS.missed_over_noise * e.noise and (
            known is None or e.before / e.noise > known.before / known.noise
        ):
            worst[e.channel, e.quantity] = e
    return tuple(
        f"The rig misses the {e.quantity or 'picture'} of {e.channel} in {e.run} by {e.before / e.noise:.0f} times its "
        f"noise, more than the {e.own / e.noise:.0f} times by which mesh and time step are expected to err there, but "
        "not so much more that anything else is surely missing."
        for e in worst.values()
        if e.own > DIAGNOSIS.mesh_over_noise * e.noise
        and DIAGNOSIS.mesh_explains_ratio * e.own < e.before < DIAGNOSIS.mesh_may_explain_ratio * e.own
    )


def rejected(trial: Trial, case: Case) -> str:
    """Why a set of effects is no answer; empty when it may be one."""
    if trial.failure:
        return trial.failure
    if trial.gain < case.needed:
        return f"it improves the fit too little ({trial.gain:.1f} of {case.needed:.1f} nats)"
    if trial.held_out is not None and trial.held_out <= 0.0:
        return f"it predicts held-out recordings worse, by {-100 * trial.held_out:.2g} %"
    if trial.worse:
        return f"it predicts worse: {trial.worse}"
    if trial.change < DIAGNOSIS.least_size:
        return (
            f"it changes no reading by more than {trial.change:.2g} of what noise, mesh, time step and careful models "
            "leave open"
        )
    if trial.in_pose_noise:
        return f"{trial.in_pose_noise}, but within the noise of the recorded poses"
    if trial.idle:
        return f"beside its other effects it is not told from none {trial.idle}"
    if trial.significance < DIAGNOSIS.significance_sd:
        return (
            f"over time its improvement is worth {trial.significance:.1f} of {DIAGNOSIS.significance_sd:g} deviations"
        )
    if not case.missing:
        if trial.gain < DIAGNOSIS.threshold_factor_without_misfit * case.needed:
            return "without it the recordings are explained as well, as far as noise and careful models go"
        if case.there is None:
            return "no misfit stands out, and no recording is held out that could speak for it"
        if trial.predicts is not None and trial.predicts < case.needed:
            return (
                f"held-out recordings speak for it by only {trial.predicts:.1f} of {case.needed:.1f} nats, where the "
                "baseline shows no misfit that stands out"
            )
        if trial.confirmed and trial.surely_predicts is not None and trial.surely_predicts < DIAGNOSIS.steady_sd:
            return (
                f"held-out recordings speak for it by {trial.predicts or 0.0:.0f} nats, but by only "
                f"{trial.surely_predicts:.1f} of {DIAGNOSIS.steady_sd:g} deviations from one block of time to the next"
            )
    return ""


def decide(trials: Sequence[Trial], case: Case) -> Verdict:
    """Choose the verdict."""
    fit = answers(trials, case)
    if not fit:
        if case.faults:
            return Verdict("recording_fault", ())
        if case.missing:
            return Verdict("unknown", ())
        hidden = case.before.hidden or (case.there is not None and case.there.hidden)
        refine = hidden or case.coarse or case.missed
        return Verdict("refine_discretisation" if refine else "nothing_missing", ())
    best = fit[0]
    share = size_of(best)
    if best.left.missing and share < DIAGNOSIS.least_explained_share:
        return Verdict("partly" if share >= DIAGNOSIS.some_explained_share else "unknown", (best,))
    ties = tuple(
        t
        for t in fit
        if best.gain - t.gain < DIAGNOSIS.tie_nats
        and size_of(t) > share - DIAGNOSIS.tie_size_share
        and len(t.names) == len(best.names)
    )
    return Verdict("named" if len(ties) == 1 else "one_of", ties)


def answers(trials: Sequence[Trial], case: Case) -> list[Trial]:
    """The sets of effects that may be an answer, best first. One of several effects has to be better than each part of
    it that may be one, by evidence and in size."""
    fit = sorted((t for t in trials if not rejected(t, case)), key=lambda t: -t.gain)
    return [t for t in fit if not needless(t, fit, case)]


def needless(trial: Trial, others: Sequence[Trial], case: Case) -> str:
    """Why some of a set of effects, of which others that may be an answer have a part, are one too many; empty when
    they are not."""
    for part in (t for t in others if t.names < trial.names):
        more = " and that ".join(h.effect.title for h in trial.hypotheses if h.effect.name not in part.names)
        if trial.gain < part.gain + case.needed:
            return f"beside the knowledge that {part.title}, that {more} improves the fit too little"
        gone = _taken_away(part, trial)
        if gone < DIAGNOSIS.worth_adding_share:
            return (
                f"that {more} takes away {max(0.0, 100 * gone):.0f} % of the misfit that is left with the knowledge "
                f"that {part.title}"
            )
    return ""


def _taken_away(part: Trial, whole: Trial) -> float:
    """Share of the structured misfit that a set of effects leaves which a larger set takes away, on the recordings
    given or those held out, whichever is more; 0 where it leaves none."""
    pairs = [(part.left, whole.left), (part.left_there, whole.left_there)]
    return max(
        (1.0 - b.whole.excess / a.whole.excess for a, b in pairs if a is not None and b is not None and a.missing),
        default=0.0,
    )


def cut_off(trials: Sequence[Trial], verdict: Verdict, case: Case) -> list[Trial]:
    """Where the verdict is that something unknown is missing, the set of effects with most evidence, if there is enough
    of it and its refit was cut off before it converged."""
    if verdict.kind != "unknown" or verdict.named:
        return []
    best = max((t for t in trials if not t.failure), key=lambda t: t.gain, default=None)
    if best is None or best.confirmed or best.fitted.converged or best.gain < case.needed:
        return []
    return [best]


def size_of(trial: Trial) -> float:
    """Share of the structured misfit that is gone, the smaller of that on the recordings given and held out."""
    return min(trial.explained, 1.0 if trial.explained_there is None else trial.explained_there)


def probabilities(trials: Sequence[Trial], case: Case) -> dict[frozenset[str], float]:
    """Probability of each set among all that were refitted and the baseline, from the evidence."""
    gains = np.array([min(t.gain, 0.0) if rejected(t, case) else t.gain for t in trials] + [0.0])
    weights = np.exp(gains - gains.max())
    weights /= weights.sum()
    return {t.names: float(w) for t, w in zip(trials, weights[:-1], strict=True)}
