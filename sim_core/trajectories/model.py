"""What a trajectory is: poses of end effectors on one time grid, with limits and with what a simulator predicts.

Units are SI and stand in the names. Poses are those of the end effector's frame in its base frame, unit quaternions
x y z w. Between samples the motion is the curve of :class:`sim_core.rigs.trajectory.PoseTrajectory`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, PlainSerializer, model_validator

from sim_core.rigs.fields import FloatArray, FrameId, Name, Strict, Text, Topic, Vector, describe, trouble
from sim_core.rigs.trajectory import PoseTrajectory

VERSION = 1
"""Version of the file format. A change that a reader of this version cannot understand increases it."""

UNIT_TOLERANCE = 1e-3
"""How far the length of a quaternion may be from 1; it is normalised."""

EffectorName = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
"""Name of an end effector, which may be the frame of a robot's tool."""

LARGEST = 1e9
"""Largest number in an array, in its SI unit."""

Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]
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
    """

    frame_id: FrameId = Field(description="base frame that the poses are in")
    positions_m: Rows3 = Field(description="positions [m], n x 3")
    quaternions_xyzw: Rows4 = Field(description="unit quaternions x y z w, n x 4")
    gripper_closing_m: Times | None = None
    target_topic: Topic = "target_pose"
    current_topic: Topic = "current_pose"

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

    These are true values at the trajectory's times: without latency and noise of the sensor.
    """

    frame_id: FrameId = Field(description="frame of the sensor")
    forces_n: Rows3 = Field(description="forces [N], n x 3")
    torques_nm: Rows3 = Field(description="torques [N m], n x 3")
    force_sds_n: Rows3 | None = None
    torque_sds_nm: Rows3 | None = None
    topic: Topic = "wrench"


class MarkerPrediction(_Part):
    """Positions of ``m`` markers in ``frame_id``, and standard deviations of each coordinate."""

    frame_id: FrameId = Field(description="frame of the sensor")
    ids: Ids = Field(description="number of each marker, m")
    positions_m: Points = Field(description="positions [m], n x m x 3")
    position_sds_m: Points | None = None
    topic: Topic = "markers"


class Prediction(_Part):
    """What sensors will read, by sensor."""

    wrenches: dict[Name, WrenchPrediction] = Field(default={})
    markers: dict[Name, MarkerPrediction] = Field(default={})


class Limits(_Part):
    """What must never be exceeded while a trajectory is replayed; what is left out is not limited here.

    The box is that of the end effectors' origins in the base frame. Force and torque are magnitudes at each sensor.
    """

    workspace_min_m: Vector | None = None
    workspace_max_m: Vector | None = None
    max_speed_m_s: Positive | None = None
    max_angular_speed_rad_s: Positive | None = None
    max_acceleration_m_s2: Positive | None = None
    max_force_n: Positive | None = None
    max_torque_nm: Positive | None = None

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


class Trajectory(_Part):
    """A motion of one or more end effectors. ``n``: number of samples, two or more.

    ``rig``: None where it is not known, as in a message. ``provenance``: free text by key, such as command and seed.
    """

    format: Literal["thinshell_trajectory"] = "thinshell_trajectory"
    version: Annotated[int, Field(strict=True, ge=1, le=VERSION)] = VERSION
    name: Text = ""
    description: Text = ""
    units: Literal["SI"] = "SI"
    quaternion_order: Literal["xyzw"] = "xyzw"
    rig: RigReference | None = None
    limits: Limits = Limits()
    times_s: Times = Field(description="time [s] of each sample since the start, n")
    end_effectors: dict[EffectorName, EffectorPath] = Field(min_length=1, description="end effector -> its poses")
    predicted: Prediction = Prediction()
    provenance: dict[Text, Text] = Field(default={})

    @model_validator(mode="after")
    def _one_grid(self) -> Trajectory:
        times = self.times_s
        if len(times) < 2 or times[0] != 0.0 or (np.diff(times) <= 0.0).any():
            row = 0 if len(times) < 2 or times[0] != 0.0 else _first(np.diff(times) <= 0.0) + 1
            raise trouble(
                f"does not begin with 0 and increase from sample to sample (row {row}).",
                "Write two or more times [s] since the start, in their order, each once.",
                "times_s",
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
                self.times_s, path.positions_m, path.quaternions_xyzw, source=f"The path of {name!r}"
            )
            for name, path in self.end_effectors.items()
        }


def _check_rows(values: np.ndarray, count: int, where: str) -> None:
    if len(values) != count:
        raise trouble(f"has {len(values)} rows, and there are {count} times.", "Write one row for each time.", where)
    if where.rsplit("_", 1)[0].endswith("sds") and (values < 0.0).any():
        raise trouble(f"is negative in row {_first(values < 0.0)}.", "A standard deviation is 0 or more.", where)
