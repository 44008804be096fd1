"""Mistakes in how a wrench is recorded: signs, axes, mounts and units."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import WrenchSensor
from sim_core.rigs.observers import NEWTONS
from sysid.settings.setup_check import SETUP_CHECK
from sysid.setup_check.mistakes import Mistake, axes_of, commonness, pose_text, signed_permutations

FORCE_UNITS = {unit: 1.0 / newtons for unit, newtons in NEWTONS.items() if unit != "N"}
"""How many of a unit are one newton."""

TORQUE_LENGTHS = {"mm": 1000.0, "cm": 100.0}
"""How many of a unit of length are one metre."""


def wrench_mistakes(name: str, sensor: WrenchSensor) -> Iterator[Mistake]:
    """All that are tried of one sensor."""
    one = np.eye(3)
    where = f"sensors.{name}"

    def axes(force: np.ndarray, torque: np.ndarray) -> str:
        parts = [f"{where}.force_axes: {axes_of(force)}"] if not np.array_equal(force, one) else []
        parts += [f"{where}.torque_axes: {axes_of(torque)}"] if not np.array_equal(torque, one) else []
        return ", ".join(parts)

    yield Mistake(
        "wrench reversed", f"{name} reports what acts by it, not on it: force and torque are reversed",
        axes(-one, -one), name, 4.0, _map(-one, -one),
    )  # fmt: skip
    yield Mistake(
        "force reversed", f"the force of {name} is reversed, and its torque not", axes(-one, one), name, 1.0,
        _map(-one, one),
    )  # fmt: skip
    yield Mistake(
        "torque reversed", f"the torque of {name} is reversed, and its force not", axes(one, -one), name, 1.0,
        _map(one, -one),
    )  # fmt: skip
    for matrix in signed_permutations():
        turned = np.linalg.det(matrix) > 0.0
        if np.array_equal(matrix, one):
            continue
        if turned:
            angle = np.degrees(Rotation.from_matrix(matrix).magnitude())
            yield Mistake(
                "wrench axes turned", f"the axes of {name} are turned by {angle:.0f} degrees ({axes_of(matrix)})",
                _pose_line(name, sensor, matrix), name, commonness(matrix), _map(matrix, matrix),
            )  # fmt: skip
        elif not np.array_equal(matrix, -one):
            for torque in (matrix, -matrix):
                yield Mistake(
                    "wrench axes left-handed", f"the axes of {name} are left-handed ({axes_of(matrix)})",
                    axes(matrix, torque), name, 0.5 * commonness(matrix), _map(matrix, torque),
                )  # fmt: skip
    for axis, vector in zip("xyz", one, strict=True):
        for degrees in SETUP_CHECK.mount_turns_deg:
            matrix = Rotation.from_rotvec(np.radians(degrees) * vector).inv().as_matrix()
            yield Mistake(
                "wrench mount turned", f"{name} is mounted turned by {degrees:g} degrees about its {axis} axis",
                _pose_line(name, sensor, matrix), name, 0.3, _map(matrix, matrix),
            )  # fmt: skip
    for unit, factor in FORCE_UNITS.items():
        yield Mistake(
            "force unit", f"the force of {name} is in {unit} and its torque in {unit} m",
            f"{where}.force_unit: {unit}", name, 1.0, _map(factor * one, factor * one),
        )  # fmt: skip
        yield Mistake(
            "force unit", f"the force of {name} is in {unit} and its torque in {unit} mm",
            f"{where}.force_unit: {unit}, {where}.length_unit: mm", name, 0.5, _map(factor * one, 1e3 * factor * one),
        )  # fmt: skip
        yield Mistake(
            "force unit", f"the force of {name} is in {unit}, its torque in N m", f"{where}.force_unit: {unit}, "
            f"and torques as they are: record both in newtons", name, 0.3, _map(factor * one, one),
        )  # fmt: skip
    for unit, factor in TORQUE_LENGTHS.items():
        yield Mistake(
            "torque unit", f"the torque of {name} is in N {unit}",
            f"{where}.length_unit: mm" if unit == "mm" else f"record the torque of {name} in N m", name, 1.0,
            _map(one, factor * one),
        )  # fmt: skip


def _map(force: np.ndarray, torque: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    def recorded(readings: np.ndarray) -> np.ndarray:
        return np.hstack([readings[:, :3] @ force.T, readings[:, 3:] @ torque.T])

    return recorded


def _pose_line(name: str, sensor: WrenchSensor, matrix: np.ndarray) -> str:
    """The pose of the frame in which readings v' = M v are right: R M^T."""
    turned = sensor.pose.rotation() * Rotation.from_matrix(matrix).inv()
    return f"sensors.{name}.pose: {pose_text(sensor.pose.position(), turned)}"
