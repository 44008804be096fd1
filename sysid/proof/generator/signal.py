"""How far an effect stands out: the norm of its whitened trace after projection off what the parameters can absorb.

signal = min_theta || W (y(effect) - y - J theta) ||: y(effect) and y are noise-free predictions at the true
materials with and without the effect, J the derivatives by the fitted parameters, W whitens with the true
noise. The number depends on physics and noise alone; it is the square root of what a best fit would leave.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import SerialPredictor
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.whitening import whiten
from sysid.observations.observations import Measured, Run
from sysid.proof.generator.bench import MATERIALS, Noise
from sysid.proof.generator.noise import kinds

ABSORBING = (*MATERIALS, "strip.density_kg_m3", "gel.nu", "contacts.gel-strip.friction")
"""Parameters that a fit may shift to explain an effect away."""


class Sight:
    """Predictions and derivatives at the true materials without an effect, kept to weigh several effects."""

    def __init__(self, rig: Rig, poses: Sequence[Mapping[str, PoseTrajectory]], levels: dict[str, Noise]) -> None:
        self._rig = rig
        self._levels = levels
        self._engine = SerialPredictor()
        self._runs = [self._blank(p) for p in poses]
        parameters = fit_parameters(rig, ABSORBING)
        start = start_of(rig, parameters)
        found = [self._engine.predict_with_derivatives(rig, run, parameters, start) for run in self._runs]
        self._columns = {c: v.shape[1] for c, v in found[0].values.items()}
        self.steps = sum(len(f.trace.reports) for f in found)
        self._clean = self._white([f.values for f in found])
        slopes = [f.derivatives for f in found]
        jacobian = np.column_stack(
            [self._white([{c: d[..., k] for c, d in s.items()} for s in slopes]) for k in range(len(parameters))]
        )
        half = 0.5 * rig.solver.dt_s
        finer = self._white([self._engine.predict(rig, run, 1, half).values for run in self._runs])
        jacobian = np.column_stack([jacobian, *self._by_stream(finer - self._clean)])
        jacobian /= np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
        basis, sizes, _ = np.linalg.svd(jacobian, full_matrices=False)
        self._basis = basis[:, sizes > 1e-9 * sizes[0]]

    def signal(self, effect: str, amplitudes: Mapping[str, float]) -> float:
        """Norm of the trace of an effect, in standard deviations of the noise."""
        amended = self._rig.model_copy(update={"effects": {effect: dict(amplitudes)}})
        return self.residual_norm(self._white([self._engine.predict(amended, run).values for run in self._runs]))

    def discretisation(self, refine: int, dt: float) -> float:
        """Norm of the change that a finer mesh and step make, in the same unit."""
        return self.residual_norm(
            self._white([self._engine.predict(self._rig, run, refine, dt).values for run in self._runs])
        )

    def residual_norm(self, white: np.ndarray) -> float:
        """Norm of a whitened change of all readings after projection off the parameters."""
        change = white - self._clean
        return float(np.linalg.norm(change - self._basis @ (self._basis.T @ change)))

    def _white(self, values: Sequence[Mapping[str, np.ndarray]]) -> np.ndarray:
        parts = []
        for run, by_channel in zip(self._runs, values, strict=True):
            for m in run.measured:
                keys = kinds(m.kind, by_channel[m.channel].shape[1])
                sd, rho = (np.array([getattr(self._levels[k], name) for k in keys]) for name in ("sd", "rho"))
                parts.append(whiten(by_channel[m.channel], ChannelNoise(sd, rho, ""), m.t).ravel())
        return np.asarray(np.nan_to_num(np.concatenate(parts)))

    def _by_stream(self, change: np.ndarray) -> list[np.ndarray]:
        """A change of all readings as one column for each run and channel."""
        columns, at = [], 0
        for run in self._runs:
            for m in run.measured:
                size = len(m.t) * self._columns[m.channel]
                column = np.zeros_like(change)
                column[at : at + size] = change[at : at + size]
                columns.append(column)
                at += size
        return columns

    def _blank(self, poses: Mapping[str, PoseTrajectory]) -> Run:
        """A run of which only the stamps are known."""
        end = max(float(p.times[-1]) for p in poses.values())
        measured = []
        for name, source in (*self._rig.sensors.items(), *self._rig.cameras.items()):
            stamps = np.arange(int(np.floor(end * source.rate_hz + 1e-9)) + 1) / source.rate_hz
            kind = getattr(source, "type", "tracks")
            measured.append(Measured(name, kind, stamps, np.zeros((len(stamps), 0)), ()))
        return Run("run", "", (), dict(poses), tuple(measured), end)
