"""Elastic stiffness of plates and solids from engineering constants."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sim_core.errors import ConfigError

LEAST_RATIO, LARGEST_RATIO = -1.0, 0.5
"""Poisson's ratio of an isotropic solid lies between these: there is no shear modulus, and no bulk modulus, beyond."""

_TINY = 1e-30


def poisson_ratios(owner: str, nu: float, shift: np.ndarray, thin: bool = False) -> np.ndarray:
    """Poisson's ratio of each element of ``owner``, ``(m,)``: the common one plus the ``shift`` of the element.
    ``thin``: in plane stress, where 0.5, of what keeps its volume, is a ratio like others."""
    ratios = nu + shift
    most = ratios <= LARGEST_RATIO if thin else ratios < LARGEST_RATIO
    wrong = np.flatnonzero(~((ratios > LEAST_RATIO) & most))
    if len(wrong):
        raise ConfigError(
            f"{owner}: nu = {ratios[wrong[0]]:.6g} is not between {LEAST_RATIO:g} and {LARGEST_RATIO:g}.",
            "Correct nu, or the field of it.",
        )
    return ratios


def plane_stress(parameters: Mapping[str, float], nu: np.ndarray | None = None) -> np.ndarray:
    """Plane-stress stiffness [Pa] ``(3, 3)`` in the sheet's material axes, Voigt order 11, 22, 12 (2 eps_12).

    ``E_pa``, ``nu``: isotropic constants; other ratios ``nu`` ``(...)`` make it ``(..., 3, 3)``.
    ``anisotropy_ratio`` r = E_1 / E_2 (1 when absent) and
    ``grain_angle_rad`` (direction 1 against the body's x axis) make it orthotropic with the
    geometric mean kept: E_1 = E sqrt(r), E_2 = E / sqrt(r), nu_12 = nu sqrt(r), nu_21 = nu / sqrt(r),
    G = E / (2 (1 + nu)); nu_12 nu_21 = nu^2 < 1 keeps it positive definite. Jones, Mechanics of
    Composite Materials, 2nd ed., eq. 2.70 and 2.79.
    """
    young, ratios = parameters["E_pa"], np.asarray(parameters["nu"] if nu is None else nu)
    anisotropy = parameters.get("anisotropy_ratio", 1.0)
    root, scale = np.sqrt(anisotropy), young / (1.0 - ratios * ratios)
    axes = np.zeros((*ratios.shape, 3, 3), dtype=np.result_type(scale, root))
    axes[..., 0, 0], axes[..., 1, 1] = root * scale, scale / root
    axes[..., 0, 1] = axes[..., 1, 0] = ratios * scale
    axes[..., 2, 2] = young / (2.0 * (1.0 + ratios))
    if anisotropy == 1.0:
        return axes
    angle = parameters.get("grain_angle_rad", 0.0)
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2 * c * s, 2 * c * s, c * c - s * s]])
    return np.asarray(rotation.T @ axes @ rotation)


def plane_stress_by_nu(parameters: Mapping[str, float], nu: np.ndarray) -> np.ndarray:
    """Derivative of :func:`plane_stress` by the ratios ``nu`` ``(...)`` [Pa] ``(..., 3, 3)``: the part of a step along
    the imaginary axis, which has no cancellation (Squire & Trapp, SIAM Review 40, 1998)."""
    return np.asarray(plane_stress(parameters, nu + 1j * _TINY).imag / _TINY)


def plane_stress_by(parameters: Mapping[str, float], quantity: str, nu: np.ndarray) -> np.ndarray:
    """Derivative of :func:`plane_stress` by one of its constants, with the ratios ``nu`` ``(...)``; zero by what is
    none, ``(..., 3, 3)``."""
    if quantity == "nu":
        return plane_stress_by_nu(parameters, nu)
    stepped: dict[str, Any] = {**parameters, quantity: parameters[quantity] + 1j * _TINY}
    return np.asarray(plane_stress(stepped, nu).imag / _TINY)


def applied(stiffness: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Products ``(m, 3)`` of symmetric matrices, one for all ``(3, 3)`` or one each ``(m, 3, 3)``, with vectors
    ``(m, 3)``."""
    return np.asarray((stiffness @ vectors[..., None])[..., 0])
