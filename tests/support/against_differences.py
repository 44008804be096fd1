"""Derivatives of rollouts, compared with central differences of rollouts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim_core.gradients import directions, simulate_tangent
from sim_core.rigs import Rig, list_parameters, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import Trace, simulate
from sim_core.solve.report import NewtonSettings

SHARES = (1e-4, 1e-5, 1e-6)
"""Half widths of differences, as shares of the value."""

CENTRAL, ONE_SIDED = {-1: -0.5, 1: 0.5}, {0: -1.5, 1: 2.0, 2: -0.5}
"""Weights of rollouts so many half widths away, of differences of second order; to one side at a bound."""


def compare_derivatives(
    rig: Rig,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    names: Sequence[str],
    settings: NewtonSettings,
    *,
    share: float = 1e-5,
    smooth: float = 0.9,
    round_off: float = 4e-11,
) -> Trace:
    """Each derivative agrees with one of the differences to a ``share`` of its largest value, and to what the
    ``round_off`` of readings [N, px] makes of that difference, for ``smooth`` of all instants: a difference of rollouts
    jumps at those that follow a contact made on one side of it alone, a derivative does not. Differences of which
    round-off is more than 1 % are left out, but for the widest. The trace of the rollout.

    Round-off of forces is that of places of 0.1 m, 1e-17 m, times a stiffness of a few MN/m."""
    trace, found = simulate_tangent(build_scene(rig), poses, times, directions(rig, names), settings=settings)
    known, lower = ({p.name: getattr(p, what) for p in list_parameters(rig)} for what in ("value", "lower"))
    for k, name in enumerate(names):
        nearest = {channel: np.full(len(times), np.inf) for channel in found}
        for wide in SHARES:  # narrower ones where an instant is off
            h = wide * (abs(known[name]) or 0.1)
            weights = CENTRAL if known[name] - h >= lower[name] else ONE_SIDED
            ends = [(w, with_parameters(rig, {name: known[name] + shift * h})) for shift, w in weights.items()]
            runs = [(w, simulate(build_scene(end), poses, times, settings=settings).outputs) for w, end in ends]
            for channel, slopes in found.items():
                size, lost = float(np.nanmax(np.abs(slopes[..., k]))), round_off / h
                if lost <= 0.01 * size or wide == SHARES[0]:
                    slope = sum(w * outputs[channel] for w, outputs in runs) / h
                    error = np.abs(slopes[..., k] - slope).reshape(len(times), -1)
                    off = np.nan_to_num(np.max(error, axis=1)) / (share * size + lost)
                    nearest[channel] = np.minimum(nearest[channel], off)
            wrong = {c: float(np.mean(off > 1.0)) for c, off in nearest.items() if np.mean(off > 1.0) > 1.0 - smooth}
            if not wrong:
                break
        assert not wrong, (name, wrong, {c: float(nearest[c].max()) for c in wrong})
    return trace
