"""Mistakes in how markers are recorded, in space or in a picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import MarkerSensor
from sim_core.rigs.observers import Camera
from sysid.settings.setup_check import SETUP_CHECK
from sysid.setup_check.mistakes import Mistake, axes_of, commonness, pose_text, signed_permutations

LENGTHS = {"mm": 1e3, "cm": 1e2, "inch": 1.0 / 0.0254}
"""How many of a unit of length are one metre."""

PICTURES = {
    "[-u, v]": (-1.0, 0.0, 0.0, 1.0),
    "[u, -v]": (1.0, 0.0, 0.0, -1.0),
    "[-u, -v]": (-1.0, 0.0, 0.0, -1.0),
    "[v, u]": (0.0, 1.0, 1.0, 0.0),
    "[-v, -u]": (0.0, -1.0, -1.0, 0.0),
    "[v, -u]": (0.0, 1.0, -1.0, 0.0),
    "[-v, u]": (0.0, -1.0, 1.0, 0.0),
}
"""Ways in which pictures are flipped or turned: where u and v that are recorded point."""


def marker_mistakes(name: str, sensor: MarkerSensor) -> Iterator[Mistake]:
    """All that are tried of one sensor of markers in space."""
    for matrix in signed_permutations()[1:]:
        turned = np.linalg.det(matrix) > 0.0
        line = _pose_line(name, sensor, matrix) if turned else f"sensors.{name}.axes: {axes_of(matrix)}"
        word = "turned" if turned else "left-handed"
        yield Mistake(
            f"marker axes {word}", f"the axes of {name} are {word} ({axes_of(matrix)})", line, name,
            commonness(matrix), _space(matrix),
        )  # fmt: skip
    for axis, vector in zip("xyz", np.eye(3), strict=True):
        for degrees in SETUP_CHECK.mount_turns_deg:
            matrix = Rotation.from_rotvec(np.radians(degrees) * vector).inv().as_matrix()
            yield Mistake(
                "marker mount turned", f"the frame of {name} is turned by {degrees:g} degrees about its {axis} axis",
                _pose_line(name, sensor, matrix), name, 0.5, _space(matrix),
            )  # fmt: skip
    for unit, factor in LENGTHS.items():
        line = f"sensors.{name}.length_unit: mm" if unit == "mm" else f"record the positions of {name} in metres"
        yield Mistake(
            "marker unit", f"the positions of {name} are in {unit}", line, name, 1.0, _space(factor * np.eye(3))
        )
    yield Mistake(
        "displacements for positions", f"x, y and z of {name} are displacements, not positions",
        f"record the positions of {name} in x, y, z", name, 1.0, _from_first,
    )  # fmt: skip


def picture_mistakes(name: str, camera: Camera) -> Iterator[Mistake]:
    """All that are tried of one camera."""
    size = np.array([camera.width_px, camera.height_px], dtype=float)
    centre = 0.5 * (size - 1.0)
    for axes, entries in PICTURES.items():
        matrix = np.array(entries).reshape(2, 2)
        mirrored = np.linalg.det(matrix) < 0.0
        there = centre[::-1] if matrix[0, 0] == 0.0 else centre
        yield Mistake(
            "picture mirrored" if mirrored else "picture turned",
            f"the pictures of {name} are {'mirrored' if mirrored else 'turned'} ({axes})",
            f"cameras.{name}.picture_axes: {axes}", name, 1.0, _plane(matrix, centre, there),
        )  # fmt: skip
    middle = np.array([camera.cx_px, camera.cy_px])
    for degrees in SETUP_CHECK.mount_turns_deg:
        angle = np.radians(degrees)
        matrix = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        turned = camera.pose.rotation() * Rotation.from_rotvec([0.0, 0.0, angle])
        yield Mistake(
            "camera turned", f"{name} is turned by {degrees:g} degrees about its optical axis",
            f"cameras.{name}.pose: {pose_text(camera.pose.position(), turned)}",
            name, 0.5, _plane(matrix, middle, middle),
        )  # fmt: skip
    for factor, word in ((0.5, "half"), (2.0, "twice")):
        yield Mistake(
            "picture size", f"the pictures of {name} have {word} as many pixels along u and v as the rig says",
            f"cameras.{name}: scale width_px, height_px and the intrinsics by {factor:g}", name, 0.5,
            _plane(factor * np.eye(2), np.zeros(2), np.zeros(2)),
        )  # fmt: skip


def _space(matrix: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    return lambda readings: (readings.reshape(len(readings), -1, 3) @ matrix.T).reshape(readings.shape)


def _from_first(readings: np.ndarray) -> np.ndarray:
    return np.asarray(readings - readings[:1])


def _plane(matrix: np.ndarray, centre: np.ndarray, there: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Pixels about one point mapped to those about another."""
    return lambda readings: ((readings.reshape(len(readings), -1, 2) - centre) @ matrix.T + there).reshape(
        readings.shape
    )


def _pose_line(name: str, sensor: MarkerSensor, matrix: np.ndarray) -> str:
    turned = sensor.pose.rotation() * Rotation.from_matrix(matrix).inv()
    return f"sensors.{name}.pose: {pose_text(sensor.pose.position(), turned)}"
