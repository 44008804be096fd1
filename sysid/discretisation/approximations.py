"""Named approximations: in which directions, and by about how much, a careful simulation is off.

A prediction y differs from what a perfect simulation of the same physics would read by sum_e b_e E_e with known shapes
E_e and b_e ~ N(m_e, t_e^2). What halving the cells, the time step, or the range of contacts changes tells the error
that each of them leaves, extrapolated (:mod:`sysid.discretisation.refinement`), so that b_e is about 1, and 0 where
a recording was made by this very simulator. A sheet touches
with its surface, half its thickness from its middle, or with its middle in simulations that take it as a line or a
surface; what that changes is extrapolated from half of the way, so that b_e is between 0 and 1. How far the surface of
a gel is dragged along depends on the boundary far away, where forces do not: a pad of three or six times its thickness
moves it by a third (:mod:`sysid.discretisation.gel_extent`), and finite elements of the wider one differ by a tenth
from boundary elements of a layer without end, so that b_e of the motion of markers on a gel is 0.1 about 0.

Poses are known to within their noise only. Where the motion really was lies about the smooth curve that a rollout
follows (:mod:`sim_core.rigs.pose_curve`), and a body that rings responds to that by more than the noise of its markers.
Of K motions dq_k drawn from what the poses leave open, with the derivative L of the readings by the motion, the
whitened responses are W = [L dq_1 ... L dq_K] / K^(1/2) = U S V^T, and the readings have the error U S b with b ~ N(0,
1), the covariance of which is that of the draws. A few draws do not span what is open at hundreds of instants: what a
body follows at once is also an error of each instant (:func:`of_instants`). What rests on friction follows the
last few nanometres of a motion, and by no more than the friction that there is: what rollouts along some of the draws
change beyond their linear responses is an error of each instant as well. So is what readings change by while their
stamps jitter (:func:`of_stamps`). And so is by how much the errors of mesh, time step and range of contacts jump from
reading to reading: to which of two readings an impact counts hangs on where steps end, so that the next halving changes
other readings than the last one (:func:`of_jumps`).

A sensor reads the mean over a time w about its stamps, as a force sensor between two samples or a camera while its
shutter is open, w^2 / 24 d^2y/dt^2 beyond what is there at the stamp. Half of all sensors are taken to read an instant,
as simulated ones do; of the others w is evenly probable up to the interval T between two readings, so that w^2 / T^2
has the mean 1/6 and the variance 13/180.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.errors import ThinshellError
from sim_core.rigs import Gel, Rig
from sim_core.rigs.pose_curve import PoseCurve
from sim_core.rigs.pose_offset import OFFSETS
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.touching import half_thicknesses
from sysid.discretisation.error_budget import with_half_range
from sysid.model.parameters import rig_in
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.model.responses import Modulated
from sysid.model.time_span import rollout_times
from sysid.observations.observations import Run
from sysid.settings.discretisation import DISCRETISATION
from sysid.settings.solve import SOLVE
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.named_errors import NamedError, NamedErrors
from sysid.solve.optimum import Fitted
from sysid.solve.outliers import DIMENSIONS
from sysid.solve.residuals import Problem

CONTACT_RANGE = "contact range"
"""Name of what a narrower range of contacts changes; those of mesh and time step are the labels of their errors."""

TOUCHING_SURFACE = "touching surface"
"""Name of what changes where sheets touch with their middle and not with their surface."""

GEL_EXTENT = "gel extent"
"""Owner of what the boundary far away changes in how far a surface is dragged along."""

AVERAGING = "averaging of a sensor"
"""Owner of what a sensor changes that reads the mean over a time about its stamps."""

POSES = "poses"
"""Owner of what the noise of poses leaves open."""


def sized(label: str) -> NamedError:
    """A named error with the size that is expected of it: of mesh and time step, that which fits expect."""
    owner = label.split(",")[0]
    of_refinement = (SOLVE.expected_error_size, SOLVE.error_size_sd)
    return NamedError(owner, label, *DISCRETISATION.approximation_sizes.get(owner, of_refinement))


def refinement_errors(shapes: Sequence[ErrorShape], runs: Sequence[Run]) -> NamedErrors:
    """The errors of mesh and time step alone."""
    by_channel = tuple(
        {m.channel: _stacked([s.shapes[i].get(m.channel) for s in shapes], m.values.shape) for m in run.measured}
        for i, run in enumerate(runs)
    )
    instant = tuple(
        {m.channel: of_jumps(m.t, shape[m.channel]) for m in run.measured}
        for run, shape in zip(runs, by_channel, strict=True)
    )
    return NamedErrors(tuple(sized(s.label) for s in shapes), by_channel, tuple(shapes), instant)


class Approximations:
    """Those of the model of a problem, where a fit stands. ``columns``: with a known shape; ``shapes``: of each
    recording by channel ``(n, m, k)``, measured units; ``jumps``: of each recording by channel, what of the errors of
    mesh, time step and contact each instant has for itself ``(n, r, m)``; ``failed``: why one could not be simulated,
    by name."""

    def __init__(self, engine: AnyEngine, base: Fitted, problem: Problem) -> None:
        self.failed: dict[str, str] = {}
        self._engine, self._centre = engine, base.centre
        self._open = any(noise > 0.0 for run in problem.runs for p in run.poses.values() for noise in p.noise)
        self._rigs = [rig_in(base.rig, base.parameters, base.scaled, run.name) for run in problem.runs]
        known = [(d.label, d.shapes) for d in problem.refined]
        order = 2.0**DISCRETISATION.contact_order
        for name, changed, factor in (
            (CONTACT_RANGE, with_half_range, order / (order - 1.0)),
            (TOUCHING_SURFACE, _with_thinner_touch, 2.0),
        ):
            if changed(base.rig) != base.rig:
                error = self._secant(name, changed, factor, engine, base, problem.runs)
                known += [] if error is None else [(name, error)]
        solved = [k for k, (name, _) in enumerate(known) if name != TOUCHING_SURFACE]
        known += _of_gel_extent(base.rig, problem.runs, base.predictions)
        known += _of_averaging(problem.runs, base.predictions)
        self.columns = [sized(label) for label, _ in known]
        self.shapes = [
            {m.channel: _stacked([s[i].get(m.channel) for _, s in known], m.values.shape) for m in run.measured}
            for i, run in enumerate(problem.runs)
        ]
        self.jumps = [
            {m.channel: of_jumps(m.t, shapes[m.channel][..., solved]) for m in run.measured}
            for run, shapes in zip(problem.runs, self.shapes, strict=True)
        ]
        self._refined = tuple(problem.refined)

    def _secant(
        self,
        name: str,
        changed: Callable[[Rig], Rig],
        factor: float,
        engine: AnyEngine,
        base: Fitted,
        runs: Sequence[Run],
    ) -> tuple[dict[str, np.ndarray], ...] | None:
        """A factor times what a change of the rigs makes of the readings."""
        jobs = [engine.submit(changed(rig), run) for rig, run in zip(self._rigs, runs, strict=True)]
        try:
            found = [job.result() for job in jobs]
        except ThinshellError as error:
            self.failed[name] = f"could not be simulated: {error.problem}"
            return None
        pairs = zip(found, base.predictions, strict=True)
        return tuple({c: np.nan_to_num(factor * (v - q.values[c])) for c, v in p.values.items()} for p, q in pairs)

    def offsets(self, run: Run) -> list[Modulated]:
        """Offsets of the end effectors of a recording that stay, none where its poses leave nothing open."""
        ends = np.array([0.0, max(run.end, 1e-9)])
        return [Modulated(f"{n}.{k}", ends, np.ones(2)) for n in run.poses for k in OFFSETS] if self._open else []

    def open_motions(self, index: int, run: Run) -> list[Modulated]:
        """Draws of what the poses of recording number ``index`` leave open of its motion, as offsets of the end
        effectors that change in time, each of the size of one draw over the root of their number."""
        if not self._open:
            return []
        rng, rig = np.random.default_rng(index), self._rigs[index]
        times = rollout_times([rig], run, rig.solver.dt_s)
        return [_motion(rig, run, times, _drawn(run, rng)) for _ in range(DISCRETISATION.drawn_motions)]

    def submit_along(self, index: int, run: Run) -> list[Future[Prediction]]:
        """Rollouts of recording number ``index`` along the motion that was measured, and along the first draws of
        :meth:`open_motions`, of whole size. Where a fit has less friction than the rig, they have that of the rig: with
        hardly any friction nothing rests on it, whatever the motion."""
        if not self._open:
            return []
        rng, rig = np.random.default_rng(index), _with_friction_of(self._centre, self._rigs[index])
        times = rollout_times([rig], run, rig.solver.dt_s)
        drawn = [_drawn(run, rng) for _ in range(DISCRETISATION.rolled_motions)]
        measured = {name: p.curve for name, p in run.poses.items() if len(p.times) > 1}
        return [self._engine.submit(rig, _along(run, curves, times)) for curves in (measured, *drawn)]

    def with_motions(
        self,
        runs: Sequence[Run],
        open_: Sequence[Mapping[str, np.ndarray]],
        count: Sequence[int],
        instant: Sequence[dict[str, np.ndarray]],
    ) -> NamedErrors:
        """All named errors. ``open_``: by recording and channel, the ``count`` principal responses to its open motions
        ``(n, m, k)``; ``instant``: those that each instant has for itself (:func:`of_instants`)."""
        ends, columns, shapes = np.cumsum([0, *count]), list(self.columns), []
        for i, run in enumerate(runs):
            columns += [NamedError(POSES, f"{run.name}, direction {k + 1}", 0.0, 1.0) for k in range(count[i])]
            found = {}
            for m in run.measured:
                whole = np.zeros((*m.values.shape, ends[-1]))
                whole[..., ends[i] : ends[i + 1]] = open_[i][m.channel]
                found[m.channel] = np.concatenate([self.shapes[i][m.channel], whole], axis=-1)
            shapes.append(found)
        return NamedErrors(tuple(columns), tuple(shapes), self._refined, tuple(instant))


def _of_gel_extent(
    rig: Rig, runs: Sequence[Run], predictions: Sequence[Prediction]
) -> list[tuple[str, tuple[dict[str, np.ndarray], ...]]]:
    """What the extent of a gel changes: the motion of markers on it, seen from what it is fixed to, axis by axis."""
    found = []
    for name, camera in rig.cameras.items():
        bodies = [rig.bodies[sight.body] for sight in camera.sees]
        if not bodies or not all(isinstance(b, Gel) and b.mount == camera.mount for b in bodies):
            continue
        axes = {DIMENSIONS[m.kind] for run in runs for m in run.measured if m.channel == name and m.kind in DIMENSIONS}
        for axis in range(max(axes, default=0)):
            shapes = []
            for run, p in zip(runs, predictions, strict=True):
                out = {m.channel: np.zeros(m.values.shape) for m in run.measured}
                if name in out:
                    values = p.values[name]
                    first = values[np.argmax(np.isfinite(values).any(axis=1))]
                    out[name][:, axis :: max(axes)] = np.nan_to_num(values - first)[:, axis :: max(axes)]
                shapes.append(out)
            found.append((f"{GEL_EXTENT}, axis {axis + 1} of {name}", tuple(shapes)))
    return found


def _of_averaging(
    runs: Sequence[Run], predictions: Sequence[Prediction]
) -> list[tuple[str, tuple[dict[str, np.ndarray], ...]]]:
    """What each sensor changes that reads the mean over the whole interval between two readings."""
    found = []
    for channel in dict.fromkeys(m.channel for run in runs for m in run.measured):
        shapes = []
        for run, p in zip(runs, predictions, strict=True):
            out = {m.channel: np.zeros(m.values.shape) for m in run.measured}
            for m in run.measured:
                if m.channel == channel:
                    out[channel] = mean_less_instant(m.t, p.values[channel])
            shapes.append(out)
        found.append((f"{AVERAGING}, {channel}", tuple(shapes)))
    return found


def mean_less_instant(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The mean over the usual interval T between the instants ``t`` [s] ``(n,)`` less the value there ``(n, m)``: T^2 /
    24 times the second divided difference, 0 at the ends and next to what is missing."""
    out = np.zeros(values.shape)
    if len(t) < 3:
        return out
    steps = np.diff(t)
    slopes = np.diff(values, axis=0) / steps[:, None]
    second = 2.0 * np.diff(slopes, axis=0) / (steps[1:] + steps[:-1])[:, None]
    out[1:-1] = np.nan_to_num(np.median(steps) ** 2 / 24.0 * second)
    return out


def _with_thinner_touch(rig: Rig) -> Rig:
    """The rig with sheets that touch halfway between their surface and their middle."""
    contacts = [
        c.model_copy(update={"standoff_m": c.standoff_m - 0.5 * half_thicknesses(rig, c)}) for c in rig.contacts
    ]
    return rig.model_copy(update={"contacts": tuple(contacts)})


def _stacked(shapes: Sequence[np.ndarray | None], like: tuple[int, ...]) -> np.ndarray:
    found = [np.zeros(like) if s is None else s for s in shapes]
    return np.stack(found, axis=-1) if found else np.zeros((*like, 0))


def _with_friction_of(centre: Rig, rig: Rig) -> Rig:
    """The rig with no less friction in each contact than another one."""
    contacts = [
        c.model_copy(update={"friction": max(c.friction, other.friction)})
        for c, other in zip(rig.contacts, centre.contacts, strict=True)
    ]
    return rig.model_copy(update={"contacts": tuple(contacts)})


def _drawn(run: Run, rng: np.random.Generator) -> dict[str, PoseCurve]:
    """One draw of the motion of all end effectors that move."""
    return {name: p.drawn(rng) for name, p in run.poses.items() if len(p.times) > 1}


def _along(run: Run, curves: Mapping[str, PoseCurve], times: np.ndarray) -> Run:
    """The run along other curves, given at the ``times`` [s] of a rollout."""
    poses = dict(run.poses)
    for name, curve in curves.items():
        first, last = poses[name].times[[0, -1]]
        inside = np.unique(np.clip(times, first, last))
        poses[name] = PoseTrajectory(inside, *curve.sample(inside))
    return replace(run, poses=poses)


def _motion(rig: Rig, run: Run, times: np.ndarray, curves: Mapping[str, PoseCurve]) -> Modulated:
    """One draw of all end effectors.

    With the pose (p, R) and the offset (rho, phi) of the true frame in it, a motion dp of the pose and a turn dr in its
    own frame are the change (R^T dp + dr x rho, log(exp(dr) exp(phi)) - phi) of the offset."""
    parts = []
    for name, trajectory in run.poses.items():
        inside = np.clip(times, trajectory.times[0], trajectory.times[-1])
        position, quaternion = trajectory.sample(inside)
        there, turned = curves[name].sample(inside) if name in curves else (position, quaternion)
        own = Rotation.from_quat(quaternion)
        turn = own.inv() * Rotation.from_quat(turned)
        offset = rig.end_effectors[name].offset()
        shift = own.inv().apply(there - position) + np.cross(turn.as_rotvec(), offset[:3])
        turns = np.rad2deg((turn * Rotation.from_rotvec(offset[3:])).as_rotvec() - offset[3:])
        changes = np.hstack([shift, turns]) / np.sqrt(DISCRETISATION.drawn_motions)
        parts += [Modulated(f"{name}.{key}", times, changes[:, k]) for k, key in enumerate(OFFSETS)]
    return Modulated(parts[0].parameter, parts[0].times, parts[0].values, tuple(parts[1:]))


def of_rollouts(responses: np.ndarray, along: Sequence[np.ndarray]) -> np.ndarray:
    """By what readings along drawn motions differ from their linear prediction, at each instant ``(n, r, m)``, for
    errors of unit variance. ``responses`` ``(n, m, r)``: linear ones to the draws, as scaled by
    :meth:`Approximations.open_motions`; ``along`` ``(n, m)`` each: readings along the motion that was measured, and
    along the draws.

    What is alike in k readings in a row is known no better by all of them than by one: as errors that are independent
    from instant to instant they have k times the variance, with k the integrated autocorrelation of the differences.
    What rests on friction turns over now and then, and a few draws may all agree at an instant at which the next one
    would not: half of the variance is that of the readings thereabouts."""
    if len(along) < 2:
        return np.zeros((len(responses), 0, responses.shape[1]))
    whole = np.sqrt(DISCRETISATION.drawn_motions) * responses
    found = np.nan_to_num(np.stack([there - along[0] - whole[..., k] for k, there in enumerate(along[1:])], axis=1))
    return np.asarray(np.sqrt(_integrated_autocorrelation(found) / found.shape[1]) * _shrunk(found))


def _shrunk(errors: np.ndarray) -> np.ndarray:
    """Errors ``(n, r, m)`` of unit variance, half of the covariance of which is that of each instant and half the mean
    of those about it, in windows as wide as the finest level of courses of errors: their largest principal components
    ``(n, r, m)``, of the same variance as all."""
    n, r, m = errors.shape
    reach = n // (2 * (SOLVE.error_course_levels[-1][0] - 1))
    out = np.zeros((n, r, m))
    for k in range(n):
        near = errors[max(0, k - reach) : k + reach + 1].reshape(-1, m)
        both = np.concatenate([errors[k], near / np.sqrt(len(near) / r)]) / np.sqrt(2.0)
        _, s, vt = np.linalg.svd(both, full_matrices=False)
        kept = min(r, len(s))
        share = np.linalg.norm(s[:kept]) / max(np.linalg.norm(s), np.finfo(float).tiny)
        out[k, :kept] = s[:kept, None] / max(share, np.finfo(float).tiny) * vt[:kept]
    return out


def _integrated_autocorrelation(values: np.ndarray) -> float:
    """1 + 2 sum_l C(l) / C(0) of the autocovariances about zero of courses ``(n, ...)``, up to the first pair of lags
    whose sum is not positive (Geyer, Stat. Sci. 7, 1992), at least 1."""
    n = len(values)
    spectrum = np.abs(np.fft.rfft(values.reshape(n, -1), 2 * n, axis=0)) ** 2
    covariance = np.fft.irfft(spectrum.sum(axis=1), 2 * n)[:n]
    if covariance[0] <= 0.0:
        return 1.0
    pairs = covariance[: n - n % 2].reshape(-1, 2).sum(axis=1) / covariance[0]
    end = int(np.argmax(pairs <= 0.0)) if (pairs <= 0.0).any() else len(pairs)
    return float(max(1.0, 2.0 * pairs[:end].sum() - 1.0))


def of_instants(t: np.ndarray, motions: Sequence[Modulated], shifted: np.ndarray) -> np.ndarray:
    """What open motions change at each of the instants ``t`` [s] ``(n,)`` as offsets that stay ``(n, r, m)``, measured
    units, for errors of unit variance. ``shifted`` ``(n, m, r)``: derivatives by these offsets.

    Draws q_k of a motion are a few of hundreds of independent ones, and what a body follows at once is known instant
    by instant: with the derivative Q(t) by the offset, it is Q(t) C(t), C C^T = sum_k q_k(t) q_k(t)^T."""
    courses = np.array([[part.course(t) for part in m.parts] for m in motions])
    values, vectors = np.linalg.eigh(np.einsum("kin,kjn->nij", courses, courses))
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
    return np.asarray((shifted @ root).transpose(0, 2, 1))


def of_stamps(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """What stamps ``t`` [s] ``(n,)`` that jitter change of predicted readings ``(n, m)`` at each instant ``(n, 1, m)``,
    for errors of unit variance: how fast they change, times the jitter by which intervals between stamps differ."""
    if len(t) < 3:
        return np.zeros((len(t), 0, values.shape[1]))
    steps = np.diff(t)
    jitter = 1.4826 * float(np.median(np.abs(steps - np.median(steps)))) / np.sqrt(2.0)
    return np.asarray(jitter * np.nan_to_num(np.gradient(values, t, axis=0))[:, None])


def of_jumps(t: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """What of errors ``(n, m, k)`` at the instants ``t`` [s] ``(n,)`` each instant has for itself ``(n, k, m)``, for
    errors of unit variance: how far they are from the straight line between the readings before and after. Errors that
    are independent from reading to reading are as large on average, (2/3)^(1/2) of these distances."""
    out = np.zeros(errors.shape)
    if len(t) > 2:
        share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None, None]
        out[1:-1] = errors[1:-1] - ((1.0 - share) * errors[:-2] + share * errors[2:])
    return np.asarray(np.sqrt(2.0 / 3.0) * np.nan_to_num(out).transpose(0, 2, 1))


def principal(responses: np.ndarray) -> np.ndarray:
    """Combinations ``(k, r)`` of whitened responses ``(n, k)`` that have their covariance, the largest first; what is
    far below the noise is left out."""
    squares, directions = np.linalg.eigh(responses.T @ responses)
    return np.asarray(directions[:, squares > DISCRETISATION.faint_motion**2])[:, ::-1]
