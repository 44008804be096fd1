"""The simulation of one rig along commanded poses, and the process that it runs in. No ROS."""

from __future__ import annotations

import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.errors import ConvergenceError, ThinshellError
from sim_core.rigs import Rig
from thinshell_ros.pacing import Pacer
from thinshell_ros.poses import Floats, Pose, towards
from thinshell_ros.sampling import Reading, Sampler
from thinshell_ros.streams import Channel

if TYPE_CHECKING:
    from sim_core.scene.scene import Frame
    from sim_core.solve.step import StepReport

STATUS_PERIOD_S = 0.25
"""Wall time between two statuses."""


@dataclass(frozen=True)
class Settings:
    """What the process needs to know. ``seed``: of the noise, None for none."""

    rig: Rig
    channels: dict[str, Channel]
    seed: int | None
    max_speed_m_s: float
    max_turn_rate_rad_s: float


@dataclass(frozen=True)
class Target:
    """Request: move an end effector towards a pose."""

    end_effector: str
    pose: Pose


@dataclass(frozen=True)
class Reset:
    """Request, answered by ``Done``: back to the start."""

    number: int


@dataclass(frozen=True)
class Pause:
    """Request, answered by ``Done``: stop or go on."""

    number: int
    paused: bool


@dataclass(frozen=True)
class Stop:
    """Request: end the process."""


@dataclass(frozen=True)
class Ready:
    """The scene stands. ``ids``: numbers of markers; ``rest``: readings at the start, without noise."""

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

    ``trouble``: why it stands still, '' if it does not. ``residual_n``: largest at the end of a step [N].
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


@dataclass(frozen=True)
class Batch:
    """Readings that became due in a step that ended at ``simulated_s`` [s]."""

    simulated_s: float
    readings: list[Reading]


Answer = Ready | Done | Status | Batch


class Physics:
    """The simulation, its commanded poses and its readings. ``time``: simulated, never goes back [s]."""

    def __init__(self, settings: Settings) -> None:
        from sim_core.commands import CommandChain
        from sim_core.scene.scene import build_scene
        from sim_core.simulate import Simulation
        from sysid.model.sensor_streams import reported, total_delay

        rig = settings.rig
        self._settings = settings
        self.dt = rig.solver.dt_s
        self._simulation = Simulation(build_scene(rig))
        self._commands = CommandChain(rig)

        def amend(channel: Channel, stamp: float, values: Floats) -> Floats:
            return np.asarray(reported(rig, channel.name, channel.kind, np.array([stamp]), values[None])[0])

        channels = {
            name: c if c.kind == "pose" else replace(c, latency_s=total_delay(rig, name, c.kind))
            for name, c in settings.channels.items()
        }
        self._sampler = Sampler(channels, settings.seed, amend)
        self.ids = dict(self._simulation.observer.ids)
        self.time = 0.0
        self.rest = self._begin()

    def _begin(self) -> dict[str, Floats]:
        start = self._simulation.scene.start
        self._poses = {name: _pose(start[name]) for name in self._settings.rig.end_effectors}
        self._targets = dict(self._poses)
        self._commands.begin({n: (p.position, p.rotation()) for n, p in self._poses.items()})
        readings = self._read()
        self._sampler.restart(self.time, readings)
        return readings

    def _read(self) -> dict[str, Floats]:
        return {**{n: p.array() for n, p in self._poses.items()}, **self._simulation.read()}

    def aim(self, target: Target) -> None:
        """Move towards a pose in the steps to come."""
        self._targets[target.end_effector] = target.pose

    def reset(self) -> None:
        """Back to rest at the start poses; time goes on.

        Raises:
            ConvergenceError: no equilibrium was found there.
        """
        self._simulation.scene.system.deflections[:] = 0.0
        self._simulation.reset()
        self.rest = self._begin()

    def step(self) -> tuple[list[Reading], StepReport, int]:
        """Advance by ``dt``: readings that became due, the report, and how many values are not finite.

        Raises:
            ConvergenceError: the step did not converge; the state is that before the step.
        """
        simulation, limits = self._simulation, self._settings
        move, turn = limits.max_speed_m_s * self.dt, limits.max_turn_rate_rad_s * self.dt
        poses = {n: towards(p, self._targets[n], move, turn) for n, p in self._poses.items()}
        state, frames, system = simulation.state, dict(simulation.frames), simulation.scene.system
        deflections, commands = system.deflections.copy(), self._commands.kept()
        try:
            commanded = {n: (p.position, p.rotation()) for n, p in poses.items()}
            report = simulation.step(self._commands.advance(commanded, self.dt), self.dt)
        except ConvergenceError:
            simulation.state, simulation.frames = state, frames
            system.x[:], system.deflections[:] = state.x, deflections
            self._commands.restore(commands)
            raise
        self._poses = poses
        self.time += self.dt
        readings = self._read()
        bad = sum(
            int((~np.isfinite(values)).sum())
            for name, values in readings.items()
            if self._settings.channels[name].kind != "tracks"  # a marker out of the picture is no fault
        )
        return self._sampler.advance(self.time, readings), report, bad


def _pose(frame: Frame) -> Pose:
    origin, rotation = frame
    assert isinstance(rotation, Rotation)
    return Pose(np.array(origin, dtype=np.float64), np.asarray(rotation.as_quat(), dtype=np.float64))


class Loop:
    """Requests in, answers out, and steps in between, in pace with the wall clock."""

    def __init__(self, link: Connection, physics: Physics, clock: Callable[[], float] = time.monotonic) -> None:
        self._link = link
        self._physics = physics
        self._clock = clock
        self._pacer = Pacer()
        self._paused = False
        self._trouble = ""
        self._running = True
        self._reports: list[StepReport] = []
        self._not_finite = 0
        self._told = -float("inf")

    def run(self) -> None:
        """Go on until told to stop. Raises EOFError or OSError when the other side is gone."""
        self._link.send(Ready(self._physics.ids, self._physics.rest))
        self._pacer.restart(self._clock(), self._physics.time)
        while self._running:
            if self._paused or self._trouble:
                wait = STATUS_PERIOD_S
            else:
                self._step()
                wait = self._pacer.wait_s(self._clock(), self._physics.time)
            self._tell()
            self._listen(wait)

    def _step(self) -> None:
        try:
            readings, report, bad = self._physics.step()
        except ThinshellError as error:
            self._trouble = str(error)
            self._told = -float("inf")
            return
        self._reports.append(report)
        self._not_finite += bad
        self._link.send(Batch(self._physics.time, readings))

    def _listen(self, wait: float) -> None:
        """Take requests until ``wait`` [s] is over."""
        end = self._clock() + wait
        while self._running and self._link.poll(max(end - self._clock(), 0.0)):
            self._take(self._link.recv())

    def _take(self, request: Target | Reset | Pause | Stop) -> None:
        if isinstance(request, Target):
            self._physics.aim(request)
            return
        self._told = -float("inf")
        if isinstance(request, Stop):
            self._running = False
        elif isinstance(request, Pause):
            self._paused = request.paused
            self._link.send(Done(request.number, True, "paused" if request.paused else "running"))
        else:
            self._reset(request)
        self._pacer.restart(self._clock(), self._physics.time)

    def _reset(self, request: Reset) -> None:
        try:
            self._physics.reset()
        except ThinshellError as error:
            self._trouble = str(error)
            self._link.send(Done(request.number, False, self._trouble))
            return
        self._trouble = ""
        self._link.send(Done(request.number, True, "back at the start", self._physics.rest))

    def _tell(self) -> None:
        if self._clock() - self._told < STATUS_PERIOD_S:
            return
        self._told = self._clock()
        reports, self._reports = self._reports, []
        bad, self._not_finite = self._not_finite, 0
        self._link.send(
            Status(
                self._paused,
                self._trouble,
                self._physics.time,
                self._pacer.factor(),
                len(reports),
                max((r.iterations for r in reports), default=0),
                max((r.residual_n for r in reports), default=0.0),
                reports[-1].contacts if reports else 0,
                min((r.min_gap_m for r in reports), default=float("inf")),
                bad,
            )
        )


def run(link: Connection, settings: Settings) -> None:
    """Body of the process: build, step, answer. Ends when told, or when the other side is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the node says when to stop
    try:
        try:
            Loop(link, Physics(settings)).run()
        except ThinshellError as error:
            link.send(Status(False, str(error), 0.0, float("nan")))
        except (EOFError, OSError):
            raise
        except Exception:
            trouble = f"A defect in the simulation: {traceback.format_exc()}"
            link.send(Status(False, trouble, 0.0, float("nan")))
    except (EOFError, OSError):
        return
