"""What the node and the physics process say to each other. No ROS."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sim_core.rigs import Rig
from thinshell_ros.poses import Floats, Pose
from thinshell_ros.sampling import Reading
from thinshell_ros.streams import Channel

BACK = "back at the start"
"""What a reset says when it is done."""


@dataclass(frozen=True)
class Settings:
    """What the process needs to know. ``seed``: of the noise, None for none. ``real_time_factor``: wanted simulated
    time per wall time, 0 for as fast as it can; ``catches_up``: what a slow spell has cost is caught up, or left out,
    so that stamps follow the wall clock."""

    rig: Rig
    channels: dict[str, Channel]
    seed: int | None
    max_speed_m_s: float
    max_turn_rate_rad_s: float
    real_time_factor: float = 1.0
    catches_up: bool = True


@dataclass(frozen=True)
class Target:
    """Request: move an end effector towards a pose."""

    end_effector: str
    pose: Pose


@dataclass(frozen=True)
class Velocity:
    """Request: move an end effector with a velocity [m/s] ``(3,)`` and an angular velocity [rad/s] ``(3,)`` in the base
    frame for ``lasts_s`` [s] of simulated time, then hold."""

    end_effector: str
    linear: Floats
    angular: Floats
    lasts_s: float


@dataclass(frozen=True)
class Reset:
    """Request, answered by ``Done``: back to the start."""

    number: int


@dataclass(frozen=True)
class Keep:
    """Request, answered by ``Done``: keep the state in place of that which was kept before."""

    number: int


@dataclass(frozen=True)
class Restore:
    """Request, answered by ``Done``: back to the state that was kept."""

    number: int


@dataclass(frozen=True)
class Pause:
    """Request, answered by ``Done``: stop or go on."""

    number: int
    paused: bool


@dataclass(frozen=True)
class Step:
    """Request, answered by ``Done`` after the readings: while paused, advance by the whole steps that ``duration_s``
    [s] takes, one at least."""

    number: int
    duration_s: float


@dataclass(frozen=True)
class Stop:
    """Request: end the process."""


Command = Target | Velocity
Request = Command | Reset | Keep | Restore | Pause | Step | Stop


@dataclass(frozen=True)
class Ready:
    """The scene stands. ``ids``: numbers of markers, and of the corners of the triangles of meshes ``(m, 3)``;
    ``rest``: readings at the start, without noise."""

    ids: dict[str, np.ndarray]
    rest: dict[str, Floats]


@dataclass(frozen=True)
class Done:
    """Answer to a request. ``rest``: new readings at the start after a reset."""

    number: int
    success: bool
    message: str
    rest: dict[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class Status:
    """How the simulation is doing. Numbers are over the steps since the last status.

    ``trouble``: why it stands still, or why the end effectors are held, '' if neither; ``ended``: whether its process
    ends of that. ``lag_s``: wall time by which simulated time is behind [s]; ``behind_m`` and ``behind_rad``: how far
    the speed limits keep an end effector from its target [m, rad]; ``residual_n``: largest at the end of a step [N].
    """

    paused: bool
    trouble: str
    simulated_s: float
    real_time_factor: float
    steps: int = 0
    iterations: int = 0
    residual_n: float = 0.0
    contacts: int = 0
    min_gap_m: float = float("inf")
    not_finite: int = 0
    lag_s: float = 0.0
    behind_m: float = 0.0
    behind_rad: float = 0.0
    ended: bool = False

    def including(self, earlier: Status) -> Status:
        """This status, its numbers over the steps of an earlier one too."""
        return replace(
            self,
            steps=earlier.steps + self.steps,
            iterations=max(earlier.iterations, self.iterations),
            residual_n=max(earlier.residual_n, self.residual_n),
            min_gap_m=min(earlier.min_gap_m, self.min_gap_m),
            not_finite=earlier.not_finite + self.not_finite,
            behind_m=max(earlier.behind_m, self.behind_m),
            behind_rad=max(earlier.behind_rad, self.behind_rad),
        )


@dataclass(frozen=True)
class Batch:
    """Readings that became due in a step that ended at ``simulated_s`` [s]. ``skipped_s``: wall time that simulated
    time has left out since the start [s]."""

    simulated_s: float
    readings: list[Reading]
    skipped_s: float = 0.0


Answer = Ready | Done | Status | Batch
