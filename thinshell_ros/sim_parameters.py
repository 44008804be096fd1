"""Parameters of ``sim_node``."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.node import Node

from sim_core.errors import ConfigError
from thinshell_ros.parameters import declare


@dataclass(frozen=True)
class SimParameters:
    """What the node was started with; lengths [m], angles [rad], times [s], rates [Hz]."""

    rig: str
    base_frame: str
    pose_rate_hz: float
    noise: bool
    seed: int
    max_speed_m_s: float
    max_turn_rate_rad_s: float
    max_jump_m: float
    max_jump_rad: float
    publish_clock: bool
    real_time_factor: float
    command_timeout_s: float
    watchdog_s: float
    contact_forces: bool
    pictures: bool
    mesh_rate_hz: float

    @classmethod
    def declare(cls, node: Node) -> SimParameters:
        """Declare all of them, and ``step_duration_s``, which may be set while the node runs, as the rig may.

        Raises:
            ConfigError: a value does not fit.
        """
        rig = declare(
            node,
            "rig",
            "",
            "rig to simulate: a name or a YAML file; one that is set later counts from ~/reset",
            fixed=False,
        )
        base = declare(node, "base_frame", "", "frame of all poses; empty: the rig's")
        rate = declare(node, "pose_rate_hz", 100.0, "rate of current_pose", bounds=(1.0, 250.0))
        noise = declare(node, "noise", True, "add the noise that the rig states")
        seed = declare(node, "seed", 0, "seed of the noise", bounds=(0, 2**31))
        speed = declare(node, "max_speed_m_s", 0.5, "fastest move to a target", bounds=(1e-4, 10.0))
        turn = declare(node, "max_turn_rate_rad_s", 3.0, "fastest turn to a target", bounds=(1e-3, 100.0))
        jump = declare(node, "max_jump_m", 0.05, "farthest target that is taken", bounds=(1e-6, 10.0))
        tilt = declare(node, "max_jump_rad", 0.5, "largest turn that is taken", bounds=(1e-6, 3.2))
        clock = declare(node, "publish_clock", False, "stamps are simulated time, published on /clock")
        factor = declare(
            node, "real_time_factor", 1.0, "simulated time per wall time; 0: as fast as it can", bounds=(0.0, 100.0)
        )
        timeout = declare(node, "command_timeout_s", 0.5, "age of a stale target", bounds=(0.01, 3600.0))
        patience = declare(node, "watchdog_s", 5.0, "silence after which the physics hangs", bounds=(0.5, 600.0))
        forces = declare(node, "contact_forces", False, "publish force and torque of each declared contact")
        pictures = declare(node, "pictures", False, "publish a picture of the markers that each camera sees")
        mesh = declare(node, "mesh_rate_hz", 0.0, "rate of mesh/BODY, a marker; 0: none", bounds=(0.0, 10.0))
        declare(
            node, "step_duration_s", 0.0, "simulated time of one ~/step; 0: one step", bounds=(0.0, 3600.0), fixed=False
        )
        if factor != 1.0 and not clock:
            raise ConfigError(
                f"The parameter real_time_factor is {factor:g}: stamps cannot follow the wall clock.",
                "Set publish_clock to true, and use_sim_time to true in the nodes that listen.",
            )
        return cls(
            rig,
            base,
            rate,
            noise,
            seed,
            speed,
            turn,
            jump,
            tilt,
            clock,
            factor,
            timeout,
            patience,
            forces,
            pictures,
            mesh,
        )
