"""The simulation of one rig along commanded poses. No ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.errors import ConvergenceError
from thinshell_ros.poses import Floats, Pose, moved, separation, towards
from thinshell_ros.protocol import Command, Settings, Velocity
from thinshell_ros.sampling import Reading, Sampler
from thinshell_ros.streams import Channel, mesh_topic

if TYPE_CHECKING:
    from sim_core.scene.scene import Frame
    from sim_core.solve.step import StepReport

RETRY_S = 0.5
"""Shortest wall time [s] before a command farther along the way that failed is tried."""

RETRY_COST = 4.0
"""A command farther along the way that failed is tried after so many times what the failed attempt took."""


@dataclass(frozen=True)
class Failure:
    """A step that did not converge. ``targets``: of the end effectors, which were at ``poses`` and stay there;
    ``retry_at``: wall time [s] before which another command of the same direction is not tried."""

    words: str
    targets: dict[str, Pose]
    poses: dict[str, Pose]
    retry_at: float

    def over(self, targets: Mapping[str, Pose], now: float) -> bool:
        """Whether commands ``targets`` are worth a try at wall time ``now`` [s]: at once where one of them retreats."""
        for name, target in targets.items():
            start, failed = self.poses[name].position, self.targets[name].position
            if float((target.position - start) @ (failed - start)) < 0.0:
                return True
        changed = any((t.array() != self.targets[name].array()).any() for name, t in targets.items())
        return changed and now >= self.retry_at


class Physics:
    """The simulation, its commanded poses and its readings. ``time``: simulated, never goes back [s].

    ``failure``: the step that did not converge because of which the end effectors are held, None while they move.
    ``behind``: distance and angle that the speed limits keep an end effector from its target [m, rad], the largest.
    """

    def __init__(self, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        from sim_core.commands import CommandChain
        from sim_core.postprocess import lay_out, surfaces
        from sim_core.scene.scene import build_scene
        from sim_core.simulate import Simulation
        from sysid.model.sensor_streams import reported, total_delay

        rig = settings.rig
        self._settings = settings
        self._clock = clock
        self.dt = rig.solver.dt_s
        self._simulation = Simulation(build_scene(rig))
        self._commands = CommandChain(rig)

        def amend(channel: Channel, stamp: float, values: Floats) -> Floats:
            return np.asarray(reported(rig, channel.name, channel.kind, np.array([stamp]), values[None])[0])

        channels = {
            name: c if c.kind in ("pose", "contact", "mesh") else replace(c, latency_s=total_delay(rig, name, c.kind))
            for name, c in settings.channels.items()
        }
        self._sampler = Sampler(channels, settings.seed, amend, self.dt)
        self.ids = dict(self._simulation.observer.ids)
        meshed = any(c.kind == "mesh" for c in settings.channels.values())
        skins = surfaces(lay_out(rig)) if meshed else []
        self._meshes = {mesh_topic(s.body): s.nodes for s in skins if s.nodes is not None}
        self.ids |= {mesh_topic(s.body): s.triangles for s in skins if s.nodes is not None}
        self._steps = 0
        self._kept: tuple[float, Any, Any, dict[str, Pose]] | None = None
        self.rest = self._begin()

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._steps * self.dt

    def _begin(self) -> dict[str, Floats]:
        start = self._simulation.scene.start
        self._poses = {name: _pose(start[name]) for name in self._settings.rig.end_effectors}
        self._targets = dict(self._poses)
        self._commands.begin({n: (p.position, p.rotation()) for n, p in self._poses.items()})
        self._velocities: dict[str, tuple[Velocity, float]] = {}  # until a simulated time
        self.failure: Failure | None = None
        self.behind = (0.0, 0.0)
        readings = self._read()
        self._sampler.restart(self.time, readings)
        return readings

    def _read(self) -> dict[str, Floats]:
        readings = {**{n: p.array() for n, p in self._poses.items()}, **self._simulation.read()}
        if any(c.kind == "contact" for c in self._settings.channels.values()):
            readings |= self._simulation.contact_wrenches()
        readings |= {name: np.asarray(self._simulation.state.x[nodes]) for name, nodes in self._meshes.items()}
        return readings

    def aim(self, command: Command) -> None:
        """Move towards a pose, or with a velocity, in the steps to come."""
        name = command.end_effector
        if isinstance(command, Velocity):
            self._velocities[name] = command, self.time + command.lasts_s
        else:
            self._velocities.pop(name, None)
            self._targets[name] = command.pose

    def _follow_velocities(self) -> None:
        """Targets of end effectors that move with a velocity: where they are to be after a step, or where they are."""
        for name, (velocity, until) in list(self._velocities.items()):
            lasts = self.time < until - 1e-9
            self._targets[name] = self._poses[name]
            if lasts:
                self._targets[name] = moved(self._poses[name], velocity.linear, velocity.angular, self.dt)
            else:
                del self._velocities[name]

    def keep(self) -> None:
        """Keep the state, in place of that which was kept before."""
        self._kept = self.time, self._simulation.snapshot(), self._commands.kept(), dict(self._poses)

    def restore(self) -> float | None:
        """Back to the state that was kept; time goes on. Returns when it was kept [s], None if none was."""
        if self._kept is None:
            return None
        at, state, commands, poses = self._kept
        self._simulation.restore(state)
        self._commands.restore(commands)
        self._poses, self._targets = dict(poses), dict(poses)
        self._velocities, self.failure, self.behind = {}, None, (0.0, 0.0)
        self._sampler.restart(self.time, self._read())
        return at

    def reset(self) -> None:
        """Back to rest at the start poses; time goes on.

        Raises:
            ConvergenceError: no equilibrium was found there.
        """
        self._simulation.reset()
        self.rest = self._begin()

    def step(self) -> tuple[list[Reading], StepReport, int]:
        """Advance by ``dt``: readings that became due, the report, and how many values are not finite.

        Where the step towards the targets does not converge, the end effectors are held where they are, and time goes
        on; the targets are tried again when they change.

        Raises:
            ConvergenceError: no step converged, not even with the end effectors held; the state is that before.
        """
        self._follow_velocities()
        if self.failure is None or self.failure.over(self._targets, self._clock()):
            report = self._try()
        else:
            report = self._advance(self._poses)
        self._steps += 1
        readings = self._read()
        bad = sum(
            int((~np.isfinite(values)).sum())
            for name, values in readings.items()
            if self._settings.channels[name].kind != "tracks"  # a marker out of the picture is no fault
        )
        return self._sampler.advance(self.time, readings), report, bad

    def _try(self) -> StepReport:
        """A step towards the targets, or a failure and a step in place."""
        limits, begin = self._settings, self._clock()
        move, turn = limits.max_speed_m_s * self.dt, limits.max_turn_rate_rad_s * self.dt
        poses = {n: towards(p, self._targets[n], move, turn) for n, p in self._poses.items()}
        try:
            report = self._advance(poses)
        except ConvergenceError as error:
            now = self._clock()
            retry_at = now + max(RETRY_S, RETRY_COST * (now - begin))
            self.failure = Failure(str(error), dict(self._targets), dict(self._poses), retry_at)
            self.behind = (0.0, 0.0)
            return self._advance(self._poses)
        self.failure = None
        self._poses = poses
        distances = [separation(p, self._targets[n]) for n, p in poses.items()]
        self.behind = (max((d for d, _ in distances), default=0.0), max((a for _, a in distances), default=0.0))
        return report

    def _advance(self, poses: Mapping[str, Pose]) -> StepReport:
        """A step in which the end effectors go to ``poses``. Where it fails, the state is that before."""
        commands = self._commands.kept()
        commanded = {n: (p.position, p.rotation()) for n, p in poses.items()}
        try:
            return self._simulation.step(self._commands.advance(commanded, self.dt), self.dt)
        except ConvergenceError:
            self._commands.restore(commands)
            raise


def _pose(frame: Frame) -> Pose:
    origin, rotation = frame
    assert isinstance(rotation, Rotation)
    return Pose(np.array(origin, dtype=np.float64), np.asarray(rotation.as_quat(), dtype=np.float64))
