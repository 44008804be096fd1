"""``sim_node``: the simulator behind ``target_pose``, as if it were the rig.

The physics runs in a process of its own; here are only topics, services and diagnostics.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from sim_core.rigs import load_rig
from thinshell_ros import messages, physics
from thinshell_ros.health import CommandLog, physics_report
from thinshell_ros.outputs import Outputs
from thinshell_ros.parameters import declare, warn_of_unknown
from thinshell_ros.poses import Floats, Pose, PoseGate
from thinshell_ros.qos import LATEST
from thinshell_ros.runner import run
from thinshell_ros.streams import channels_of
from thinshell_ros.worker import Worker


class SimNode(Node):
    """Takes commanded poses, publishes what the rig's sensors and cameras read."""

    def __init__(self) -> None:
        super().__init__("thinshell_sim")
        rig_name = declare(self, "rig", "", "rig to simulate: a name or a YAML file")
        base = declare(self, "base_frame", "", "frame of all poses; empty: the rig's")
        rate = declare(self, "pose_rate_hz", 100.0, "rate of current_pose", bounds=(1.0, 250.0))
        noise = declare(self, "noise", True, "add the noise that the rig states")
        seed = declare(self, "seed", 0, "seed of the noise", bounds=(0, 2**31))
        speed = declare(self, "max_speed_m_s", 0.5, "fastest move to a target", bounds=(1e-4, 10.0))
        turn = declare(self, "max_turn_rate_rad_s", 3.0, "fastest turn to a target", bounds=(1e-3, 100.0))
        jump = declare(self, "max_jump_m", 0.05, "farthest target that is taken", bounds=(1e-6, 10.0))
        tilt = declare(self, "max_jump_rad", 0.5, "largest turn that is taken", bounds=(1e-6, 3.2))
        give_clock = declare(self, "publish_clock", False, "publish simulated time on /clock")
        warn_of_unknown(self)

        self._rig = load_rig(rig_name)
        channels = channels_of(self._rig, rate, base)
        effectors = self._rig.end_effectors
        self._gates = {name: PoseGate(channels[name].frame_id, jump, tilt) for name in effectors}
        self._poses: dict[str, Pose] = {}
        self._log = CommandLog()
        self._status: physics.Status | None = None
        self._waiting: dict[int, Future] = {}
        self._outputs = Outputs(self, self._rig, channels, give_clock)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        for name, effector in effectors.items():
            self.create_subscription(
                PoseStamped,
                effector.topics.target_pose,
                partial(self._on_target, name),
                LATEST,
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )
        apart = ReentrantCallbackGroup()  # a service that waits for its answer must not hold up the timers
        self.create_service(Trigger, "~/reset", self._on_reset, callback_group=apart)
        self.create_service(Trigger, "~/zero", self._on_zero, callback_group=apart)
        self.create_service(SetBool, "~/pause", self._on_pause, callback_group=apart)
        self._ready = False
        self._ended = ""
        self._worker = Worker(
            physics.Settings(self._rig, channels, seed if noise else None, speed, turn),
        )
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(min(max(self._rig.solver.dt_s / 2.0, 0.004), 0.01), self._on_poll, clock=wall)
        self.create_timer(1.0, self._on_diagnostics, clock=wall)

    def _on_target(self, name: str, message: PoseStamped) -> None:
        if not self._ready:
            self._log.reject("the scene is still being built")
            return
        p, q = message.pose.position, message.pose.orientation
        frame, now = message.header.frame_id, self._poses[name]
        pose = self._gates[name].check(frame, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w), now)
        if isinstance(pose, str):
            self._log.reject(f"{name}: {pose}")
        else:
            self._log.accept(time.monotonic())
            self._worker.aim(physics.Target(name, pose))

    def _on_poll(self) -> None:
        for answer in self._worker.answers():
            if isinstance(answer, physics.Batch):
                self._outputs.publish(answer)
                self._follow({r.channel: r.values for r in answer.readings})
            elif isinstance(answer, physics.Status):
                if answer.trouble and (self._status is None or answer.trouble != self._status.trouble):
                    self.get_logger().error(answer.trouble)
                self._status = answer
            elif isinstance(answer, physics.Done):
                if answer.rest:
                    self._outputs.restart(answer.rest)
                    self._follow(answer.rest)
                self._waiting.pop(answer.number).set_result(answer)
            else:
                self._outputs.begin(answer)
                self._follow(answer.rest)
                self._ready = True
                self.get_logger().info(f"Simulating {self._rig.name}.")

    def _follow(self, readings: dict[str, Floats]) -> None:
        """Remember where the end effectors are."""
        for name in readings.keys() & self._gates.keys():
            self._poses[name] = Pose.of(np.array(readings[name]))

    def _on_diagnostics(self) -> None:
        ended = self._worker.end()
        if ended and ended != self._ended:
            self.get_logger().error(ended)
        self._ended = ended
        if ended:
            for future in self._waiting.values():
                future.set_result(physics.Done(0, False, ended))
            self._waiting.clear()
        reports = [
            physics_report(self._status, ended, self._worker.pid),
            self._log.report(time.monotonic()),
        ]
        name = self.get_fully_qualified_name()
        self._diagnostics.publish(messages.diagnostics(time.time_ns(), name, self._rig.name, reports))

    async def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        if self._worker.end():
            self._ready, self._status = False, None
            self._worker.start()
            response.success, response.message = True, "the physics process is being started again"
            return response
        return await self._answer(self._worker.reset, response)

    async def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        return await self._answer(partial(self._worker.pause, request.data), response)

    async def _answer(self, ask: Any, response: Any) -> Any:
        """Pass a request on and wait for the answer, while the node goes on."""
        if not self._ready or self._worker.end():
            response.success, response.message = False, "the physics process is not ready"
            return response
        future: Future = Future()
        self._waiting[ask()] = future
        done = await future
        response.success, response.message = done.success, done.message
        return response

    def _on_zero(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        if not self._ready:
            response.success, response.message = False, "the physics process is not ready"
            return response
        missing = self._outputs.zero()
        response.success = not missing
        response.message = f"no reading yet of {', '.join(missing)}" if missing else "zeroed"
        return response

    def destroy_node(self) -> None:
        """Stop the physics process, then the node."""
        if hasattr(self, "_worker"):
            self._worker.stop()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(SimNode, args)


if __name__ == "__main__":
    sys.exit(main())
