"""What a hand may do: speed, acceleration, jerk, workspace, force. One definition, which rigs, trajectories and replays
share."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from sim_core.rigs.fields import Strict, Vector, trouble

Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]
Lag = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=10.0)]

JERK_S = 0.01
"""Time [s] over which a jerk is taken: the change of the acceleration within it, over it. It is the period of a usual
stream of commands; what changes faster is left to the interpolation of the robot's own controller."""


class Limits(Strict):
    """What must never be exceeded; what is left out is not limited here.

    The box is that of the origins of end effectors in the base frame. Speeds, accelerations and jerks are those of each
    of them (a jerk: :data:`JERK_S`). Force and torque are magnitudes at each sensor.
    """

    workspace_min_m: Vector | None = Field(default=None, description="lower corner of the workspace, in the base frame")
    workspace_max_m: Vector | None = Field(default=None, description="upper corner of the workspace, in the base frame")
    max_speed_m_s: Positive | None = Field(default=None, description="largest speed")
    max_acceleration_m_s2: Positive | None = Field(default=None, description="largest acceleration")
    max_jerk_m_s3: Positive | None = Field(default=None, description="largest change of the acceleration per time")
    max_angular_speed_rad_s: Positive | None = Field(default=None, description="largest angular speed")
    max_angular_acceleration_rad_s2: Positive | None = Field(default=None, description="largest angular acceleration")
    max_angular_jerk_rad_s3: Positive | None = Field(
        default=None, description="largest change of the angular acceleration per time"
    )
    max_force_n: Positive | None = Field(default=None, description="largest force at a sensor")
    max_torque_nm: Positive | None = Field(default=None, description="largest torque at a sensor")

    @model_validator(mode="after")
    def _box(self) -> Limits:
        low, high = self.workspace_min_m, self.workspace_max_m
        if low is not None and high is not None and not all(a < b for a, b in zip(low, high, strict=True)):
            raise trouble(
                f"is {list(low)}, which is not below workspace_max_m {list(high)}.",
                "Write the corner with the smaller coordinates.",
                "workspace_min_m",
            )
        return self

    def stricter(self, other: Limits) -> Limits:
        """The stricter of two limits, each by itself."""

        def one(name: str) -> Any:
            values = [v for v in (getattr(self, name), getattr(other, name)) if v is not None]
            if not values or not isinstance(values[0], tuple):
                return min(values, default=None)
            pick = max if name == "workspace_min_m" else min
            return tuple(pick(*pair) for pair in zip(*values, strict=True)) if len(values) == 2 else values[0]

        return Limits.model_construct(**{name: one(name) for name in Limits.model_fields})


class HandLimits(Limits):
    """The limits of a hand, and how well it follows its commands.

    Where a rig says nothing, speeds, accelerations and jerks are those of a common lab arm (Franka Emika, Panda, limits
    in the Cartesian space: 1.7 m/s, 13 m/s^2, 6500 m/s^3; 2.5 rad/s, 25 rad/s^2, 12500 rad/s^3), and force and torque
    are 10 N and 1 N m.
    """

    max_speed_m_s: Positive = Field(default=1.7, description="largest speed")
    max_acceleration_m_s2: Positive = Field(default=13.0, description="largest acceleration")
    max_jerk_m_s3: Positive = Field(default=6500.0, description="largest change of the acceleration per time")
    max_angular_speed_rad_s: Positive = Field(default=2.5, description="largest angular speed")
    max_angular_acceleration_rad_s2: Positive = Field(default=25.0, description="largest angular acceleration")
    max_angular_jerk_rad_s3: Positive = Field(
        default=12500.0, description="largest change of the angular acceleration per time"
    )
    max_force_n: Positive = Field(default=10.0, description="largest force at a sensor that it carries")
    max_torque_nm: Positive = Field(default=1.0, description="largest torque at a sensor that it carries")
    accuracy_m: Positive = Field(default=5e-4, description="how near to a commanded path it stays, in m")
    accuracy_rad: Positive = Field(default=5e-3, description="how near to a commanded orientation it stays, in rad")
    max_lag_s: Lag = Field(default=0.1, description="how far it may be behind its commands, in s")

    def limits(self) -> Limits:
        """The limits alone."""
        return Limits.model_construct(**{name: getattr(self, name) for name in Limits.model_fields})
