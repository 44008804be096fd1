"""A look at all effects at once: one rollout a recording, then dense linear algebra.

The responses of the readings to every hypothesis (:meth:`sysid.model.predictor.SerialPredictor.predict_responses`) are
whitened, and freed of the discretisation error and of what models may be off, together with the residual and its
derivatives by the baseline's parameters and nuisances. What is left of a recording is its Gram matrix. With the
whitened rows A = [J D] of a recording, the residual r and the weight 1 / kappa of the data,

    Phi(theta, a) = (|r + J theta + D a|^2) / kappa + |W (theta - theta_0)|^2 + |a / s|^2

is minimised over the baseline's parameters theta and the factors a of any set of hypotheses, within their bounds, from
a few hundred numbers. The evidence of a set over the baseline
is that of Laplace,

    log E = (Phi_0 - Phi) / 2 - log det(1 + S^(1/2) D^T M D S^(1/2) / kappa) / 2,

with M the projection that the baseline's parameters leave and S = diag(s^2).

What level a statistic reaches by chance is not looked up but simulated for the very case: noise of the whitened
recordings, alone and on a twin whose discretisation error is all or none of the expected one, runs through the same
search a few hundred times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.optimize import lsq_linear

from sysid.comparison import ledger
from sysid.diagnosis.candidates import Hypothesis
from sysid.diagnosis.closures import Closures
from sysid.diagnosis.ledger_rows import Free, free_of, rows_of
from sysid.diagnosis.slots import place_of
from sysid.discretisation.approximations import Approximations
from sysid.model.prediction_source import Responding
from sysid.model.predictor import Prediction
from sysid.observations.observations import Measured
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


@dataclass(frozen=True)
class Block:
    """One recording. ``gram`` ``(c + 1, c + 1)``: of the columns, with the residual as the last one; ``twin``
    ``(c + 1,)``: products with the discretisation error that is left."""

    run: str
    gram: np.ndarray
    twin: np.ndarray


@dataclass(frozen=True)
class Score:
    """A set of hypotheses. ``numbers``: of the hypotheses; ``gain`` [nats]: evidence over the baseline; ``fall``: of
    chi-square; ``factors``: of the amplitudes, hypothesis by hypothesis; ``shift`` ``(p,)``: of the baseline's
    parameters."""

    numbers: tuple[int, ...]
    gain: float
    fall: float
    factors: tuple[np.ndarray, ...]
    shift: np.ndarray


class Screen:
    """Gram matrices of all recordings with what is known beforehand.

    ``hypotheses``: those that could be simulated; ``blocks``: of the recordings; ``free``: what the ledger has beside
    them.
    """

    def __init__(
        self, base: Fitted, hypotheses: Sequence[Hypothesis], blocks: list[Block], free: Free | None = None
    ) -> None:
        self.hypotheses, self.free = list(hypotheses), free
        self.blocks = blocks
        self.shared = len(base.parameters)
        ends = self.shared + np.cumsum([0, *(len(h.amplitudes) for h in hypotheses)])
        self.places = [np.arange(a, b) for a, b in pairwise(ends)]
        self._columns = int(ends[-1])
        width = np.array([p.known_sd or p.prior_sd for p in base.parameters])
        pulls = base.residual[len(base.residual) - base.pulls :]
        amplitudes = [a for h in hypotheses for a in h.amplitudes]
        self._sd = np.concatenate([width, [a.sd for a in amplitudes]])
        self._at = np.concatenate([pulls if base.pulls else np.zeros(self.shared), np.zeros(len(amplitudes))])
        reach = np.array([p.scaled_bounds for p in base.parameters]).reshape(-1, 2) - base.scaled[:, None]
        self._limits = np.vstack([reach, np.array([a.limits for a in amplitudes]).reshape(-1, 2)])
        self._limits[:, 0] = np.minimum(self._limits[:, 0], -1e-12)
        self._limits[:, 1] = np.maximum(self._limits[:, 1], 1e-12)
        self.kappa = 1.0

    @cached_property
    def whole(self) -> np.ndarray:
        """Sum of the Gram matrices of the recordings given."""
        return np.asarray(np.sum([b.gram for b in self.blocks], axis=0))

    def temper(self, kappa: float) -> None:
        """Weigh the data by 1 / kappa: what the best model leaves of the misfit, over noise."""
        self.kappa = max(1.0, kappa)

    def ledger(self, base: Fitted) -> ledger.Ledger:
        """What all this follows from, with closures and approximations, as a value that is written to a file."""
        assert self.free is not None
        starts = base.scaled - self._at[: self.shared] * self._sd[: self.shared]
        columns = [
            ledger.Column(
                "parameter", p.name, "", "", {}, p.name, p.unit, float(at), 1.0, p.log, float(start - at), float(sd),
                False, *(float(v) for v in limits),
            )
            for p, at, start, sd, limits in zip(
                base.parameters, base.scaled, starts, self._sd, self._limits, strict=False
            )
        ]  # fmt: skip
        for h in self.hypotheses:
            # Sizes that are looked at apart are shapes as well, of laws that are not linear in them.
            alike = [x for x in self.hypotheses if (x.effect, x.shape) == (h.effect, h.shape)]
            sizes = {a.parameter.name: a.typical for a in h.amplitudes} if len(alike) > 1 else {}
            label = ", ".join([h.key, *(f"{name} {value:.4g}" for name, value in {**h.shape, **sizes}.items())])
            for a in h.amplitudes:
                # An amplitude that vanishes at infinity has one value, and its factor says how much of its response.
                at, scale = (a.none, a.typical - a.none) if np.isfinite(a.none) else (a.typical, 0.0)
                low, high = a.limits
                columns.append(
                    ledger.Column(
                        "concealed" if h.drawn else "effect", h.effect.name, place_of(h.effect), label, dict(h.shape),
                        a.parameter.name, a.parameter.unit, float(at), float(scale), False, 0.0, float(a.sd),
                        low >= 0.0, float(low), float(high),
                    )
                )  # fmt: skip
        return ledger.Ledger((*columns, *self.free.columns), self.free.blocks, {})

    def score(self, numbers: Sequence[int]) -> Score:
        """A set of hypotheses."""
        chosen = tuple(numbers)
        plain, alone = self._minimum((), self.whole)
        value, found = self._minimum(chosen, self.whole)
        factors = tuple(np.split(found[self.shared :], np.cumsum([len(self.places[k]) for k in chosen])[:-1]))
        fall = self._chi2((), alone) - self._chi2(chosen, found)
        return Score(chosen, 0.5 * (plain - value) - self._occam(chosen), fall, factors, found[: self.shared])

    def singles(self) -> list[Score]:
        """All hypotheses by themselves, best first."""
        found = [self.score([k]) for k in range(len(self.hypotheses))]
        return sorted(found, key=lambda s: -s.gain)

    def by_recording(self) -> list[Score]:
        """All hypotheses with factors of their own in each recording, best first: the gains of recordings in which they
        have any, summed, with the factors of the recording that they explain best.

        A response is exact to first order on the path only. In a recording near a resonance, or where contact changes,
        it is not, and would forbid in all others what it gets wrong there.
        """
        found = []
        plain = [self._minimum((), b.gram)[0] for b in self.blocks]
        for k in range(len(self.hypotheses)):
            occam = self._occam((k,))
            gains, ends = [], []
            for block, before in zip(self.blocks, plain, strict=True):
                value, end = self._minimum((k,), block.gram)
                gains.append(0.5 * (before - value) - occam)
                ends.append(end)
            best = ends[int(np.argmax(gains))]
            gain = sum(max(g, 0.0) for g in gains)
            found.append(Score((k,), gain, 0.0, (best[self.shared :],), np.zeros(self.shared)))
        return sorted(found, key=lambda s: -s.gain)

    def threshold(self, seed: int = 0) -> float:
        """Evidence [nats] that the best hypothesis reaches with the probability ``DIAGNOSIS.false_alarm_probability``
        where nothing is missing; of all twins the largest."""
        rng = np.random.default_rng(seed)
        c = self._columns
        root = [_root(b.gram[:c, :c]) for b in self.blocks]
        weight = np.sqrt(self.kappa)
        tops: list[float] = []
        maps = [self._gain_map((k,)) for k in range(len(self.hypotheses))]
        for twin in DIAGNOSIS.twin_errors:
            fixed = twin * np.sum([b.twin[:c] for b in self.blocks], axis=0)
            slopes = fixed + weight * sum(rng.standard_normal((DIAGNOSIS.null_draws, r.shape[1])) @ r.T for r in root)
            best = np.full(DIAGNOSIS.null_draws, -np.inf)
            for project, inverse, occam in maps:
                g = slopes @ project
                best = np.maximum(best, 0.5 * np.einsum("ni,ij,nj->n", g, inverse, g) - occam)
            tops.append(float(np.quantile(best, 1.0 - DIAGNOSIS.false_alarm_probability)))
        return max(tops, default=0.0)

    def deviations(self, number: int) -> np.ndarray:
        """Standard deviations of the factors of one hypothesis beside the baseline's parameters ``(k,)``."""
        return np.asarray(np.sqrt(np.diag(self._gain_map((number,))[1])))

    # Linear algebra

    def _index(self, chosen: Sequence[int]) -> np.ndarray:
        return np.concatenate([np.arange(self.shared), *(self.places[k] for k in chosen)]).astype(int)

    def _minimum(self, chosen: Sequence[int], gram: np.ndarray) -> tuple[float, np.ndarray]:
        """Least Phi, and where."""
        index = self._index(chosen)
        prior = 1.0 / self._sd[index]
        whole = np.append(index, gram.shape[0] - 1)
        quadratic = gram[np.ix_(whole, whole)] / self.kappa
        n = len(index)
        quadratic[np.arange(n), np.arange(n)] += prior**2
        quadratic[:n, n] += prior * self._at[index]
        quadratic[n, :n] += prior * self._at[index]
        quadratic[n, n] += float(self._at[index] @ self._at[index])
        scale = np.sqrt(np.maximum(np.diag(quadratic), 1e-300))
        upper = _root(quadratic / np.outer(scale, scale)).T
        a, b = upper[:, :n] * scale[:n], -upper[:, n] * scale[n]
        low, high = self._limits[index].T
        spread = scale[:n]
        step = lsq_linear(a / spread, b, bounds=(low * spread, high * spread), method="bvls" if n < 60 else "trf")
        return 2.0 * float(step.cost), np.asarray(step.x / spread)

    def _chi2(self, chosen: Sequence[int], found: np.ndarray) -> float:
        whole = np.append(self._index(chosen), self.whole.shape[0] - 1)
        vector = np.append(found, 1.0)
        return float(vector @ self.whole[np.ix_(whole, whole)] @ vector)

    def _occam(self, chosen: Sequence[int]) -> float:
        return self._gain_map(chosen)[2] if chosen else 0.0

    def _gain_map(self, chosen: Sequence[int]) -> tuple[np.ndarray, np.ndarray, float]:
        """From slopes of all columns ``(c,)`` to those of the factors beside the baseline's parameters, ``(c, k)``, the
        inverse of their information ``(k, k)``, and what the evidence pays for them."""
        mine = np.concatenate([self.places[k] for k in chosen]).astype(int)
        base = np.arange(self.shared)
        gram = self.whole / self.kappa
        inner = gram[np.ix_(base, base)] + np.diag(1.0 / self._sd[base] ** 2)
        cross = gram[np.ix_(base, mine)]
        solved = np.linalg.solve(inner, cross) if self.shared else np.zeros((0, len(mine)))
        information = gram[np.ix_(mine, mine)] - cross.T @ solved
        project = np.zeros((self._columns, len(mine)))
        project[mine, np.arange(len(mine))] = 1.0
        project[base] -= solved
        sd = self._sd[mine]
        occam = 0.5 * float(np.linalg.slogdet(np.eye(len(mine)) + sd[:, None] * information * sd)[1])
        inverse = np.linalg.inv(information + np.diag(1.0 / sd**2))
        return project / self.kappa, inverse, occam


def _root(matrix: np.ndarray) -> np.ndarray:
    """R with R R^T = matrix, positive semidefinite but for round-off."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def look(
    engine: Responding,
    base: Fitted,
    problem: Problem,
    wanted: Sequence[Hypothesis],
    closures: Closures | None = None,
    approximations: Approximations | None = None,
) -> tuple[Screen, dict[str, str]]:
    """Screen hypotheses beside a fitted baseline on the recordings of a problem; and why some could not be.
    ``closures``, ``approximations``: those that the ledger is to have columns of; there is none without the latter."""
    sized = [column for h in wanted for column in h.columns()]
    at = (base.parameters, base.scaled)
    motions = [[] if approximations is None else approximations.open_motions(i, r) for i, r in enumerate(problem.runs)]
    if sized or closures is not None:
        free = [[] if closures is None else closures.modulated(run) for run in problem.runs]
        jobs = [
            engine.submit_responses(base.rig, run, *at, sized, [*moved, *mine])
            for run, moved, mine in zip(problem.runs, motions, free, strict=True)
        ]
    else:
        jobs = [engine.submit_with_derivatives(base.rig, run, *at) for run in problem.runs]
    found = [job.result() for job in jobs]
    shared = len(base.parameters)
    ends = shared + len(sized)
    bad = np.zeros(len(sized), dtype=bool)
    for prediction in found:
        for derivatives in prediction.derivatives.values():
            lost = ~np.isfinite(derivatives[..., shared:ends])
            seen = np.isfinite(derivatives[..., :shared]).all(axis=-1) if shared else np.ones(lost.shape[:-1], bool)
            bad |= (lost & seen[..., None]).any(axis=(0, 1))
    owner = np.repeat(np.arange(len(wanted)), [len(h.amplitudes) for h in wanted])
    broken = set(owner[bad])
    kept = [h for k, h in enumerate(wanted) if k not in broken]
    own = [*range(shared), *(shared + k for k in range(len(sized)) if owner[k] not in broken)]
    names = {h.effect.name for h in kept}
    failed = {h.effect.name: "could not be simulated" for k, h in enumerate(wanted) if k in broken}
    screen = Screen(base, kept, _blocks(problem, base, found, np.array(own, dtype=int)))
    if approximations is not None:
        drawn, columns = max(map(len, motions)), []
        if closures is not None:
            found = [closures.append(run, p) for run, p in zip(problem.runs, found, strict=True)]
            columns = closures.columns
        index = np.array([*own, *range(ends + drawn, ends + drawn + len(columns))], dtype=int)
        draws = np.arange(ends, ends + drawn)
        screen.free = free_of(problem, base, found, index, draws, columns, approximations)
        failed |= approximations.failed
    return screen, {n: why for n, why in failed.items() if n not in names}


def _blocks(problem: Problem, base: Fitted, predictions: Sequence[Prediction], own: np.ndarray) -> list[Block]:
    """Gram matrices of the recordings of a problem. ``own``: of the derivatives that are wanted."""
    error = [{m.channel: _twice_expected(problem, i, m) for m in run.measured} for i, run in enumerate(problem.runs)]
    blocks = []
    for run, r in zip(problem.runs, rows_of(problem, base, predictions, own, error), strict=True):
        table = np.column_stack([r.jacobian[:, : len(own)], r.residual])
        blocks.append(Block(run.name, table.T @ table, table.T @ r.jacobian[:, -1]))
    return blocks


def _twice_expected(problem: Problem, index: int, measured: Measured) -> np.ndarray:
    """The discretisation error of a channel ``(n, m, 1)``: twice what is expected of it, which may be none."""
    if not problem.error_shapes:
        return np.zeros((*measured.values.shape, 1))
    return 2.0 * problem.basis(index, measured).expected[..., None]
