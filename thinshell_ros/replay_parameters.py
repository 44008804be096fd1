"""Parameters of ``replay_node``. All are read when it is configured and may be set before that."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter

from sim_core.errors import ConfigError
from sim_core.rigs.yamlfile import validate
from sim_core.trajectories import Limits
from thinshell_ros.parameters import declare, value_of
from thinshell_ros.replay.guard import GuardSettings

LIMITS = (
    "max_speed_m_s", "max_acceleration_m_s2", "max_jerk_m_s3", "max_angular_speed_rad_s",
    "max_angular_acceleration_rad_s2", "max_angular_jerk_rad_s3", "max_force_n", "max_torque_nm",
)  # fmt: skip
DERIVED = ("tracking_tolerance_m", "tracking_tolerance_rad", "max_lag_s")
GUARDS = (
    "start_tolerance_m", "start_tolerance_rad", "pose_timeout_s", "wrench_timeout_s", "marker_timeout_s",
    "clock_tolerance_s", "check_stamps",
)  # fmt: skip


def declare_all(node: Node) -> None:
    """Declare the parameters of a node.

    Raises:
        ConfigError: a value does not fit.
    """
    own = False  # each may be set until the node is configured
    declare(node, "trajectory_uri", "", "trajectory file; empty: the last message on ~/trajectory", fixed=own)
    declare(node, "rig", "", "rig that the trajectory must fit; empty: none", fixed=own)
    declare(node, "dry_run", True, "command nothing, and say what would be commanded", fixed=own)
    declare(node, "speed_scale", 1.0, "share of the planned speed", bounds=(0.001, 1.0), fixed=own)
    declare(node, "control_rate_hz", 100.0, "rate of target poses", bounds=(10.0, 1000.0), fixed=own)
    box = Parameter.Type.DOUBLE_ARRAY
    declare(node, "workspace_min_m", box, "lower corner of the box for the end effectors", fixed=own)
    declare(node, "workspace_max_m", box, "upper corner", fixed=own)
    some, none = (0.0, 1e6), "0: none besides the limits of the hand and of the trajectory"
    declare(node, "max_speed_m_s", 0.0, f"fastest motion; {none}", bounds=some, fixed=own)
    declare(node, "max_acceleration_m_s2", 0.0, f"largest acceleration; {none}", bounds=some, fixed=own)
    declare(node, "max_jerk_m_s3", 0.0, f"largest jerk; {none}", bounds=some, fixed=own)
    declare(node, "max_angular_speed_rad_s", 0.0, f"fastest turn; {none}", bounds=some, fixed=own)
    declare(node, "max_angular_acceleration_rad_s2", 0.0, f"largest one; {none}", bounds=some, fixed=own)
    declare(node, "max_angular_jerk_rad_s3", 0.0, f"largest one; {none}", bounds=some, fixed=own)
    declare(node, "max_force_n", 0.0, f"largest force on a sensor; {none}", bounds=some, fixed=own)
    declare(node, "max_torque_nm", 0.0, f"largest torque on a sensor; {none}", bounds=some, fixed=own)
    default = "0: as the trajectory says"
    declare(node, "tracking_tolerance_m", 0.0, f"from the commanded path; {default}", bounds=(0.0, 1.0), fixed=own)
    declare(node, "tracking_tolerance_rad", 0.0, f"likewise; {default}", bounds=(0.0, 3.0), fixed=own)
    declare(node, "max_lag_s", 0.0, f"how far a robot may be behind; {default}", bounds=(0.0, 10.0), fixed=own)
    declare(node, "guard_wrench", True, "refuse to move without a measured wrench", fixed=own)
    declare(node, "guard_markers", True, "refuse to move without the markers that are predicted", fixed=own)
    declare(node, "watch_aborts", False, "end a replay when readings part from the prediction", fixed=own)
    declare(node, "start_tolerance_m", 0.002, "from the first to the measured pose", bounds=(1e-5, 1.0), fixed=own)
    declare(node, "start_tolerance_rad", 0.02, "likewise", bounds=(1e-4, 3.0), fixed=own)
    declare(node, "pose_timeout_s", 0.1, "oldest measured pose", bounds=(0.001, 10.0), fixed=own)
    declare(node, "wrench_timeout_s", 0.1, "oldest measured wrench", bounds=(0.001, 10.0), fixed=own)
    declare(node, "marker_timeout_s", 0.1, "oldest measured markers", bounds=(0.001, 10.0), fixed=own)
    declare(node, "clock_tolerance_s", 0.1, "largest jump of the ROS clock", bounds=(0.001, 10.0), fixed=own)
    declare(node, "check_stamps", True, "stamps count for the age of readings, not their arrival alone", fixed=own)
    declare(node, "record", True, "record while the node is active", fixed=own)
    declare(node, "record_uri", "", "bag to create; empty: replay_<date>_<time> in the working folder", fixed=own)


@dataclass(frozen=True)
class ReplayParameters:
    """What a replay is configured with."""

    trajectory_uri: str
    rig: str
    speed_scale: float
    guard_wrench: bool
    guard_markers: bool
    watch_aborts: bool
    record: bool
    record_uri: str
    guard: GuardSettings

    @classmethod
    def read(cls, node: Node) -> ReplayParameters:
        """The values now.

        Raises:
            ConfigError: the workspace box is none.
        """
        given = {name: value_of(node, name) or None for name in LIMITS}
        for name in ("workspace_min_m", "workspace_max_m"):
            corner = value_of(node, name)
            given[name] = list(corner) if corner else None
        limits = validate(Limits, given, "The parameters")
        dry = value_of(node, "dry_run")
        values: dict[str, Any] = {name: value_of(node, name) or None for name in DERIVED}
        values |= {name: value_of(node, name) for name in GUARDS}
        guard = replace(
            GuardSettings(limits, moves=not dry, simulated_time=bool(value_of(node, "use_sim_time"))),
            period_s=1.0 / value_of(node, "control_rate_hz"),
            **values,
        )
        if guard.pose_timeout_s < guard.period_s:
            raise ConfigError(
                f"pose_timeout_s is {guard.pose_timeout_s:g}, below the control period of {guard.period_s:g} s.",
                "Allow at least one period.",
            )
        plain = [field.name for field in fields(cls) if field.name != "guard"]
        return cls(**{name: value_of(node, name) for name in plain}, guard=guard)
