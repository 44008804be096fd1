"""Named approximations: in which directions, and by about how much, a careful simulation is off.

A prediction y differs from what a perfect simulation of the same physics would read by sum_e b_e E_e with known shapes
E_e and b_e ~ N(m_e, t_e^2). What halving the cells, the time step, or the range of contacts changes tells the error
that each of them leaves, extrapolated (:mod:`sysid.discretisation.refinement`), so that b_e is about 1. A sheet touches
with its surface, half its thickness from its middle, or with its middle in simulations that take it as a line or a
surface; what that changes is extrapolated from half of the way, so that b_e is between 0 and 1.

Poses are known to within their noise only. Where the motion really was lies about the smooth curve that a rollout
follows (:mod:`sim_core.rigs.pose_curve`), and a body that rings responds to that by more than the noise of its markers.
Of K motions dq_k drawn from what the poses leave open, with the derivative L of the readings by the motion, the
whitened responses are W = [L dq_1 ... L dq_K] / K^(1/2) = U S V^T, and the readings have the error U S b with
b ~ N(0, 1), the covariance of which is that of the draws.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sim_core.rigs.pose_offset import OFFSETS
from sim_core.scene.touching import half_thicknesses
from sysid.discretisation.error_budget import with_half_range
from sysid.model.parameters import rig_in
from sysid.model.prediction_source import AnyEngine
from sysid.model.responses import Modulated
from sysid.model.time_span import rollout_times
from sysid.observations.observations import Run
from sysid.settings.discretisation import DISCRETISATION
from sysid.solve.discretisation_basis import MODEL
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

CONTACT_RANGE = "contact range"
"""Name of what a narrower range of contacts changes; those of mesh and time step are the labels of their errors."""

TOUCHING_SURFACE = "touching surface"
"""Name of what changes where sheets touch with their middle and not with their surface."""

POSES = "poses"
"""Owner of what the noise of poses leaves open."""


@dataclass(frozen=True)
class Approximation:
    """``owner``: what is approximated; ``name``: of the direction; ``mean``, ``sd``: of its size, in units of the
    extrapolated error, or of what the noise of poses makes of it."""

    owner: str
    name: str
    mean: float
    sd: float


class Approximations:
    """Those of the model of a problem, where a fit stands. ``columns``: with a known shape; ``shapes``: of each
    recording by channel ``(n, m, k)``, measured units; ``failed``: why one could not be simulated, by name."""

    def __init__(self, engine: AnyEngine, base: Fitted, problem: Problem) -> None:
        self.failed: dict[str, str] = {}
        self._open = any(noise > 0.0 for run in problem.runs for p in run.poses.values() for noise in p.noise)
        self._rigs = [rig_in(base.rig, base.parameters, base.scaled, run.name) for run in problem.runs]
        known = [(d.label, d.shapes) for d in problem.error_shapes if d.label != MODEL]
        order = 2.0**DISCRETISATION.contact_order
        for name, changed, factor in (
            (CONTACT_RANGE, with_half_range, order / (order - 1.0)),
            (TOUCHING_SURFACE, _with_thinner_touch, 2.0),
        ):
            if changed(base.rig) != base.rig:
                error = self._secant(name, changed, factor, engine, base, problem.runs)
                known += [] if error is None else [(name, error)]
        self.columns = [Approximation(label, label, *DISCRETISATION.approximation_sizes[label]) for label, _ in known]
        self.shapes = [
            {m.channel: _stacked([s[i].get(m.channel) for _, s in known], m.values.shape) for m in run.measured}
            for i, run in enumerate(problem.runs)
        ]

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

    def open_motions(self, index: int, run: Run) -> list[Modulated]:
        """Draws of what the poses of recording number ``index`` leave open of its motion, as offsets of the end
        effectors that change in time, each of the size of one draw over the root of their number."""
        if not self._open:
            return []
        rng, rig = np.random.default_rng(index), self._rigs[index]
        times = rollout_times([rig], run, rig.solver.dt_s)
        return [_motion(rig, run, times, rng) for _ in range(DISCRETISATION.drawn_motions)]


def _with_thinner_touch(rig: Rig) -> Rig:
    """The rig with sheets that touch halfway between their surface and their middle."""
    contacts = [
        c.model_copy(update={"standoff_m": c.standoff_m - 0.5 * half_thicknesses(rig, c)}) for c in rig.contacts
    ]
    return rig.model_copy(update={"contacts": tuple(contacts)})


def _stacked(shapes: Sequence[np.ndarray | None], like: tuple[int, ...]) -> np.ndarray:
    found = [np.zeros(like) if s is None else s for s in shapes]
    return np.stack(found, axis=-1) if found else np.zeros((*like, 0))


def _motion(rig: Rig, run: Run, times: np.ndarray, rng: np.random.Generator) -> Modulated:
    """One draw of all end effectors.

    With the pose (p, R) and the offset (rho, phi) of the true frame in it, a motion dp of the pose and a turn dr in its
    own frame are the change (R^T dp + dr x rho, log(exp(dr) exp(phi)) - phi) of the offset."""
    parts = []
    for name, trajectory in run.poses.items():
        inside = np.clip(times, trajectory.times[0], trajectory.times[-1])
        position, quaternion = trajectory.sample(inside)
        there, turned = trajectory.drawn(rng).sample(inside) if len(trajectory.times) > 1 else (position, quaternion)
        own = Rotation.from_quat(quaternion)
        turn = own.inv() * Rotation.from_quat(turned)
        offset = rig.end_effectors[name].offset()
        shift = own.inv().apply(there - position) + np.cross(turn.as_rotvec(), offset[:3])
        turns = np.rad2deg((turn * Rotation.from_rotvec(offset[3:])).as_rotvec() - offset[3:])
        changes = np.hstack([shift, turns]) / np.sqrt(DISCRETISATION.drawn_motions)
        parts += [Modulated(f"{name}.{key}", times, changes[:, k]) for k, key in enumerate(OFFSETS)]
    return Modulated(parts[0].parameter, parts[0].times, parts[0].values, tuple(parts[1:]))


def principal(responses: np.ndarray) -> np.ndarray:
    """Columns ``(n, r)`` with the covariance of whitened responses ``(n, k)``, the largest first; what is far below the
    noise is left out."""
    squares, directions = np.linalg.eigh(responses.T @ responses)
    kept = squares > DISCRETISATION.faint_motion**2
    return np.asarray(responses @ directions[:, kept])[:, ::-1]
