"""Least squares with kinks: steps that are refused at one are learnt from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import least_squares

from sysid.solve.nonsmooth_trust_region import AT_JUMP, AT_KINK, AT_MINIMUM, LOST, USED_UP, End, Point, minimise

Residuals = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Residuals ``(n,)`` and their derivatives ``(n, p)``."""

WIDE = (np.full(2, -10.0), np.full(2, 10.0))


class Counted:
    """Looks at a problem, at most so often; ``broken``: where there is nothing to see."""

    def __init__(self, residuals: Residuals, most: int, broken: Callable[[np.ndarray], bool] = lambda x: False) -> None:
        self.residuals, self.most, self.broken, self.done = residuals, most, broken, 0

    def look(self, x: np.ndarray) -> Point | None:
        self.done += 1
        return None if self.broken(x) else Point(x, *self.residuals(x))

    def minimise(
        self, start: list[float], bounds: tuple[np.ndarray, np.ndarray] = WIDE, tolerance: float = 1e-9
    ) -> End:
        first = self.look(np.array(start))
        assert first is not None
        return minimise(self.look, first, bounds, tolerance=tolerance, go_on=lambda: self.done < self.most)


def curved(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rosenbrock's valley; least at (1, 1)."""
    r = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
    return r, np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


def sharp(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A stiffness and an offset across whose kink every marker is missed by more; least at (1.5, 0).

    What one side says of the offset is that the other one is better."""
    side = 1.0 if x[1] >= 0.0 else -1.0
    r = np.array([x[0] - 1.5, 3.0 + 40.0 * abs(x[1]), 1.0 - 0.2 * x[1]])
    return r, np.array([[1.0, 0.0], [0.0, 40.0 * side], [0.0, -0.2]])


def hidden(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same with the derivatives of the other side just where the search begins, as of a node at rest."""
    r, j = sharp(x)
    if x[1] == 0.0:
        j[1, 1] = -40.0
    return r, j


def rough(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two slopes under folds of one size, on every second side of which derivatives have the wrong sign."""
    phase = np.modf(5.0 * np.abs(x))[0]
    wave = 1.2 / 5.0 * np.minimum(phase, 1.0 - phase)
    slope = np.where(phase < 0.5, 1.2, -1.2)
    smooth = np.array([[1.0, 0.3], [0.2, 1.0], [0.5, -0.4]])
    return smooth @ (x + np.sign(x) * wave - np.array([1.0, -2.0])), smooth * (1.0 + slope)


def test_a_smooth_valley_is_followed_to_its_end() -> None:
    valley = Counted(curved, 60)
    end = valley.minimise([-1.2, 1.0])
    assert end.converged
    assert end.best.x == pytest.approx([1.0, 1.0], abs=1e-4)
    assert valley.done < 35


def test_a_linear_problem_takes_one_step_and_no_more_than_bounds_allow() -> None:
    line = Counted(lambda x: (x - np.array([0.7, 0.2]), np.eye(2)), 10)
    end = line.minimise([0.0, 0.0], (np.array([-1.0, -1.0]), np.array([0.5, 1.0])))
    assert end.converged and end.message == AT_MINIMUM
    assert end.best.x == pytest.approx([0.5, 0.2], abs=1e-4)
    assert line.done == 2


def test_a_kink_in_one_parameter_does_not_hold_up_another() -> None:
    found = Counted(hidden, 12)
    end = found.minimise([0.0, 0.0])
    assert end.best.x[0] == pytest.approx(1.5, abs=0.02)
    # A trust region that learns nothing from what it refuses shrinks as often in both.
    plain = least_squares(
        lambda x: hidden(x)[0], [1e-12, 0.0], jac=lambda x: hidden(x)[1], max_nfev=12, ftol=1e-12, xtol=1e-12
    )
    assert abs(plain.x[0] - 1.5) > 0.5


def test_many_kinks_are_passed_over() -> None:
    """From most starts; Gauss-Newton alone stays on the side of the fold where it begins."""
    begun = [[3.0, 3.0], [-2.0, 1.0], [2.5, -0.3], [0.2, 2.2], [-3.0, -3.1]]
    ends = [Counted(rough, 25).minimise(start, tolerance=1e-4).best.square for start in begun]
    plain = [least_squares(lambda x: rough(x)[0], s, jac=lambda x: rough(x)[1], max_nfev=25).cost * 2.0 for s in begun]
    assert np.median(ends) < 0.01 < 1.0 < np.median(plain)


def test_where_there_is_nothing_to_see_shorter_steps_are_taken() -> None:
    found = Counted(curved, 80, broken=lambda x: bool(abs(x[0] - 0.2) < 0.05 and x[1] < 0.0))
    end = found.minimise([-1.2, 1.0])
    assert end.converged
    assert end.best.x == pytest.approx([1.0, 1.0], abs=1e-4)


def test_evaluations_that_are_used_up_are_said() -> None:
    end = Counted(curved, 4).minimise([-1.2, 1.0])
    assert not end.converged and end.message == USED_UP
    assert end.best.square < Point(np.zeros(2), *curved(np.array([-1.2, 1.0]))).square


def far(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One slope, least at 6, where a tenth of a unit brings less than chance at first."""
    return (x[:1] - 6.0) / 3.0, np.array([[1.0 / 3.0]])


LINE = (np.array([-10.0]), np.array([10.0]))


def test_a_small_region_to_begin_with_does_not_end_a_search() -> None:
    seen = Counted(far, 30)
    first = seen.look(np.zeros(1))
    assert first is not None
    end = minimise(seen.look, first, LINE, tolerance=0.5, go_on=lambda: seen.done < seen.most, radius=0.1)
    assert end.converged and end.message == AT_MINIMUM
    assert end.best.square < 0.5


def test_what_cannot_be_simulated_is_no_minimum() -> None:
    end = Counted(far, 30, broken=lambda x: bool(x[0] > 0.02)).minimise([0.0], LINE, tolerance=0.5)
    assert not end.converged and end.message == LOST


@pytest.mark.parametrize("start", [-1.0, 0.6, 0.9])
def test_next_to_a_jump_nothing_has_converged(start: float) -> None:
    """A line with a step in it: least at 0.1 beyond the step, where it has no minimum but at the edge."""

    def stepped(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([10.0 * (x[0] - 1.0) + 9.0 * (x[0] > 0.5), x[1]]), np.diag([10.0, 1.0])

    end = Counted(stepped, 200).minimise([start, 1.0], tolerance=0.5)
    assert not end.converged and end.message == AT_JUMP


@pytest.mark.parametrize("start", [[3.0, 0.5], [0.0, -0.3]])
def test_next_to_a_kink_it_has(start: list[float]) -> None:
    end = Counted(sharp, 200).minimise(start, tolerance=1e-6)
    assert end.converged and end.message in (AT_KINK, AT_MINIMUM)
    np.testing.assert_allclose(end.best.x, [1.5, 0.0], atol=1e-4)


def test_a_jump_before_little_is_as_good_as_a_kink() -> None:
    """Derivatives promise less beyond than decides on an interval."""

    def stepped(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([10.0 * (x[0] - 1.0) + 9.0 * (x[0] > 0.5), x[1]]), np.diag([10.0, 1.0])

    end = Counted(stepped, 200).minimise([0.6, 1.0], tolerance=3.0)
    assert end.converged and end.message == AT_KINK


def test_steps_within_the_tolerance_are_taken_until_they_are_short() -> None:
    """A few, and none that makes it worse."""
    for longest, most in ((1e-3, 10), (0.0, 5)):
        problem = Counted(curved, 50)
        first = problem.look(np.array([0.9, 0.8]))
        assert first is not None
        steps: list[float] = []

        def short(step: np.ndarray, steps: list[float] = steps, longest: float = longest) -> bool:
            steps.append(float(np.max(np.abs(step))))
            return steps[-1] <= longest

        end = minimise(problem.look, first, WIDE, tolerance=1.0, go_on=lambda: True, short=short)
        assert end.converged and end.message == AT_MINIMUM
        assert problem.done <= most
        assert steps[0] > 0.05 and np.max(np.abs(end.best.x - 1.0)) < 0.01


def test_a_step_within_the_tolerance_that_makes_it_worse_is_the_end() -> None:
    """What lies beyond it is no more than the tolerance, and is not looked for."""
    problem = Counted(sharp, 50)
    first = problem.look(np.array([1.4, 0.0]))
    assert first is not None
    end = minimise(problem.look, first, WIDE, tolerance=100.0, go_on=lambda: True, short=lambda step: False)
    assert end.converged and end.message == AT_MINIMUM and problem.done == 2
    assert end.best is first
