"""Low-pass filter of a wrench sensor: its readings follow the true wrench like a first-order system.

    tau dy/dt = x - y,    y = x at the first reading

of the true wrench x and the reading y, solved exactly for a wrench that changes linearly between stamps:

    y' = x' - (1 - a) tau / dt (x' - x) + a (y - x),    a = exp(-dt / tau)

(Franklin, Powell & Workman, Digital Control of Dynamic Systems, 1998, sec. 6.3 (triangle hold)). The
cut-off frequency is 1 / (2 pi tau).
"""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import Channel, ReadingMap
from sim_core.effects.scopes import WRENCH_SENSORS


class WrenchLowPass(ReadingMap):
    """A wrench sensor with a filter that nobody mentioned."""

    name = "wrench_low_pass"
    title = "the force sensor filters its readings"
    words = "The wrench that is reported is low-pass filtered: it follows the true one with a first-order lag."
    signature = "The measured wrench is late and rounded where it changes quickly, and agrees in holds."
    source = "Franklin, Powell & Workman, Digital Control of Dynamic Systems, 1998, sec. 6.3 (triangle hold)"
    slot = "wrench sensor"
    follows = "sensor"
    passive = True
    scope = WRENCH_SENSORS
    twins = ("stream_delay", "gel_relaxation")
    separated_by = "A tap: a late clock keeps the peak of the force, a filter lowers it."
    parameters = (
        EffectParameter(
            "tau_s", "s", 0.0, 10.0, (0.02,), 0.0, False, 0.05, "time constant of the filter", "sampling_s", (1.0, 4.0)
        ),
    )
    example = {"tau_s": 0.05}

    def read(self, channel: Channel, readings: np.ndarray, values: Values) -> np.ndarray:
        return _filtered(channel, readings, values["tau_s"])

    def push(self, channel: Channel, readings: np.ndarray, change: np.ndarray, values: Values) -> np.ndarray:
        return _filtered(channel, change, values["tau_s"])

    def pull(self, channel: Channel, readings: np.ndarray, weights: np.ndarray, values: Values) -> np.ndarray:
        order, fade, ramp = _steps(channel.stamps, values["tau_s"])
        w, out, carried = weights[order], np.zeros_like(weights), np.zeros_like(weights[0])
        for k in reversed(range(1, len(order))):
            total = w[k] + carried
            out[order[k]] += (1.0 - ramp[k]) * total
            out[order[k - 1]] += (ramp[k] - fade[k]) * total
            carried = fade[k] * total
        out[order[:1]] += w[:1] + carried
        return np.asarray(out)


def _steps(stamps: np.ndarray, tau: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Order of the stamps in time, and a and (1 - a) tau / dt of the step to each from the one before, ``(k,)`` each;
    both are 1 where no time passes."""
    order = np.argsort(stamps, kind="stable")
    dt = np.diff(stamps[order], prepend=stamps[order[:1]])
    ratio = dt / tau if tau > 0.0 else np.full(len(dt), np.inf)
    mean = np.where(ratio > 0.0, -np.expm1(-ratio) / np.where(ratio > 0.0, ratio, 1.0), 1.0)
    return order, np.exp(-ratio), mean


def _filtered(channel: Channel, x: np.ndarray, tau: float) -> np.ndarray:
    order, fade, ramp = _steps(channel.stamps, tau)
    out = x.copy()
    for k in range(1, len(order)):
        then, now = order[k - 1], order[k]
        out[now] = x[now] - ramp[k] * (x[now] - x[then]) + fade[k] * (out[then] - x[then])
    return np.asarray(out)
