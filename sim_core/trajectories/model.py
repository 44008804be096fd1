"""What a trajectory is: poses of end effectors on one time grid, with limits and with what a simulator predicts.

Units are SI and stand in the names. Poses are those of the end effector's frame in its base frame, unit quaternions
x y z w. Between samples the motion is the curve of :class:`sim_core.rigs.trajectory.PoseTrajectory`: with the
interpolation ``spline`` one cubic spline through all samples, with ``cornered`` one that has corners where samples are
no smooth motion.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, PlainSerializer, model_validator

from sim_core.rigs.fields import FloatArray, FrameId, Name, NonNegative, Strict, Text, Topic, describe, trouble
from sim_core.rigs.limits import Limits, Positive
from sim_core.rigs.trajectory import PoseTrajectory

VERSION = 2
"""Version of the file format. A change that a reader of this version cannot understand increases it."""

UNIT_TOLERANCE = 1e-3
"""How far the length of a quaternion may be from 1; it is normalised."""

EffectorName = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
"""Name of an end effector, which may be the frame of a robot's tool."""

LARGEST = 1e9
"""Largest number in an array, in its SI unit."""

IntArray = np.ndarray[Any, np.dtype[np.int64]]


def _array(*shape: int | None) -> Callable[[object], FloatArray]:
    """Turns a value into an array of finite numbers; ``None`` stands for any length."""
    words = " x ".join("n" if size is None else str(size) for size in shape)

    def convert(value: object) -> FloatArray:
        wanted = f"Write a list of {words} finite numbers."
        try:
            given = np.asarray(value)
        except (TypeError, ValueError, OverflowError):
            raise trouble(f"is {describe(value)}, no array of numbers.", wanted) from None
        if given.dtype.kind not in "iuf" and given.size:
            raise trouble(f"is {describe(value)}, no array of numbers.", wanted)
        array = given.astype(np.float64)
        fits = array.ndim == len(shape) and all(
            size in (None, length) for size, length in zip(shape, array.shape, strict=True)
        )
        if not fits:
            raise trouble(f"has the shape {' x '.join(map(str, array.shape)) or 'of one number'}.", wanted)
        if not np.isfinite(array).all():
            raise trouble(f"holds a value that is not finite in row {_first(~np.isfinite(array))}.", wanted)
        if (np.abs(array) > LARGEST).any():
            row = _first(np.abs(array) > LARGEST)
            raise trouble(f"holds a value above {LARGEST:g} in row {row}.", "Check the unit.")
        array.setflags(write=False)
        return array

    return convert


def _first(wrong: np.ndarray) -> int:
    """Index of the first row with something wrong."""
    return int(np.argwhere(wrong)[0][0])


def _whole_numbers(value: object) -> IntArray:
    array = _array(None)(value)
    if (array != np.round(array)).any() or (array < 0).any() or len(set(array.tolist())) < len(array):
        raise trouble("holds something else than different whole numbers from 0.", "Write a number for each marker.")
    return array.astype(np.int64)


_ToList = PlainSerializer(lambda array: array.tolist())
Times = Annotated[FloatArray, BeforeValidator(_array(None)), _ToList]
Rows3 = Annotated[FloatArray, BeforeValidator(_array(None, 3)), _ToList]
Rows4 = Annotated[FloatArray, BeforeValidator(_array(None, 4)), _ToList]
Points = Annotated[FloatArray, BeforeValidator(_array(None, None, 3)), _ToList]
Ids = Annotated[IntArray, BeforeValidator(_whole_numbers), _ToList]


class _Part(Strict):
    model_config = ConfigDict(arbitrary_types_allowed=True)


class RigReference(_Part):
    """The rig that a trajectory was made for."""

    name: Name = Field(description="name of the rig")
    sha256: Annotated[str, Field(strict=True, pattern=r"^[0-9a-f]{64}$")] = Field(
        description="digest of the rig, by sim_core.rigs.digest"
    )


class EffectorPath(_Part):
    """Poses of one end effector, ``n`` of them.

    ``gripper_closing_m``: by how much the gap between the fingers of its gripper is smaller than in the first sample.
    ``target_topic``, ``current_topic``: where commanded and measured poses are on a live system, before remapping.
    ``limits``: of this end effector, besides those of the trajectory. ``tolerance_m``, ``tolerance_rad``: how far it
    may be from its path, and ``max_lag_s``: how far behind its commands.
    """

    frame_id: FrameId = Field(description="base frame that the poses are in")
    positions_m: Rows3 = Field(description="positions [m], n x 3")
    quaternions_xyzw: Rows4 = Field(description="unit quaternions x y z w, n x 4")
    gripper_closing_m: Times | None = None
    target_topic: Topic = "target_pose"
    current_topic: Topic = "current_pose"
    limits: Limits = Limits()
    tolerance_m: Positive | None = None
    tolerance_rad: Positive | None = None
    max_lag_s: Positive | None = None

    @model_validator(mode="after")
    def _orientations(self) -> EffectorPath:
        lengths = np.linalg.norm(self.quaternions_xyzw, axis=1)
        wrong = np.abs(lengths - 1.0) > UNIT_TOLERANCE
        if wrong.any():
            row = _first(wrong)
            raise trouble(
                f"has the length {lengths[row]:.6g} in row {row}, but an orientation has length 1.",
                "Divide it by its length; the order is x, y, z, w.",
                "quaternions_xyzw",
            )
        return self


class WrenchPrediction(_Part):
    """Force and torque that act **on the sensor**, about the origin of ``frame_id``, and standard deviations.

    These are true values at the trajectory's times: without latency and noise of the sensor. ``force_noise_n``,
    ``torque_noise_nm``: standard deviations of the white noise that the rig states for each component.
    ``max_force_n``, ``max_torque_nm``: limits that follow from the prediction (:mod:`sim_core.trajectories.expected`).
    """

    frame_id: FrameId = Field(description="frame of the sensor")
    forces_n: Rows3 = Field(description="forces [N], n x 3")
    torques_nm: Rows3 = Field(description="torques [N m], n x 3")
    force_sds_n: Rows3 | None = None
    torque_sds_nm: Rows3 | None = None
    force_noise_n: NonNegative = 0.0
    torque_noise_nm: NonNegative = 0.0
    max_force_n: Positive | None = None
    max_torque_nm: Positive | None = None
    rate_hz: Positive = 100.0
    delay_s: NonNegative = 0.0
    topic: Topic = "wrench"


class MarkerPrediction(_Part):
    """Positions of ``m`` markers in ``frame_id``, and standard deviations of each coordinate. ``position_noise_m``:
    that of the white noise that the rig states."""

    frame_id: FrameId = Field(description="frame of the sensor")
    ids: Ids = Field(description="number of each marker, m")
    positions_m: Points = Field(description="positions [m], n x m x 3")
    position_sds_m: Points | None = None
    position_noise_m: NonNegative = 0.0
    rate_hz: Positive = 30.0
    delay_s: NonNegative = 0.0
    topic: Topic = "markers"


class Prediction(_Part):
    """What sensors will read, by sensor.

    ``rate_hz``, ``delay_s`` of each: how often it reads, and by how much a reading may be older than its stamp.
    ``draws``: number of rollouts that the standard deviations are from; ``open_parameters``: how many parameters of the
    rig were drawn for them. Both are needed to say how far readings may be from their means.
    """

    draws: Annotated[int, Field(strict=True, ge=2)] | None = None
    open_parameters: Annotated[int, Field(strict=True, ge=1)] | None = None
    wrenches: dict[Name, WrenchPrediction] = Field(default={})
    markers: dict[Name, MarkerPrediction] = Field(default={})


class PassagePath(_Part):
    """Poses of one end effector on a passage, ``k`` of them, in the frame of its path."""

    positions_m: Rows3 = Field(description="positions [m], k x 3")
    quaternions_xyzw: Rows4 = Field(description="unit quaternions x y z w, k x 4")


class Passage(_Part):
    """How end effectors get to the first pose of a motion, or back from the last one; from rest to rest."""

    times_s: Times = Field(description="time [s] of each sample since the start of the passage, k")
    end_effectors: dict[EffectorName, PassagePath] = Field(min_length=1, description="end effector -> its poses")

    @model_validator(mode="after")
    def _one_grid(self) -> Passage:
        _check_times(self.times_s)
        for name, path in self.end_effectors.items():
            for key, value in path:
                _check_rows(value, len(self.times_s), f"end_effectors.{name}.{key}")
        return self

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.times_s[-1])

    def poses(self) -> dict[str, PoseTrajectory]:
        """The motion of each end effector."""
        return {
            name: PoseTrajectory.from_samples(
                self.times_s, path.positions_m, path.quaternions_xyzw, source=f"The passage of {name!r}", planned=True
            )
            for name, path in self.end_effectors.items()
        }


class Trajectory(_Part):
    """A motion of one or more end effectors. ``n``: number of samples, two or more.

    ``rig``: None where it is not known, as in a message. ``provenance``: free text by key, such as command and seed.
    ``limits``: of all end effectors. ``approach``: from where the end effectors wait to the first poses; ``retract``:
    back from the last ones. Without them the motion begins and ends where they wait.
    """

    format: Literal["thinshell_trajectory"] = "thinshell_trajectory"
    version: Annotated[int, Field(strict=True, ge=1, le=VERSION)] = VERSION
    name: Text = ""
    description: Text = ""
    units: Literal["SI"] = "SI"
    quaternion_order: Literal["xyzw"] = "xyzw"
    interpolation: Literal["cornered", "spline"] = "cornered"
    rig: RigReference | None = None
    limits: Limits = Limits()
    times_s: Times = Field(description="time [s] of each sample since the start, n")
    end_effectors: dict[EffectorName, EffectorPath] = Field(min_length=1, description="end effector -> its poses")
    approach: Passage | None = None
    retract: Passage | None = None
    predicted: Prediction = Prediction()
    provenance: dict[Text, Text] = Field(default={})

    @model_validator(mode="after")
    def _one_grid(self) -> Trajectory:
        times = self.times_s
        _check_times(times)
        for where, passage in (("approach", self.approach), ("retract", self.retract)):
            if passage is not None and set(passage.end_effectors) != set(self.end_effectors):
                raise trouble(
                    f"moves {', '.join(passage.end_effectors)}, and the motion {', '.join(self.end_effectors)}.",
                    "Write poses of the same end effectors; one that stays repeats its pose.",
                    f"{where}.end_effectors",
                )
        parts: list[tuple[str, str, _Part]] = [("end_effectors", n, p) for n, p in self.end_effectors.items()]
        parts += [("predicted.wrenches", n, p) for n, p in self.predicted.wrenches.items()]
        parts += [("predicted.markers", n, p) for n, p in self.predicted.markers.items()]
        for group, name, part in parts:
            for key, value in part:
                if isinstance(value, np.ndarray) and key != "ids":
                    _check_rows(value, len(times), f"{group}.{name}.{key}")
        for name, markers in self.predicted.markers.items():
            for array in (markers.positions_m, markers.position_sds_m):
                if array is not None and array.shape[1] != len(markers.ids):
                    raise trouble(
                        f"names {len(markers.ids)} markers, and there are positions of {array.shape[1]}.",
                        "Write one number for each.",
                        f"predicted.markers.{name}.ids",
                    )
        return self

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.times_s[-1])

    def poses(self) -> dict[str, PoseTrajectory]:
        """The motion of each end effector, as a simulator takes it."""
        return {
            name: PoseTrajectory.from_samples(
                self.times_s,
                path.positions_m,
                path.quaternions_xyzw,
                source=f"The path of {name!r}",
                planned=self.interpolation == "spline",
            )
            for name, path in self.end_effectors.items()
        }

    def limits_of(self, name: str) -> Limits:
        """The limits of one end effector: the stricter of its own and those of all."""
        return self.limits.stricter(self.end_effectors[name].limits)


def _check_times(times: np.ndarray) -> None:
    if len(times) < 2 or times[0] != 0.0 or (np.diff(times) <= 0.0).any():
        row = 0 if len(times) < 2 or times[0] != 0.0 else _first(np.diff(times) <= 0.0) + 1
        raise trouble(
            f"does not begin with 0 and increase from sample to sample (row {row}).",
            "Write two or more times [s] since the start, in their order, each once.",
            "times_s",
        )


def _check_rows(values: np.ndarray, count: int, where: str) -> None:
    if len(values) != count:
        raise trouble(f"has {len(values)} rows, and there are {count} times.", "Write one row for each time.", where)
    if where.rsplit("_", 1)[0].endswith("sds") and (values < 0.0).any():
        raise trouble(f"is negative in row {_first(values < 0.0)}.", "A standard deviation is 0 or more.", where)
