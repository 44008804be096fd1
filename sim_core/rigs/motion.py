"""Experiments: what each end effector does, as a list of named motions, and their pose trajectories.

Moves are relative to where the motion before ended (the first one: where the experiment begins, which is
the start pose of the rig unless it says otherwise), along the axes of the base frame, or of the end effector
itself with ``frame: own``. ``speed_m_s`` is the highest speed of a move; a turn takes at least as long as
``speed_deg_s`` asks for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError, nearest_match
from sim_core.rigs.fields import (
    Angles,
    Direction,
    FloatArray,
    Name,
    NonNegative,
    Pose,
    Position,
    Strict,
    Text,
    of_length,
    trouble,
)
from sim_core.rigs.load import find_config
from sim_core.rigs.moves import Move, Rest, Step
from sim_core.rigs.random_motion import REST, Wander, spans_within, wander
from sim_core.rigs.schema import EndEffector, Rig
from sim_core.rigs.trajectory import PoseTrajectory, Profile, minimum_jerk
from sim_core.rigs.yamlfile import read_mapping, validate

__all__ = [
    "Bend",
    "Drop",
    "Experiment",
    "Press",
    "Pull",
    "Random",
    "Slide",
    "Wait",
    "Waypoints",
    "compile_experiment",
    "load_experiment",
]

Duration = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=3600.0)]
Speed = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=10.0)]
TurnSpeed = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=3600.0)]
Acceleration = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=1000.0)]
Distance = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=10.0)]
Times = Annotated[int, Field(strict=True, ge=1, le=1000)]

MAX_SAMPLES = 2_000_000


class _Moving(Strict):
    frame: Literal["base", "own"] = "base"
    profile: Literal["minimum_jerk", "trapezoidal"] = "minimum_jerk"
    speed_m_s: Speed = Field(default=0.01, description="highest speed in m/s")
    speed_deg_s: TurnSpeed = 45.0
    acceleration_m_s2: Acceleration | None = None

    @model_validator(mode="after")
    def _profile_fits(self) -> _Moving:
        if self.acceleration_m_s2 is not None and self.profile == "minimum_jerk":
            raise trouble(
                "is given for a minimum-jerk motion.",
                "Write 'profile: trapezoidal', or leave it out.",
                "acceleration_m_s2",
            )
        return self

    def move(self, shift: Sequence[float] | FloatArray, turn: Rotation | None = None) -> Move:
        """A move with this motion's speed, profile and axes."""
        acceleration = None
        if self.profile == "trapezoidal":
            # A tenth of a second to full speed by default.
            acceleration = self.acceleration_m_s2 or self.speed_m_s / 0.1
        return Move(
            np.array(shift, dtype=np.float64),
            turn or Rotation.identity(),
            self.frame == "own",
            self.speed_m_s,
            math.radians(self.speed_deg_s),
            acceleration,
        )

    def there_and_back(self, shift: FloatArray, turn: Rotation, hold_s: float, times: int) -> Iterator[Step]:
        """Go, hold, come back the same way, so many times."""
        # Along own axes the way back starts from the turned axes.
        back = -turn.inv().apply(shift) if self.frame == "own" else -shift
        for _ in range(times):
            yield self.move(shift, turn)
            yield Rest(hold_s)
            yield self.move(back, turn.inv())


class Wait(Strict):
    """Stand still for some time."""

    type: Literal["wait"]
    duration_s: Duration = Field(description="time in s")

    def steps(self) -> Iterator[Step]:
        """The motion as moves and rests."""
        yield Rest(self.duration_s)


class Press(_Moving):
    """Press, hold, release: go ``depth_m`` along ``along`` and come back."""

    type: Literal["press"]
    depth_m: Distance = Field(description="way from where the motion begins, in m")
    along: Direction = (0.0, 0.0, -1.0)
    hold_s: Duration = 0.0
    times: Times = 1

    def steps(self) -> Iterator[Step]:
        """The motion as moves and rests."""
        shift = self.depth_m * _direction(self.along)
        yield from self.there_and_back(shift, Rotation.identity(), self.hold_s, self.times)


class Slide(_Moving):
    """Move along a straight line; with ``back`` return the same way."""

    type: Literal["slide"]
    by_m: Position = Field(description="displacement in m")
    back: bool = Field(default=False, strict=True)
    hold_s: Duration = 0.0
    times: Times = 1

    @model_validator(mode="after")
    def _moves(self) -> Slide:
        if not any(self.by_m):
            raise trouble("is [0, 0, 0].", "Give a displacement, or use 'type: wait'.", "by_m")
        if self.times > 1 and not self.back:
            raise trouble("repeats a way that has no return.", "Add 'back: true'.", "times")
        return self

    def steps(self) -> Iterator[Step]:
        """The motion as moves and rests."""
        if self.back:
            yield from self.there_and_back(np.array(self.by_m), Rotation.identity(), self.hold_s, self.times)
        else:
            yield self.move(self.by_m)
            yield Rest(self.hold_s)


class Bend(_Moving):
    """Bend and release: turn (and shift) the end effector, hold, and come back."""

    type: Literal["bend"]
    turn_rpy_deg: Angles = Field(description="turn about the fixed axes x, y, z in deg")
    by_m: Position = (0.0, 0.0, 0.0)
    hold_s: Duration = 0.0
    times: Times = 1

    def steps(self) -> Iterator[Step]:
        """The motion as moves and rests."""
        turn = Rotation.from_euler("xyz", self.turn_rpy_deg, degrees=True)
        yield from self.there_and_back(np.array(self.by_m), turn, self.hold_s, self.times)


class Pull(_Moving):
    """Pull a strip: go ``distance_m`` along ``along``, hold, and come back unless ``back`` is false."""

    type: Literal["pull"]
    distance_m: Distance = Field(description="way in m")
    along: Direction = (1.0, 0.0, 0.0)
    hold_s: Duration = 0.0
    back: bool = Field(default=True, strict=True)
    times: Times = 1
    profile: Literal["minimum_jerk", "trapezoidal"] = "trapezoidal"

    def steps(self) -> Iterator[Step]:
        """The motion as moves and rests."""
        shift = self.distance_m * _direction(self.along)
        if self.back:
            yield from self.there_and_back(shift, Rotation.identity(), self.hold_s, self.times)
        else:
            for _ in range(self.times):
                yield self.move(shift)
                yield Rest(self.hold_s)


class Drop(Strict):
    """Give way faster than things fall, so that what was carried drops; then wait for it to settle."""

    type: Literal["drop"]
    distance_m: Distance = Field(description="way in m")
    along: Direction = (0.0, 0.0, -1.0)
    acceleration_m_s2: Acceleration = 30.0
    settle_s: Duration = 1.0

    def steps(self) -> Iterator[Step]:
        """The motion as moves and rests."""
        shift = self.distance_m * _direction(self.along)
        top_speed = math.sqrt(self.distance_m * self.acceleration_m_s2)
        yield Move(shift, Rotation.identity(), False, top_speed, 1.0, self.acceleration_m_s2)
        yield Rest(self.settle_s)


class Waypoints(_Moving):
    """Go through poses given relative to the start pose of the rig, at rest in each."""

    type: Literal["waypoints"]
    poses: tuple[Pose, ...] = Field(min_length=1, description="poses relative to the start pose")
    hold_s: Duration = 0.0


Bounds = Annotated[tuple[NonNegative, NonNegative, NonNegative], of_length(3)]


class Random(Strict):
    """Wander smoothly and at random about ``centre`` (relative to the start pose of the rig), the same for a seed.

    ``bounds_m``, ``bounds_deg``: how far it goes at most along and about each axis of the base frame;
    ``speed_m_s``, ``speed_deg_s``: highest speeds, usually well above those that are reached.
    """

    type: Literal["random"]
    duration_s: Duration = Field(description="time in s")
    bounds_m: Bounds = Field(description="largest shift along x, y, z in m")
    bounds_deg: Bounds = (0.0, 0.0, 0.0)
    centre: Pose = Pose()
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = 0
    speed_m_s: Speed = 0.01
    speed_deg_s: TurnSpeed = 45.0

    @model_validator(mode="after")
    def _has_time(self) -> Random:
        if not self.bounds().any():
            raise trouble("are all 0.", "Give at least one bound above 0, or use 'type: wait'.", "bounds_m")
        if float(np.linalg.norm(self.bounds()[3:])) > math.pi:
            raise trouble("allow turns of more than 180 deg.", "Reduce them.", "bounds_deg")
        needed = 2 * REST - 2
        if self.spans() < needed:
            shortest = 1.01 * needed * self.duration_s / max(self._spans(1e6 * self.duration_s) * 1e-6, 1e-12)
            raise trouble(
                f"is {self.duration_s:g}, too short to wander within these bounds at these speeds.",
                f"Write at least {shortest:.3g}, or smaller bounds, or higher speeds.",
                "duration_s",
            )
        return self

    def bounds(self) -> FloatArray:
        """Of all six coordinates [m, rad], ``(6,)``."""
        return np.concatenate([self.bounds_m, np.deg2rad(self.bounds_deg)])

    def spans(self) -> int:
        """Knot spans of the motion."""
        return self._spans(self.duration_s)

    def _spans(self, duration: float) -> int:
        return spans_within(self.bounds(), self.speed_m_s, math.radians(self.speed_deg_s), duration)


Motion = Annotated[Wait | Press | Slide | Bend | Pull | Drop | Waypoints | Random, Field(discriminator="type")]


class Experiment(Strict):
    """What each end effector does. All motions begin at time 0; who is done first holds still.

    ``rig``: the one that it is meant for, where it is to identify materials, and ``identifies``: the parameters that it
    is made to tell, as 'thinshell params' lists them. ``begin``: where end effectors stand, at rest, when it begins,
    relative to their start poses in the rig.
    """

    name: Name = Field(description="short name, as in the file's name")
    description: Text = ""
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = 0
    command_rate_hz: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1.0, le=1000.0)] = 100.0
    duration_s: Duration | None = None
    rig: Name | None = None
    identifies: tuple[Text, ...] = ()
    begin: dict[Name, Pose] = Field(default={})
    motions: dict[Name, tuple[Motion, ...]] = Field(default={})

    @model_validator(mode="after")
    def _lasts(self) -> Experiment:
        if not any(self.motions.values()) and not self.duration_s:
            raise trouble("has neither motions nor duration_s.", "Say what moves, or how long to watch.", "motions")
        if bool(self.identifies) != (self.rig is not None):
            raise trouble(
                "stands without identifies, or identifies stands without it.",
                "identifies lists what the motion determines on that rig: give both, or neither.",
                "rig",
            )
        return self


def load_experiment(name_or_path: str | Path) -> Experiment:
    """Load an experiment by the name of one that comes with the package, or from a file."""
    path = find_config(name_or_path, "experiments")
    data = read_mapping(path)
    if "bodies" in data and "motions" not in data:
        raise ConfigError(f"{path} is a rig, and an experiment is wanted.", "Rigs come before experiments.")
    return validate(Experiment, data, str(path))


def compile_experiment(experiment: Experiment, rig: Rig) -> dict[str, PoseTrajectory]:
    """Commanded poses of every end effector of the rig, from time 0 to the end of the longest.

    Sampled at ``command_rate_hz``; end effectors without motions hold the pose that they begin with.
    """
    for name in (*experiment.begin, *experiment.motions):
        if name not in rig.end_effectors:
            known = list(rig.end_effectors)
            raise ConfigError(
                f"The experiment {experiment.name!r} moves {name!r}, but the rig {rig.name!r} has no such "
                "end effector.",
                nearest_match(name, known) if known else "This rig has no end effectors.",
            )
    paths = {
        name: _Path.of(effector, experiment.begin.get(name, Pose()), experiment.motions.get(name, ()))
        for name, effector in rig.end_effectors.items()
    }
    duration = max([experiment.duration_s or 0.0, *(path.end for path in paths.values())])
    count = max(math.ceil(duration * experiment.command_rate_hz - 1e-9), 1)
    if count > MAX_SAMPLES:
        raise ConfigError(
            f"The experiment {experiment.name!r} takes {duration:.4g} s, which makes {count} poses "
            f"of each end effector, more than {MAX_SAMPLES}.",
            "Check the speeds and how often motions are repeated, or lower command_rate_hz.",
        )
    times = np.arange(count + 1) / experiment.command_rate_hz
    return {name: path.sample(times) for name, path in paths.items()}


def _direction(along: tuple[float, float, float]) -> FloatArray:
    vector = np.array(along)
    return vector / float(np.linalg.norm(vector))


@dataclass
class _Path:
    """A chain of moves: knots in time with poses, and between two knots the profile of a straight way, or a way.
    ``origin``: the start pose of the rig."""

    origin: tuple[FloatArray, Rotation]
    times: list[float]
    positions: list[FloatArray]
    rotations: list[Rotation]
    ways: list[Profile | Wander] = field(default_factory=list)

    @classmethod
    def of(cls, effector: EndEffector, begin: Pose, motions: Sequence[Motion]) -> _Path:
        position, rotation = effector.start.position(), effector.start.rotation()
        first = position + begin.position(), begin.rotation() * rotation
        path = cls((position, rotation), [0.0], [first[0]], [first[1]])
        for motion in motions:
            if isinstance(motion, Waypoints):
                path._visit(motion)
                continue
            if isinstance(motion, Random):
                path._wander(motion)
                continue
            for step in motion.steps():
                path._append(step)
        return path

    @property
    def end(self) -> float:
        return self.times[-1]

    def _append(self, step: Step) -> None:
        here, facing = self.positions[-1], self.rotations[-1]
        if isinstance(step, Rest):
            self._knot(step.duration, here, facing, minimum_jerk)
            return
        shift = facing.apply(step.shift) if step.own else step.shift
        turned = facing * step.turn if step.own else step.turn * facing
        duration, profile = step.timing()
        self._knot(duration, here + shift, turned, profile)

    def _visit(self, motion: Waypoints) -> None:
        """Poses relative to the start pose: along base axes, or as poses in the start frame."""
        origin, start = self.origin
        for pose in motion.poses:
            own = motion.frame == "own"
            goal = origin + (start.apply(pose.position()) if own else pose.position())
            facing = start * pose.rotation() if own else pose.rotation() * start
            turn = facing * self.rotations[-1].inv()
            duration, profile = motion.move(goal - self.positions[-1], turn).timing()
            self._knot(duration, goal, facing, profile)
            self._append(Rest(motion.hold_s))

    def _wander(self, motion: Random) -> None:
        """Go to the centre, if not there, and wander about it."""
        speeds = motion.speed_m_s, motion.speed_deg_s
        poses = (motion.centre,)
        self._visit(Waypoints(type="waypoints", poses=poses, speed_m_s=speeds[0], speed_deg_s=speeds[1]))
        here, facing = self.positions[-1], self.rotations[-1]
        found = wander(here, facing, motion.bounds(), motion.spans(), motion.seed)
        self._knot(motion.duration_s, here, facing, found)

    def _knot(self, duration: float, position: FloatArray, rotation: Rotation, way: Profile | Wander) -> None:
        if duration <= 0.0:
            return
        self.times.append(self.end + duration)
        self.positions.append(position)
        self.rotations.append(rotation)
        self.ways.append(way)

    def sample(self, times: FloatArray) -> PoseTrajectory:
        """The chain at the given times [s], the last pose held."""
        positions = np.repeat(self.positions[-1][None], len(times), axis=0)
        quaternions = np.repeat(self.rotations[-1].as_quat()[None], len(times), axis=0)
        knots = np.array(self.times)
        segment = np.searchsorted(knots, times, side="right") - 1
        for index, way in enumerate(self.ways):
            mine = segment == index
            elapsed = (times[mine] - knots[index]) / (knots[index + 1] - knots[index])
            if isinstance(way, Wander):
                positions[mine], quaternions[mine] = way.poses(elapsed)
                continue
            share = way(elapsed)
            start, stop = self.positions[index], self.positions[index + 1]
            positions[mine] = start + share[:, None] * (stop - start)
            turn = (self.rotations[index + 1] * self.rotations[index].inv()).as_rotvec()
            quaternions[mine] = (Rotation.from_rotvec(share[:, None] * turn) * self.rotations[index]).as_quat()
        return PoseTrajectory.from_samples(times, positions, quaternions)
