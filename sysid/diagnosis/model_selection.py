"""From fits to a verdict: nothing missing, one effect named, one of several, or something unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.effects import Effect
from sysid.diagnosis.residual_analysis import Structure
from sysid.diagnosis.result import Candidate, NamedParameter
from sysid.solve.covariance import interval, uncertainty
from sysid.solve.optimum import Fitted

MIN_GAIN_NATS = 12.0
"""Evidence over the baseline that an effect must have to be named."""

MIN_SIGNIFICANCE = 3.0
"""Standard deviations that the improvement must be worth, judged by its stability over blocks of time: what a
smooth error of the simulator fakes is strong in evidence but not stable."""

TIE_NATS = 5.0
"""Effects within this of the best are reported together."""

MIN_EXPLAINED = 0.6
"""Share of the structured misfit that an answer must explain, unless what it leaves may be the discretisation
error; less leaves something unknown."""

ROBUST_WIDTH = 3.0
"""Whitened residual from which held-out samples count linearly, so that a few do not decide."""


@dataclass(frozen=True)
class Trial:
    """One effect refitted. ``gain``: log evidence over the baseline; ``explained``: share of the baseline's structured
    misfit; ``left``: what it leaves of it; ``held_out``: share of the robust misfit on held-out data that it removes
    (negative: it predicts worse). ``significance``: see :func:`significance`, infinite before the trial is
    ``finished``, fitted to the end; ``failure``: why it is no answer whatever its figures; ``predicted``: the finished
    trial on the held-out runs; ``misfits``: those of the baseline and of the finished trial on the runs given, and on
    what both see of those held out, beside the same discretisation error."""

    effect: Effect
    fitted: Fitted
    gain: float
    explained: float
    left: Structure
    held_out: float | None
    significance: float = np.inf
    finished: bool = False
    failure: str = ""
    predicted: Fitted | None = None
    misfits: tuple[tuple[float, float | None], tuple[float, float | None]] | None = None

    @property
    def rejected(self) -> str:
        """Why the effect is no answer; empty when it may be one."""
        if self.failure:
            return self.failure
        if self.gain < MIN_GAIN_NATS:
            return f"it improves the fit too little ({self.gain:.1f} of {MIN_GAIN_NATS:g} nats)"
        if self.held_out is not None and self.held_out <= 0.0:
            return f"it predicts held-out recordings worse, by {-100 * self.held_out:.2g} %"
        if self.significance < MIN_SIGNIFICANCE:
            return f"over time its improvement is worth {self.significance:.1f} of {MIN_SIGNIFICANCE:g} deviations"
        return ""


@dataclass(frozen=True)
class Verdict:
    """``kind`` as in :data:`sysid.diagnosis.result.VERDICTS`; ``named``: trials of the answer, best first."""

    kind: str
    named: tuple[Trial, ...]


def decide(trials: list[Trial], before: Structure, on_held_out: Structure | None = None) -> Verdict:
    """Choose the verdict. ``before``: structured misfit of the baseline, and on held-out recordings."""
    fit = sorted((t for t in trials if not t.rejected), key=lambda t: -t.gain)
    if not fit:
        missing = before.missing or (on_held_out is not None and on_held_out.missing)
        return Verdict("unknown" if missing else "nothing_missing", ())
    best = fit[0]
    if best.explained < MIN_EXPLAINED and best.left.missing:
        return Verdict("unknown", tuple(fit))
    ties = tuple(t for t in fit if best.gain - t.gain < TIE_NATS and t.explained > best.explained - 0.1)
    return Verdict("named" if len(ties) == 1 else "one_of", ties)


def held_out_gain(plain: np.ndarray, amended: np.ndarray) -> float:
    """Share of the robust misfit that an amendment removes, from whitened residuals ``(n,)`` of both.

    Loss: 2 w^2 (sqrt(1 + (r/w)^2) - 1) with w = :data:`ROBUST_WIDTH`, quadratic for noise, linear beyond.
    """

    def loss(r: np.ndarray) -> float:
        w = ROBUST_WIDTH
        return float(np.sum(2.0 * w * w * (np.sqrt(1.0 + (r / w) ** 2) - 1.0)))

    before = loss(plain)
    return (before - loss(amended)) / before


def significance(effect: Effect, fitted: Fitted, gain: float) -> float:
    """Standard deviations that a gain [nats] is worth: the square root of the likelihood ratio 2 gain, over
    the inflation of the best known amplitude by the sandwich estimate (the adjusted likelihood of Chandler &
    Bate 2007). The amplitude's own distance from none would not do: it is short where only its ratio to
    another parameter is determined."""
    known = uncertainty(fitted)
    amplitudes = {f"effects.{effect.name}.{q.name}" for q in effect.parameters if q.vanishing is not None}
    inflation = [f for p, f in zip(fitted.parameters, known.inflation, strict=True) if p.name in amplitudes]
    return float(np.sqrt(max(2.0 * gain, 0.0)) / min(inflation, default=1.0))


def probabilities(trials: list[Trial]) -> dict[str, float]:
    """Probability of each effect among all tried and the baseline, from the evidence."""
    gains = np.array([t.gain if not t.rejected else min(t.gain, 0.0) for t in trials] + [0.0])
    weights = np.exp(gains - gains.max())
    weights /= weights.sum()
    return {t.effect.name: float(w) for t, w in zip(trials, weights[:-1], strict=True)}


def candidate(trial: Trial, probability: float) -> Candidate:
    """A trial as it is reported."""
    return Candidate(
        trial.effect.name,
        trial.effect.title,
        trial.effect.slot,
        trial.effect.words,
        probability,
        named_parameters(trial.fitted, f"effects.{trial.effect.name}."),
        float(trial.gain),
        None if trial.held_out is None else float(trial.held_out),
        trial.rejected,
    )


def named_parameters(fitted: Fitted, prefix: str = "") -> tuple[NamedParameter, ...]:
    """Fitted values with intervals; only those whose name starts with ``prefix``."""
    known = uncertainty(fitted)
    return tuple(
        NamedParameter(p.name, p.physical(s), interval(p, s, sd), p.unit, p.words)
        for p, s, sd in zip(fitted.parameters, fitted.scaled, known.sd, strict=True)
        if p.name.startswith(prefix)
    )
