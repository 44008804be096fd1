"""Elastic stiffness of plates and solids from engineering constants."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def plane_stress(parameters: Mapping[str, float]) -> np.ndarray:
    """Plane-stress stiffness [Pa] in the sheet's material axes, Voigt order 11, 22, 12 (2 eps_12).

    ``E_pa``, ``nu``: isotropic constants. ``anisotropy_ratio`` r = E_1 / E_2 (1 when absent) and
    ``grain_angle_rad`` (direction 1 against the body's x axis) make it orthotropic with the
    geometric mean kept: E_1 = E sqrt(r), E_2 = E / sqrt(r), nu_12 = nu sqrt(r), nu_21 = nu / sqrt(r),
    G = E / (2 (1 + nu)); nu_12 nu_21 = nu^2 < 1 keeps it positive definite. Jones, Mechanics of
    Composite Materials, 2nd ed., eq. 2.70 and 2.79.
    """
    young, nu = parameters["E_pa"], parameters["nu"]
    ratio = parameters.get("anisotropy_ratio", 1.0)
    shear = young / (2.0 * (1.0 + nu))
    if ratio == 1.0:
        scale = young / (1.0 - nu * nu)
        return np.array([[scale, nu * scale, 0.0], [nu * scale, scale, 0.0], [0.0, 0.0, shear]])
    root = np.sqrt(ratio)
    scale = young / (1.0 - nu * nu)
    axes = np.array([[root * scale, nu * scale, 0.0], [nu * scale, scale / root, 0.0], [0.0, 0.0, shear]])
    angle = parameters.get("grain_angle_rad", 0.0)
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2 * c * s, 2 * c * s, c * c - s * s]])
    return np.asarray(rotation.T @ axes @ rotation)
