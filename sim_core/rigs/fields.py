"""Building blocks of every configuration model: strict numbers, units in keys, errors with a remedy.

A key carries its unit as a suffix (``thickness_m``, ``E_pa``). A key with another unit is refused
with the key that is expected and, where the value is a number, the converted value.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from sim_core.errors import nearest_match

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]

UNITS: dict[str, tuple[str, dict[str, float]]] = {
    "pa_per_m": ("Pa/m", {"kpa_per_m": 1e3, "mpa_per_m": 1e6, "n_per_m3": 1.0}),
    "m_per_px": ("m/px", {"mm_per_px": 1e-3, "um_per_px": 1e-6}),
    "kg_m3": ("kg/m^3", {"g_cm3": 1e3, "kg_per_m3": 1.0}),
    "per_s": ("1/s", {"per_ms": 1e3}),
    "per_m": ("1/m", {"per_mm": 1e3, "per_cm": 1e2}),
    "rad_s": ("rad/s", {"deg_s": math.pi / 180.0}),
    "deg_s": ("deg/s", {"rad_s": 180.0 / math.pi}),
    "rad_s3": ("rad/s^3", {"deg_s3": math.pi / 180.0}),
    "rad_s2": ("rad/s^2", {"deg_s2": math.pi / 180.0}),
    "m_s3": ("m/s^3", {"mm_s3": 1e-3}),
    "m_s2": ("m/s^2", {"mm_s2": 1e-3}),
    "m_s": ("m/s", {"mm_s": 1e-3, "cm_s": 1e-2}),
    "rad": ("rad", {"deg": math.pi / 180.0}),
    "deg": ("deg", {"rad": 180.0 / math.pi}),
    "pa": ("Pa", {"kpa": 1e3, "mpa": 1e6, "gpa": 1e9}),
    "hz": ("Hz", {"khz": 1e3}),
    "px": ("px", {}),
    "nm": ("N m", {"nmm": 1e-3, "mnm": 1e-3}),
    "n": ("N", {"mn": 1e-3, "kn": 1e3}),
    "kg": ("kg", {"g": 1e-3, "mg": 1e-6}),
    "m": ("m", {"mm": 1e-3, "cm": 1e-2, "um": 1e-6, "in": 0.0254}),
    "s": ("s", {"ms": 1e-3, "us": 1e-6, "min": 60.0}),
}
"""Suffix of a key -> (unit as printed, other suffixes that people write and their factor to it)."""

NAME_PATTERN = r"^[a-z][a-z0-9_]*$"
EFFECT_PATTERN = r"^[a-z][a-z0-9_]*(@[a-z][a-z0-9_]*(-[a-z][a-z0-9_]*)?)?(#[a-z0-9_]+)?$"
"""Keys of effects (:mod:`sim_core.effects.base`)."""

TOPIC_PATTERN = r"^[~/]?/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*$"


@functools.cache
def split_unit(key: str) -> tuple[str, str]:
    """Split a key into its stem and its unit suffix (empty for a key without a unit)."""
    for suffix in UNITS:
        if key.endswith("_" + suffix):
            return key[: -len(suffix) - 1], suffix
    return key, ""


def unit_of(key: str) -> str:
    """Unit that a key's suffix stands for, as printed: ``'Pa'`` for ``'E_pa'``, ``''`` for ``'nu'``."""
    suffix = split_unit(key)[1]
    return UNITS[suffix][0] if suffix else ""


def trouble(problem: str, remedy: str, *path: str | int) -> PydanticCustomError:
    """An error of a model validator: what is wrong, what to do, and where below the model it is."""
    context = {"problem": problem, "remedy": remedy, "path": list(path)}
    return PydanticCustomError("trouble", "{problem} {remedy}", context)


def unknown_key(key: str, value: object, known: list[str]) -> str:
    """Remedy for a key that a model does not have: the key with the right unit, or the nearest one."""
    for candidate in known:
        stem, suffix = split_unit(candidate)
        if not suffix:
            continue
        if key.lower() == stem.lower():
            return f"Write {candidate}: this quantity is given in {UNITS[suffix][0]}."
        if not key.lower().startswith(stem.lower() + "_"):
            continue
        given = key.lower()[len(stem) + 1 :]
        factor = UNITS[suffix][1].get(given)
        if factor is not None and isinstance(value, int | float) and not isinstance(value, bool):
            return f"This quantity is given in {UNITS[suffix][0]}: write {candidate}: {value * factor:.6g}."
        if factor is not None or given in UNITS or any(given in other for _, other in UNITS.values()):
            return f"This quantity is given in {UNITS[suffix][0]}: write {candidate}."
    return nearest_match(key, known)


class Strict(BaseModel):
    """Base of all configuration models: frozen, no unknown keys, no silent conversion."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def prepare(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Rewrite the raw mapping before it is checked (presets); the base changes nothing."""
        return data

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, data: object) -> object:
        if isinstance(data, BaseModel):
            return data
        fields = cls.model_fields
        if not isinstance(data, Mapping):
            keys = ", ".join(fields)
            raise trouble(f"is {describe(data)}, not a mapping.", f"Write 'key: value' lines with: {keys}.")
        data = cls.prepare({key: value for key, value in data.items()})
        for key in data:
            if key not in fields:
                remedy = unknown_key(str(key), data[key], list(fields))
                raise trouble("is not a key that is known here.", remedy, key)
        for key, field in fields.items():
            if field.is_required() and key not in data:
                meaning = f" ({field.description})" if field.description else ""
                raise trouble("is missing.", f"Add '{key}: ...'{meaning}.", key)
        return data


def describe(value: object) -> str:
    """A value as an error message shows it: short, with its kind where the kind is the point."""
    if value is None:
        return "empty"
    if isinstance(value, str):
        return f"the text {value!r}" if len(value) <= 60 else f"the text {value[:57]!r}..."
    if isinstance(value, bool):
        return f"the truth value {'true' if value else 'false'}"
    if isinstance(value, Mapping):
        return "a mapping"
    if isinstance(value, list | tuple):
        text = "[" + ", ".join(str(item) for item in value) + "]"
        return text if len(text) <= 60 else f"a list of {len(value)}"
    return str(value)


def each_axis_once(axes: tuple[str, ...]) -> tuple[str, ...]:
    """Axes with their signs, if each is there once."""
    if len({axis.removeprefix("-") for axis in axes}) < len(axes):
        raise trouble("names an axis twice.", "Name each axis once, with a minus where it is reversed.")
    return axes


def of_length(count: int) -> BeforeValidator:
    """Requires a list with so many entries."""

    def check(value: object) -> object:
        if not isinstance(value, list | tuple | np.ndarray) or len(value) != count:
            raise trouble(f"is {describe(value)}.", f"Write a list of {count} entries.")
        return tuple(value)

    return BeforeValidator(check)


def _not_zero(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(vector):
        raise trouble("is [0, 0, 0].", "Give a direction, such as [0, 0, -1].")
    return vector


Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)]
Length = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=10.0)]
Coordinate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-100.0, le=100.0)]
Angle = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-720.0, le=720.0)]
Count = Annotated[int, Field(strict=True, ge=1, le=10_000)]
Flag = Annotated[bool, Field(strict=True)]
Text = Annotated[str, Field(strict=True)]
Name = Annotated[str, Field(strict=True, pattern=NAME_PATTERN)]
EffectKey = Annotated[str, Field(strict=True, pattern=EFFECT_PATTERN)]
Topic = Annotated[str, Field(strict=True, pattern=TOPIC_PATTERN)]
FrameId = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z][A-Za-z0-9_/]*$")]
Position = Annotated[tuple[Coordinate, Coordinate, Coordinate], of_length(3)]
Vector = Annotated[tuple[Real, Real, Real], of_length(3)]
Direction = Annotated[Vector, AfterValidator(_not_zero)]
Angles = Annotated[tuple[Angle, Angle, Angle], of_length(3)]
Quaternion = Annotated[tuple[Real, Real, Real, Real], of_length(4)]
Sizes = Annotated[tuple[Length, Length, Length], of_length(3)]
Cells2 = Annotated[tuple[Count, Count], of_length(2)]
Cells3 = Annotated[tuple[Count, Count, Count], of_length(3)]
Point2 = Annotated[tuple[Coordinate, Coordinate], of_length(2)]
Interval = Annotated[tuple[Coordinate, Coordinate], of_length(2)]


class Pose(Strict):
    """A rigid placement: a point of the placed frame maps to ``R p + position_m``.

    Orientation by roll, pitch, yaw about the *fixed* axes x, y, z (the ROS convention), or by a unit
    quaternion x y z w, not both.
    """

    position_m: Position = Field(default=(0.0, 0.0, 0.0), description="origin of the placed frame")
    rpy_deg: Angles | None = Field(default=None, description="roll, pitch, yaw about the fixed axes x, y, z")
    quaternion_xyzw: Quaternion | None = Field(
        default=None, description="orientation as a unit quaternion; one of the two"
    )

    @model_validator(mode="after")
    def _one_orientation(self) -> Pose:
        if self.rpy_deg is not None and self.quaternion_xyzw is not None:
            raise trouble("has both rpy_deg and quaternion_xyzw.", "Keep one of the two.")
        if self.quaternion_xyzw is not None:
            norm = math.sqrt(sum(c * c for c in self.quaternion_xyzw))
            if abs(norm - 1.0) > 1e-3:
                raise trouble(
                    f"has length {norm:.6g}, but an orientation is a quaternion of length 1.",
                    "Divide it by its length; the order is x, y, z, w.",
                    "quaternion_xyzw",
                )
        return self

    def position(self) -> FloatArray:
        """Origin of the placed frame [m], shape ``(3,)``."""
        return np.array(self.position_m)

    def rotation(self) -> Rotation:
        """Orientation of the placed frame."""
        from scipy.spatial.transform import Rotation

        if self.quaternion_xyzw is not None:
            return Rotation.from_quat(self.quaternion_xyzw)
        return Rotation.from_euler("xyz", self.rpy_deg or (0.0, 0.0, 0.0), degrees=True)

    def quaternion(self) -> FloatArray:
        """Unit quaternion x y z w with w >= 0, shape ``(4,)``."""
        return np.asarray(self.rotation().as_quat(canonical=True), dtype=np.float64)

    def within(self, carrier: tuple[FloatArray, Rotation]) -> tuple[FloatArray, Rotation]:
        """Origin [m] ``(3,)`` and rotation in the world of this pose in a frame that is at ``carrier`` there."""
        origin, rotation = carrier
        return np.asarray(origin + rotation.apply(self.position())), rotation * self.rotation()

    def matrix(self) -> FloatArray:
        """Homogeneous transform, shape ``(4, 4)``."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation().as_matrix()
        matrix[:3, 3] = self.position_m
        return matrix
