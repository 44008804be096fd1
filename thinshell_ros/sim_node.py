"""``sim_node``: the simulator behind ``target_pose``, as if it were the rig.

The physics runs in a process of its own; here are only topics, services and diagnostics.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from sim_core.errors import ConfigError, ThinshellError
from sim_core.rigs import Rig, load_rig
from thinshell_ros import graph, messages, protocol
from thinshell_ros.health import Announcer, CommandLog, Level, physics_report, topics_report
from thinshell_ros.outputs import Outputs
from thinshell_ros.parameters import value_of, warn_of_unknown
from thinshell_ros.poses import Floats, Pose, PoseGate, unstamped, velocity_fault
from thinshell_ros.qos import LATEST, overridable
from thinshell_ros.runner import run
from thinshell_ros.sim_parameters import SimParameters
from thinshell_ros.streams import Channel, channels_of, twist_topic
from thinshell_ros.supervisor import Supervisor

IDLE_S = 0.25
"""Longest time [s] after which the node looks at its physics again: an answer of that wakes it at once."""

LOG_S = 5.0
"""Shortest time [s] between two lines of the log of the same kind."""


class SimNode(Node):
    """Takes commanded poses and velocities, publishes what the rig's sensors and cameras read."""

    def __init__(self) -> None:
        super().__init__("thinshell_sim")
        given = SimParameters.declare(self)
        warn_of_unknown(self)
        self._factor, self._gives_clock = given.real_time_factor, given.publish_clock
        self._rig = load_rig(given.rig)
        channels = self._channels_of(self._rig, given)
        self._channels = channels
        effectors = self._rig.end_effectors
        self._gates = {n: PoseGate(channels[n].frame_id, given.max_jump_m, given.max_jump_rad) for n in effectors}
        self._poses: dict[str, Pose] = {}
        self._targets: dict[str, Pose] = {}
        self._log = CommandLog(given.command_timeout_s)
        self._announcer = Announcer()
        self._outputs = Outputs(self, self._rig, channels, given.publish_clock, self._factor, given.pictures)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._published = [c.topic for c in channels.values()]
        self._commanded = [effector.topics.target_pose for effector in effectors.values()]
        for name, topic in zip(effectors, self._commanded, strict=True):
            take = partial(self._on_target, name)
            self.create_subscription(PoseStamped, topic, callback=take, **overridable(LATEST))
            turn = partial(self._on_twist, name)
            twists = twist_topic(topic)
            self.create_subscription(TwistStamped, twists, callback=turn, **overridable(LATEST))
        apart = ReentrantCallbackGroup()  # a service that waits for its answer must not hold up the timers
        self.create_service(Trigger, "~/reset", self._on_reset, callback_group=apart)
        self.create_service(Trigger, "~/snapshot", self._on_snapshot, callback_group=apart)
        self.create_service(Trigger, "~/restore", self._on_restore, callback_group=apart)
        self.create_service(Trigger, "~/zero", self._on_zero, callback_group=apart)
        self.create_service(Trigger, "~/step", self._on_step, callback_group=apart)
        self.create_service(SetBool, "~/pause", self._on_pause, callback_group=apart)
        arrived = self.create_guard_condition(self._on_poll)
        seed = given.seed if given.noise else None
        self._fastest = given.max_speed_m_s, given.max_turn_rate_rad_s
        self._given = given
        self._settings = protocol.Settings(
            self._rig, channels, seed, *self._fastest, self._factor, not given.publish_clock
        )
        self._physics = Supervisor(self._settings, given.watchdog_s, arrived.trigger)
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(IDLE_S, self._on_poll, clock=wall)
        self.create_timer(1.0, self._on_diagnostics, clock=wall)

    @staticmethod
    def _channels_of(rig: Rig, given: SimParameters) -> dict[str, Channel]:
        return channels_of(rig, given.pose_rate_hz, given.base_frame, given.contact_forces, given.mesh_rate_hz)

    def _on_target(self, name: str, message: PoseStamped) -> None:
        if not self._physics.ready:
            self._reject("the scene is still being built")
            return
        p, q = message.pose.position, message.pose.orientation
        frame, near = message.header.frame_id, (self._poses[name], self._targets.get(name))
        stamp = message.header.stamp
        pose = unstamped(stamp.sec + 1e-9 * stamp.nanosec) or self._gates[name].check(
            frame, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w), *near
        )
        if isinstance(pose, str):
            self._reject(f"{name}: {pose}")
        else:
            self._targets[name] = pose
            self._log.accept(name, time.monotonic())
            self._physics.aim(protocol.Target(name, pose))

    def _on_twist(self, name: str, message: TwistStamped) -> None:
        if not self._physics.ready:
            self._reject("the scene is still being built")
            return
        v, w, stamp = message.twist.linear, message.twist.angular, message.header.stamp
        linear, angular = (v.x, v.y, v.z), (w.x, w.y, w.z)
        frames = message.header.frame_id, self._gates[name].base_frame
        fault = unstamped(stamp.sec + 1e-9 * stamp.nanosec) or velocity_fault(frames, linear, angular, self._fastest)
        if fault:
            self._reject(f"{name}: {fault}")
            return
        self._targets.pop(name, None)
        self._log.accept(name, time.monotonic())
        lasts = self._given.command_timeout_s
        self._physics.aim(protocol.Velocity(name, np.array(linear), np.array(angular), lasts))

    def _reject(self, reason: str) -> None:
        self._log.reject(reason)
        self.get_logger().warning(f"A target was rejected: {reason}.", throttle_duration_sec=LOG_S)

    def _on_poll(self) -> None:
        status = self._physics.status
        for arrival, answer in self._physics.responses():
            if isinstance(answer, protocol.Batch):
                at_once = status is not None and status.paused
                if (left_out := self._outputs.take(answer, arrival, at_once)) > LOG_S:
                    self.get_logger().warning(f"The simulation keeps up again; stamps leave out {left_out:.1f} s.")
                self._follow({r.channel: r.values for r in answer.readings})
            elif isinstance(answer, protocol.Status):
                status = answer
            elif isinstance(answer, protocol.Ready):
                self._outputs.begin(answer)
                self._restart(answer.rest)
                self.get_logger().info(f"Simulating {self._rig.name}.")
            elif answer.rest:
                self._outputs.restart(answer.rest)
                self._restart(answer.rest)
        running = status is not None and not (status.paused or status.trouble)
        now = time.monotonic()
        self._outputs.publish(now, running)
        # Each time that the executor wakes costs a millisecond of work with this many topics and services.
        self._timer.timer_period_ns = round(1e9 * min(self._outputs.due_in_s(now, running), IDLE_S))
        self._timer.reset()

    def _restart(self, rest: dict[str, Floats]) -> None:
        self._targets.clear()
        self._follow(rest)

    def _follow(self, readings: dict[str, Floats]) -> None:
        """Remember where the end effectors are."""
        for name in readings.keys() & self._gates.keys():
            self._poses[name] = Pose.of(np.array(readings[name]))

    def _on_diagnostics(self) -> None:
        physics, status, name = self._physics, self._physics.review(), self.get_fully_qualified_name()
        reports = [
            physics_report(status, physics.fault(), physics.pid, self._factor, physics.silent_s),
            self._log.report(time.monotonic(), status, graph.most_publishers(self, self._commanded)),
            topics_report(graph.other_publishers(self, self._published)),
        ]
        self._diagnostics.publish(messages.diagnostics(time.time_ns(), name, self._rig.name, reports))
        for report in reports:
            if (physics.ready or physics.fault()) and self._announcer.is_news(report, time.monotonic()):
                self._say(f"{report.name}: {report.message}", report.level)

    def _say(self, words: str, level: Level) -> None:
        """Log; a line of code may log with one severity only."""
        if level == "error":
            self.get_logger().error(words)
        elif level == "warn":
            self.get_logger().warning(words)
        else:
            self.get_logger().info(words)

    async def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        try:
            other = self._other_rig()
        except ThinshellError as error:
            response.success, response.message = False, str(error)
            return response
        if other is not None:
            self._take_rig(*other)
            response.success, response.message = True, f"The scene of {self._rig.name} is being built."
            return response
        done = await self._answer(self._physics.reset)
        if not done.success and self._physics.fault():
            done = await self._answer(self._physics.reset)  # it hangs, and is started again
        response.success, response.message = done.success, done.message
        return response

    def _other_rig(self) -> tuple[Rig, dict[str, Channel]] | None:
        """The rig that the parameter names now, where that is another than the one that is simulated.

        Raises:
            ThinshellError: it cannot be read, or has other topics.
        """
        rig = load_rig(value_of(self, "rig"))
        if rig == self._rig:
            return None
        given = self._given
        channels = self._channels_of(rig, given)

        def seen(of: Rig, by: Mapping[str, Channel]) -> object:
            commanded = {name: effector.topics.target_pose for name, effector in of.end_effectors.items()}
            return commanded, {name: (c.kind, c.topic, c.frame_id) for name, c in by.items()}

        if seen(rig, channels) != seen(self._rig, self._channels):
            raise ConfigError(
                f"The rig {rig.name!r} has other end effectors, sensors, cameras, topics or frames than the one that "
                "is simulated.",
                "Start another node for it, or set rig back.",
            )
        return rig, channels

    def _take_rig(self, rig: Rig, channels: dict[str, Channel]) -> None:
        """Simulate another rig from now on."""
        self._rig, self._channels = rig, channels
        self._settings = replace(self._settings, rig=rig, channels=channels)
        self._outputs.use(rig, channels)
        self._physics.restart(self._settings)

    async def _on_snapshot(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        done = await self._answer(self._physics.keep)
        response.success, response.message = done.success, done.message
        return response

    async def _on_restore(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        done = await self._answer(self._physics.restore)
        if done.success:
            self._targets.clear()
            self._outputs.flush()
            self._outputs.tell("restore", f"The simulation is {done.message}.")
        response.success, response.message = done.success, done.message
        return response

    async def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        done = await self._answer(partial(self._physics.pause, request.data))
        response.success, response.message = done.success, done.message
        return response

    async def _on_step(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        if not self._gives_clock:
            response.success, response.message = False, "steps on demand need simulated time: set publish_clock to true"
            return response
        done = await self._answer(partial(self._physics.step, value_of(self, "step_duration_s")))
        response.success, response.message = done.success, done.message
        return response

    async def _answer(self, ask: Any) -> protocol.Done:
        """Pass a request on and wait for the answer, while the node goes on."""
        future: Future = Future()
        ask(future)
        done: protocol.Done = await future
        return done

    def _on_zero(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        if not self._physics.ready:
            response.success, response.message = False, "the scene is still being built"
            return response
        if fault := self._physics.fault():
            response.success, response.message = False, f"{fault} Call ~/reset to start it again."
            return response
        missing = self._outputs.zero()
        response.success = not missing
        response.message = f"no reading yet of {', '.join(missing)}" if missing else "zeroed"
        return response

    def destroy_node(self) -> None:
        """Stop the physics process, then the node."""
        if hasattr(self, "_physics"):
            self._physics.stop()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(SimNode, args)


if __name__ == "__main__":
    sys.exit(main())
