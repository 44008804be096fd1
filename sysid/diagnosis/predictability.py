"""Where the physics itself is unpredictable, nothing is asked: landings, snaps, stick-slip, buckling to either side.

A few rollouts at parameters within what the recordings leave of them are compared with what the derivatives of the
fitted model foresee,

    e_m(t) = y(theta_m) - y(theta) - J (theta_m - theta).

The change that a finer mesh or a shorter step makes counts as well, where it is an event: what is left of it beside its
running median. Where the largest of these, rms over the columns of a quantity, is above both the noise and a share of
the signal, two simulations that nobody could tell apart do not agree, and no recording can say which is right. These
spans are named, and no channel of the recording weighs anything in them: where markers show that a strip may have
snapped to another state, its force is that of another state as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from sim_core.errors import ThinshellError
from sysid.diagnosis.model_tolerance import deformation
from sysid.model.parameters import rig_at, rig_in
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import column_groups
from sysid.observations.observations import Measured, Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.covariance import uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


@dataclass(frozen=True)
class Unpredictable:
    """Spans [s] of one run."""

    run: str
    spans: tuple[tuple[float, float], ...]

    @property
    def sentence(self) -> str:
        """In words."""
        shown = ", ".join(f"{a:.2f} to {b:.2f} s" for a, b in self.spans[:4]) + (", ..." if len(self.spans) > 4 else "")
        return (
            f"{self.run}: readings from {shown} are unpredictable: simulations that nobody can tell apart differ there "
            "(a snap, a landing, stick and slip). They weigh nothing."
        )


def unpredictable(
    engine: AnyEngine,
    runs: Sequence[Run],
    model: Fitted,
    noise: dict[str, ChannelNoise],
    derived: Sequence[Prediction],
    refined: Sequence[Mapping[str, Sequence[np.ndarray]]] = (),
) -> list[Unpredictable]:
    """Spans in which an ensemble about a fitted model disagrees. ``derived``: predictions of the runs by the model,
    with derivatives by its parameters; ``refined``: by run and channel, what refinements change ``(n, m)``."""
    points = members_of(model)
    pending = [
        [engine.submit(rig_in(model.centre, model.parameters, at, run.name), run) for run in runs] for at in points
    ]
    apart: list[dict[str, np.ndarray]] = [{m.channel: np.zeros(m.values.shape) for m in run.measured} for run in runs]
    for k, (run, changes) in enumerate(zip(runs, refined, strict=False)):
        for m in run.measured:
            for shape in changes.get(m.channel, ()):
                apart[k][m.channel] = np.maximum(apart[k][m.channel], np.abs(_events(m.t, shape)))
    for at, jobs in zip(points, pending, strict=True):
        for k, (run, job) in enumerate(zip(runs, jobs, strict=True)):
            try:
                member = job.result()
            except ThinshellError:
                continue
            for m in run.measured:
                foreseen = derived[k].values[m.channel] + derived[k].derivatives[m.channel] @ (at - model.scaled)
                away = np.abs(np.nan_to_num(member.values[m.channel] - foreseen))
                apart[k][m.channel] = np.maximum(apart[k][m.channel], away)
    after = DIAGNOSIS.ringing_s if model.rig.solver.inertia else DIAGNOSIS.event_margin_s
    found = []
    for k, run in enumerate(runs):
        spans: list[tuple[float, float]] = []
        for m in run.measured:
            mask = _mask(m, apart[k][m.channel], derived[k].values[m.channel], noise[m.channel], after)
            if mask.mean() <= DIAGNOSIS.most_unpredictable_share:
                spans += _spans(m.t, mask)
        if spans:
            found.append(Unpredictable(run.name, _joined(spans)))
    return found


def _joined(spans: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Spans as few as they are without overlaps, in order."""
    found: list[tuple[float, float]] = []
    for a, b in sorted(spans):
        if found and a <= found[-1][1]:
            found[-1] = (found[-1][0], max(b, found[-1][1]))
        else:
            found.append((a, b))
    return tuple(found)


def members_of(model: Fitted) -> list[np.ndarray]:
    """Scaled values ``(p,)`` of the ensemble. What is hardly known by itself, as the place of a ball and its turn about
    a point of it are, goes together as the recordings say: only so can nobody tell the members apart."""
    rng = np.random.default_rng(0)
    found = uncertainty(model)
    least = np.array([DIAGNOSIS.ensemble_least_sd.get(p.target.rsplit(".", 1)[1], 0.0) for p in model.parameters])
    known = np.array([p.known_sd or p.prior_sd for p in model.parameters])
    sd = np.minimum(found.sd, known)
    further = np.sqrt(np.maximum(np.minimum(least, known) ** 2 - sd**2, 0.0))
    values, vectors = np.linalg.eigh(found.correlation)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    limits = np.array([p.scaled_bounds for p in model.parameters]).reshape(-1, 2).T
    together, alone = rng.choice([-1.0, 1.0], size=(2, DIAGNOSIS.ensemble_members // 2, len(sd)))
    steps = [DIAGNOSIS.ensemble_sd * (sd * (root @ a) + further * b) for a, b in zip(together, alone, strict=True)]
    return [np.clip(model.scaled + sign * step, *limits) for step in steps for sign in (1.0, -1.0)]


def _events(t: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """What is left of a course ``(n, m)`` beside its running median over ``DIAGNOSIS.event_s``."""
    if len(t) < 3:
        return 0.0 * shape
    width = max(3, 2 * int(0.5 * DIAGNOSIS.event_s / float(np.median(np.diff(t)))) + 1)
    return np.asarray(shape - median_filter(shape, size=(width, 1), mode="nearest"))


def _mask(measured: Measured, apart: np.ndarray, values: np.ndarray, noise: ChannelNoise, rings_s: float) -> np.ndarray:
    """Which instants of a channel are unpredictable ``(n,)``, those shortly before and after such ones with them."""
    signal = np.abs(deformation(measured, values))
    mask = np.zeros(len(measured.t), dtype=bool)
    for group in column_groups(measured):
        seen = group[np.isfinite(measured.values[:, group]).any(axis=0)]
        if not len(seen):
            continue
        rms = np.sqrt(np.mean(apart[:, seen] ** 2, axis=1))
        largest = float(np.sqrt(np.mean(signal[:, seen] ** 2, axis=1)).max(initial=0.0))
        mask |= rms > max(
            DIAGNOSIS.unpredictable_over_noise * float(np.median(noise.sigma[seen])),
            DIAGNOSIS.unpredictable_signal_share * largest,
        )
    times = measured.t[mask]
    if not len(times):
        return mask
    since = measured.t[:, None] - times
    return np.asarray(((since >= -DIAGNOSIS.event_margin_s) & (since <= rings_s)).any(axis=1))


def _spans(t: np.ndarray, mask: np.ndarray) -> tuple[tuple[float, float], ...]:
    change = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return tuple((float(t[a]), float(t[b - 1])) for a, b in zip(change[::2], change[1::2], strict=True))


def without(runs: Sequence[Run], found: Sequence[Unpredictable]) -> list[Run]:
    """The runs with the readings of these spans as missing."""
    by_run = {u.run: u.spans for u in found}
    return [replace(run, measured=tuple(_blanked(m, by_run.get(run.name, ())) for m in run.measured)) for run in runs]


def _blanked(measured: Measured, spans: Sequence[tuple[float, float]]) -> Measured:
    if not spans:
        return measured
    values = measured.values.copy()
    for a, b in spans:
        values[(measured.t >= a) & (measured.t <= b)] = np.nan
    return replace(measured, values=values)


def predicted_held_out(check: Problem, plain: Fitted | None, fitted: Fitted) -> Fitted | None:
    """A model on the recordings held out, of which the baseline has ``plain``; None without any.

    Which way a strip snaps may hang on less than the recordings given can tell, and the wrong branch is missed by a
    hundred times the noise, by the right model too. So where it predicts ``DIAGNOSIS.other_branch_ratio`` times as
    badly as the baseline, the ensemble of models that these recordings cannot tell from it is asked
    (:func:`members_of`), and one that predicts so much better stands for it: of the
    likelihood that is averaged over the ensemble, it has all but its share of a few nats.
    """
    if not check.runs:
        return None
    there = check.evaluate(fitted.rig, [], np.zeros(0))
    if plain is None or there.chi2 < DIAGNOSIS.other_branch_ratio * plain.chi2:
        return there
    shared = [k for k, p in enumerate(fitted.parameters) if not p.bag]
    parameters, best = [fitted.parameters[k] for k in shared], there
    for at in members_of(fitted):
        try:
            member = check.evaluate(rig_at(fitted.rig, parameters, at[shared]), [], np.zeros(0))
        except ThinshellError:
            continue
        if DIAGNOSIS.other_branch_ratio * member.chi2 < there.chi2 and member.chi2 < best.chi2:
            best = member
    return best
