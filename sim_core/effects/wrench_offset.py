"""Bias and drift of a wrench sensor: it reads a force and a torque that are not there, and that may grow.

reading = truth + bias + drift * t,    t: since the sensor began
"""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Nuisance, Values
from sim_core.effects.hooks import Additive, Channel
from sim_core.effects.scopes import WRENCH_SENSORS
from sim_core.rigs import Rig


def _six(force: tuple[str, str], torque: tuple[str, str], words: str, rate: bool) -> list[EffectParameter]:
    """Parameters along x, y, z of a force and of a torque: (name with {}, unit) each. Their priors are a tenth of what
    was measured, per duration for rates; 0.5 N and 0.05 N m, or 0.1 N/s and 0.01 N m/s, where nothing is known."""
    found = []
    for (name, unit), kind, size in ((force, "force", 1.0), (torque, "torque", 0.1)):
        bound, width = (10.0 * size, 0.1 * size) if rate else (100.0 * size, 0.5 * size)
        for axis in "xyz":
            found.append(
                EffectParameter(
                    name.format(axis),
                    unit,
                    -bound,
                    bound,
                    (0.0,),
                    0.0,
                    False,
                    width,
                    f"{words} of the {kind} along {axis}",
                    "force_n" if kind == "force" else "torque_nm",
                    (),
                    0.1,
                    rate,
                )
            )
    return found


class WrenchOffset(Additive):
    """A wrench sensor that was not tared, or that drifts, in all six components."""

    name = "wrench_offset"
    title = "the force sensor has an offset"
    words = (
        "The readings of the force sensor carry an offset that has nothing to do with contact: a constant bias, a "
        "drift proportional to time, or both, in forces and torques."
    )
    signature = "The residual of the wrench is the same with and without contact, or a straight line in time."
    slot = "wrench sensor"
    follows = "session"
    passive = True
    scope = WRENCH_SENSORS
    twins = ("gel_relaxation",)
    separated_by = "Rests in air before and after contact."
    parameters = (
        *_six(("bias_{}_n", "N"), ("torque_bias_{}_nm", "N m"), "constant offset", False),
        *_six(("drift_{}_n_per_s", "N/s"), ("torque_drift_{}_nm_per_s", "N m/s"), "drift", True),
    )
    example = {
        **{name.format(a): 0.1 for name in ("bias_{}_n", "torque_bias_{}_nm") for a in "xyz"},
        **{name.format(a): 0.05 for name in ("drift_{}_n_per_s", "torque_drift_{}_nm_per_s") for a in "xyz"},
    }

    def nuisances(self, rig: Rig) -> tuple[Nuisance, ...]:
        """A constant in each component of each sensor and recording."""
        own = tuple(p.name for p in self.parameters if "bias" in p.name)
        return tuple(Nuisance("bias", name, None, None, own, per_recording=True) for name in self.targets(rig))

    def added(self, channel: Channel, values: Values) -> np.ndarray:
        names = ("bias_{}_n", "torque_bias_{}_nm"), ("drift_{}_n_per_s", "torque_drift_{}_nm_per_s")
        bias, drift = (np.array([values[n.format(a)] for n in pair for a in "xyz"]) for pair in names)
        return np.asarray(bias + drift * (channel.stamps + channel.since)[:, None])
