"""Wrenches that step while nothing moves: the sensor was set to zero in the middle of a recording."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.noise.estimate import by_differences
from sysid.observations.checks.finding import Finding
from sysid.observations.checks.motion import WORDS, at_rest, components, unit
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def tares(recording: Recording) -> Iterator[Finding]:
    """Tares that the recording tells of and that could not be undone, and steps to zero of all that a sensor measures,
    at rest."""
    for name, wrench in recording.wrenches.items():
        for t in recording.tared.get(name, ()):
            yield Finding(
                "tare",
                wrench.topic,
                "warning",
                f"{name} was set to zero at {t:.3f} s, as the events of the recording say, and what had been taken "
                "off before is not known.",
                f"Fit the recording in two windows, BAG@0:{t:.3f} and what follows: each has its own bias.",
                times=(t,),
                part=name,
            )
        if recording.tared.get(name):
            continue
        values, still = components(wrench), at_rest(recording, wrench.t)
        measured = np.flatnonzero(np.isfinite(values).all(axis=0) & (np.ptp(values, axis=0) > 0.0))
        if not len(measured) or len(values) < 3 * OBSERVATIONS.tare_side_readings:
            continue
        for k in _steps(values[:, measured], still):
            before, after = (
                values[k - OBSERVATIONS.tare_side_readings : k - 1],
                values[k + 1 : k + 1 + OBSERVATIONS.tare_side_readings],
            )
            column = int(
                measured[np.argmax(np.abs(before.mean(axis=0) - after.mean(axis=0))[measured] / _scale(measured))]
            )
            yield Finding(
                "tare",
                wrench.topic,
                "warning",
                f"While nothing moves {WORDS[column]} steps from {before[:, column].mean():.4g} to "
                f"{after[:, column].mean():.2g} {unit(column)} at {wrench.t[k]:.3f} s, and all that the sensor "
                "measures is zero from there: it was set to zero in the middle of the recording.",
                f"Fit the recording in two windows, BAG@0:{wrench.t[k]:.3f} and what follows: each has its own bias.",
                times=(float(wrench.t[k]),),
                values=(float(before[:, column].mean()), float(after[:, column].mean())),
                bound=0.0,
                part=name,
            )
        for k in _steps_in_motion(values[:, measured], wrench.t, still):
            column = int(measured[np.argmax(np.abs(values[k] - values[k - 1])[measured] / _scale(measured))])
            yield Finding(
                "tare",
                wrench.topic,
                "warning",
                f"While it moves, {WORDS[column]} jumps from {values[k - 1, column]:.4g} {unit(column)} to nothing at "
                f"{wrench.t[k]:.3f} s with all else that the sensor measures, and goes on from there: it was set to "
                "zero in the middle of the recording.",
                f"Fit the recording in two windows, BAG@0:{wrench.t[k]:.3f} and what follows: each has its own bias.",
                times=(float(wrench.t[k]),),
                values=(float(values[k - 1, column]), 0.0),
                bound=0.0,
                part=name,
            )


def _steps_in_motion(values: np.ndarray, t: np.ndarray, still: np.ndarray) -> list[int]:
    """First readings ``(k,)`` at which all of ``values`` ``(n, c)`` jump to zero while something moves, and leave it
    again: what lets go stays at zero."""
    side = OBSERVATIONS.tare_side_readings
    noise = np.array([max(by_differences(column[:, None], t), default=0.0) for column in values.T])
    steps = np.abs(np.diff(values, axis=0))
    zero = (np.abs(values) <= OBSERVATIONS.tare_zero_sd * noise).all(axis=1)
    found: list[int] = []
    for k in np.flatnonzero(zero):
        if not side <= k < len(values) - side or still[k - 1 : k + 1].all() or (found and k - found[-1] < side):
            continue
        near = np.maximum(steps[k - side : k - 1].max(axis=0), steps[k : k + side - 1].max(axis=0))
        jumped = steps[k - 1] > OBSERVATIONS.tare_step_ratio * np.maximum(
            noise, near / OBSERVATIONS.tare_jump_over_step
        )
        goes_on = np.abs(values[k + 1 : k + side]).max(axis=0) > OBSERVATIONS.tare_step_ratio * noise
        if jumped.any() and goes_on.any():
            found.append(int(k))
    return found


def _scale(components_: np.ndarray) -> np.ndarray:
    """A torque of 1 N mm is as much as a force of 0.1 N."""
    return np.where(components_ < 3, 1.0, 1e-2)


def _steps(values: np.ndarray, still: np.ndarray) -> list[int]:
    """First readings ``(k,)`` after steps to zero in ``values`` ``(n, c)``."""
    found: list[int] = []
    for k in range(OBSERVATIONS.tare_side_readings, len(values) - OBSERVATIONS.tare_side_readings - 1):
        if not still[k - OBSERVATIONS.tare_side_readings : k + OBSERVATIONS.tare_side_readings].all() or (
            found and k - found[-1] < OBSERVATIONS.tare_side_readings
        ):
            continue
        before, after = (
            values[k - OBSERVATIONS.tare_side_readings : k - 1],
            values[k + 1 : k + 1 + OBSERVATIONS.tare_side_readings],
        )
        scatter = np.maximum(np.maximum(before.std(axis=0), after.std(axis=0)), 1e-12)
        height = np.abs(before.mean(axis=0) - after.mean(axis=0))
        zero = np.abs(after.mean(axis=0)) < OBSERVATIONS.tare_zero_sd * scatter / np.sqrt(
            OBSERVATIONS.tare_side_readings
        )
        one = np.abs(values[k] - values[k - 1]) > 0.7 * height
        if zero.all() and ((height > OBSERVATIONS.tare_step_ratio * scatter) & one).any():
            found.append(k)
    return found
