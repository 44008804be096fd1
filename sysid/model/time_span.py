"""How far a recording is simulated, and which of its readings are then compared.

Readings of a stream that leads the poses (a negative delay) show what the end effectors do later. A window of a
recording ends before its poses do, so the rollout goes on as far as its last readings show, where there are poses.
What is shown later than the poses tell is not compared.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.simulate import step_times
from sysid.model.sensor_streams import total_delay
from sysid.noise.stillness import moving
from sysid.observations.observations import Measured, Run
from sysid.settings.model import MODEL


def rollout_times(rigs: Sequence[Rig], run: Run, dt: float) -> np.ndarray:
    """Instants of the steps [s], at most ``dt`` apart, that tell the readings of ``run`` by any of ``rigs``. Those
    until the end of the run do not depend on the rigs. Where a run has steps of its own, these are divided as ``dt``
    divides the rig's."""
    ends = (m.t[-1] - total_delay(rig, m.channel, m.kind) for rig in rigs for m in run.measured)
    shown = max(ends, default=run.end)
    further = min(shown, known_until(rigs[0], run)) - run.end
    count = max(0, int(np.ceil(further / dt - 1e-9)))
    own = step_times(0.0, run.end, dt) if run.steps is None else _divided(run.steps, round(rigs[0].solver.dt_s / dt))
    return np.concatenate([own, run.end + dt * np.arange(1, count + 1)])


def _divided(steps: np.ndarray, parts: int) -> np.ndarray:
    """Every interval in equal parts."""
    whole = np.arange(parts * (len(steps) - 1) + 1) / parts
    return np.asarray(np.interp(whole, np.arange(len(steps)), steps))


def after_known_motion(rig: Rig, run: Run, measured: Measured) -> np.ndarray:
    """Which readings of a channel show the motion later than it is known ``(n,)``."""
    return np.asarray(measured.t - total_delay(rig, measured.channel, measured.kind) > known_until(rig, run) + 1e-9)


def known_until(rig: Rig, run: Run) -> float:
    """Until when the motion of all end effectors is known [s], at least to the end of the run."""
    ends = [
        float(p.times[-1]) + (0.0 if _ends_in_motion(p) else rig.end_effectors[name].topics.max_gap_s)
        for name, p in run.poses.items()
        if len(p.times) > 1
    ]
    return max(run.end, min(ends, default=np.inf))


def _ends_in_motion(trajectory: PoseTrajectory) -> bool:
    t = trajectory.times
    first = max(0, min(int(np.searchsorted(t, t[-1] - MODEL.last_poses_s)), len(t) - 2))
    last = trajectory.part(slice(first, None))
    return any(end > t[-1] - MODEL.still_end_s for _, end in moving(last))
