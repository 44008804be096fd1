"""Losses on the readings of a rollout, and what they must tell for a gradient."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sim_core.energies.linearised import flatten
from sim_core.errors import ConfigError
from sim_core.simulate import Trace
from sim_core.solve.step import State

Loss = Callable[[Trace], tuple[float, Mapping[str, np.ndarray]]]
"""Value of a loss and its derivatives by the readings, by channel in the shape of ``trace.outputs`` (a channel may be
left out; readings out of sight, NaN, count as zero). Readings are those at the instants of the steps, before delays of
streams and effects of sensors: :func:`sysid.model.sensor_streams.predicted_back` takes a loss on streams back to
them."""


def in_sight(trace: Trace, by_readings: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Derivatives of a loss by the readings of ``trace``, by channel in the shape of its outputs: zero where these are
    out of sight, NaN.

    Raises ``ConfigError`` where a channel is none of the trace's, where the shape is not that of its readings, and
    where the derivative by a reading in sight is not a number.
    """
    found = {}
    for channel, given in by_readings.items():
        if channel not in trace.outputs:
            raise ConfigError(
                f"The loss has derivatives by the channel {channel!r}, which the rollout does not have.",
                f"Name those that it has: {', '.join(trace.outputs)}.",
            )
        readings, weights = trace.outputs[channel], np.asarray(given, dtype=float)
        if weights.shape != readings.shape:
            raise ConfigError(
                f"The loss has derivatives by the channel {channel!r} of shape {weights.shape}, not {readings.shape} "
                "as its readings.",
                "Give one for each reading at each instant: np.zeros_like(trace.outputs[channel]), filled where the "
                "loss depends on it.",
            )
        hidden = np.isnan(readings)
        broken = np.argwhere(~hidden & ~np.isfinite(weights))
        if len(broken):
            first = tuple(int(k) for k in broken[0])
            raise ConfigError(
                f"The loss has {len(broken)} derivatives by readings of the channel {channel!r} in sight that are not "
                f"finite, the first at {first}: {weights[first]:g}.",
                "Readings out of sight are NaN: leave them out of sums over others, or use np.where.",
            )
        found[channel] = np.where(hidden, 0.0, weights)
    return found


def end_memory(end: State, given: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Derivatives of a loss by the internal variables of the last state, by term, as one vector each: zero where none
    are ``given``, by term and name in the shape of the variables.

    Raises ``ConfigError`` where a term or a variable is none of the state's, and where a shape is not its own.
    """
    for term, variables in given.items():
        known = end.internals.get(term, {})
        for name, values in variables.items():
            if name not in known or np.shape(values) != known[name].shape or not np.isfinite(values).all():
                has = {n: a.shape for n, a in known.items()}
                raise ConfigError(
                    f"The loss has derivatives by {name!r} of the term {term!r} of shape {np.shape(values)}, which are "
                    f"no finite derivatives by an internal variable of the rollout.",
                    f"That term has {has}." if has else f"Terms that have some: {', '.join(end.internals)}.",
                )
    return {
        term: flatten(
            {n: np.asarray(given.get(term, {}).get(n, np.zeros_like(a)), dtype=float) for n, a in own.items()}
        )
        for term, own in end.internals.items()
    }


def one_number(value: float) -> float:
    """The value of a loss. Raises ``ConfigError`` where it is not one finite real number."""
    given = np.asarray(value)
    if given.shape != () or given.dtype.kind not in "fiub" or not np.isfinite(given):
        shown = f"of shape {given.shape}" if given.shape else f"{value!r}"
        raise ConfigError(
            f"The value of the loss is {shown}, not one finite real number.",
            "Sum over readings, those that are out of sight (NaN) left out: float(np.nansum(...)).",
        )
    return float(given)
