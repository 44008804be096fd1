import numpy as np
import pytest

from sim_core.contact.shapes import BOX, CYLINDER, HALF_SPACE, SPHERE, signed_distance
from sim_core.core import language as lang
from sim_core.core.language import F1, F2, F3

ROUND = 1e-3
SHAPES = {
    "half space": [HALF_SPACE, 0, 0, 0, 0],
    "sphere": [SPHERE, 0.01, 0, 0, 0],
    "cylinder": [CYLINDER, 0.01, 0.02, ROUND, 0],
    "box": [BOX, 0.01, 0.015, 0.02, ROUND],
}


@lang.kernel
def _evaluate(y: F2, shape: F1, distance: F1, normal: F2, second: F3):
    for k in range(y.shape[0]):
        d, n, h = signed_distance(lang.Vector([y[k, 0], y[k, 1], y[k, 2]]), shape)
        distance[k] = d
        for i in range(3):
            normal[k, i] = n[i]
            for j in range(3):
                second[k, i, j] = h[i, j]


def evaluate(name, y):
    y = np.ascontiguousarray(np.atleast_2d(y), dtype=float)
    out = np.zeros(len(y)), np.zeros((len(y), 3)), np.zeros((len(y), 3, 3))
    _evaluate(y, np.array(SHAPES[name], dtype=float), *out)
    return out


def outside_points(name, count=200):
    y = np.random.default_rng(4).uniform(-0.03, 0.03, (count, 3))
    return y[evaluate(name, y)[0] > 1e-4]


@pytest.mark.parametrize("name", SHAPES)
def test_gradient_and_second_derivative_match_differences(name):
    y, h = outside_points(name), 1e-7
    _, normal, second = evaluate(name, y)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-12)
    for axis in range(3):
        shift = h * np.eye(3)[axis]
        plus, minus = evaluate(name, y + shift), evaluate(name, y - shift)
        smooth = np.abs(plus[2] - minus[2]).max(axis=(1, 2)) < 1.0
        assert smooth.mean() > 0.9
        np.testing.assert_allclose((plus[0] - minus[0]) / (2 * h), normal[:, axis], atol=1e-6)
        change = (plus[1] - minus[1]) / (2 * h)
        np.testing.assert_allclose(change[smooth], second[smooth][:, :, axis], atol=2e-3)


def test_distances_by_hand():
    assert evaluate("half space", [3.0, -2.0, 0.5])[0][0] == pytest.approx(0.5)
    assert evaluate("sphere", [0.0, 0.03, 0.04])[0][0] == pytest.approx(0.04)
    assert evaluate("cylinder", [0.03, 0.04, 0.005])[0][0] == pytest.approx(0.04)
    assert evaluate("cylinder", [0.0, 0.002, 0.03])[0][0] == pytest.approx(0.01)
    assert evaluate("box", [0.0, 0.025, 0.001])[0][0] == pytest.approx(0.01)
    corner = np.array([0.01, 0.015, 0.02]) - ROUND + 0.004
    assert evaluate("box", corner)[0][0] == pytest.approx(0.004 * np.sqrt(3) - ROUND)


@pytest.mark.parametrize("name", SHAPES)
def test_inside_is_negative_and_the_normal_leads_out(name):
    y = np.array([[0.004, 0.003, -0.002], [-0.001, 0.002, -0.004], [0.0009, -0.001, -0.001]])
    distance, normal, _ = evaluate(name, y)
    assert (distance < 0).all()
    out, _, _ = evaluate(name, y + normal * (-distance)[:, None])
    np.testing.assert_allclose(out, 0.0, atol=1e-12)


@pytest.mark.parametrize("name", SHAPES)
def test_second_derivative_is_continuous_neither_in_sign_nor_below_zero(name):
    """A convex shape has a convex distance: no contact normal can turn against the motion."""
    _, _, second = evaluate(name, outside_points(name))
    assert np.linalg.eigvalsh(second).min() > -1e-9
