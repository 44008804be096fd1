"""Rotations between two others: closed forms about one axis."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.geometry.turns import geodesic, turn_slopes

SHARES = np.array([0.0, 0.3, 1.0])


def about(axis: np.ndarray, angles: np.ndarray) -> Rotation:
    return Rotation.from_rotvec(np.asarray(angles)[..., None] * axis / np.linalg.norm(axis))


def test_a_turn_about_one_axis_has_the_share_of_the_angle() -> None:
    axis = np.array([1.0, -2.0, 0.5])
    found = geodesic(about(axis, np.array([0.2, 0.2, 0.2])), about(axis, np.array([1.4, 1.4, 1.4])), SHARES)
    np.testing.assert_allclose(found.as_quat(), about(axis, 0.2 + 1.2 * SHARES).as_quat(), atol=1e-14)


def test_one_rotation_goes_by_one_share() -> None:
    axis = np.array([0.0, 0.0, 1.0])
    found = geodesic(about(axis, np.array(0.0)), about(axis, np.array(1.0)), 0.25)
    assert found.as_rotvec() == pytest.approx([0.0, 0.0, 0.25])


def test_slopes_of_a_geodesic_between_equal_rotations_are_its_shares() -> None:
    turn = about(np.array([1.0, 1.0, 0.0]), np.array([0.4, 0.4, 0.4]))
    by_one, by_other = turn_slopes(lambda a, b: geodesic(a, b, SHARES), turn, turn)
    np.testing.assert_allclose(by_one, (1.0 - SHARES)[:, None, None] * np.eye(3), atol=1e-9)
    np.testing.assert_allclose(by_other, SHARES[:, None, None] * np.eye(3), atol=1e-9)
