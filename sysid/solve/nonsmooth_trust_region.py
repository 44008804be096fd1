"""Least squares whose residuals are smooth only in pieces: a trust region with a model that sees beyond a kink.

Where a node comes into contact, or begins to slip, residuals have a kink, and the derivatives at one point say nothing
of the other side. A Gauss-Newton step across it is refused, and a trust region that learns nothing from that shrinks
in all directions until it creeps along the kink. But a point that was refused has been evaluated with its derivatives.
Residual i, in pieces linear with one kink between the best point x and another one x_k = x + d, has it at the share
1 - theta of the way, where

    theta_i = (r_i(x_k) - r_i(x) - J_i(x) d) / ((J_i(x_k) - J_i(x)) d)   within 0 and 1,

and J_k = J_i(x) + theta_i (J_i(x_k) - J_i(x)) are its mean derivatives on the way, component by component (by a secant
alone a change would be put down to the longest component of d). Which of them hold where the next step leads is not
known, so the model is the mean over what was seen,

    m(s) = 1 / (1 + K) sum_{k=0..K} |r + J_k s|^2 = |r + <J> s|^2 + <|(J_k - <J>) s|^2>,   J_0 = J(x),

whose last term keeps the step short along what the pieces disagree about, and along that alone. Those points take part
that are within the trust region and at which J(x) is wrong; while steps do what it says there are none, and the model
is that of Gauss-Newton. As the region shrinks points drop out of it, so that nothing that x itself promises is missed.
Where rollouts jump no derivative tells: residuals then change by more than any theta_i within 0 and 1 makes of it. A
search that ends there has not converged if the derivatives promise much beyond.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from sysid.settings.solve import SOLVE

AT_MINIMUM = "no step promises more than chance makes of chi-square"
AT_KINK = "it stands at a kink or a small jump, beyond which derivatives do not tell what is better"
AT_JUMP = "it stands at a jump of the readings, over which derivatives do not lead: start from elsewhere ('--starts 5')"
LOST = "what promises more cannot be simulated, or hides what was seen"
USED_UP = "the evaluations allowed were used up"


@dataclass(frozen=True)
class Point:
    """Residuals ``(n,)`` and derivatives ``(n, p)`` at ``x`` ``(p,)``."""

    x: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray

    @property
    def square(self) -> float:
        return float(self.residual @ self.residual)


@dataclass(frozen=True)
class End:
    """Where a search has ended: the best point, whether no step promised more, why it ended, in words, and the radius
    of the trust region then."""

    best: Point
    converged: bool
    message: str
    radius: float


def minimise(
    look: Callable[[np.ndarray], Point | None],
    begin: Point,
    bounds: tuple[np.ndarray, np.ndarray],
    *,
    tolerance: float,
    go_on: Callable[[], bool],
    short: Callable[[np.ndarray], bool] = lambda step: True,
    radius: float = 1.0,
) -> End:
    """The least sum of squares that is found from ``begin`` within ``bounds`` ``((p,), (p,))``.

    ``look``: the point at a place, None where there is none; unknowns should be of order 1. ``tolerance``: fall of the
    sum of squares below which the search ends where the step ``(p,)`` from the best point looked at is ``short`` too;
    ``go_on``: false when no more evaluations are to be made; ``radius``: of the trust region at first, in the largest
    component.
    """
    best, refused, fine, doubtful, lost = begin, 0, 0, False, False
    near: list[Point] = []
    while True:
        neighbours = [p for p in near if _within(p, best, SOLVE.model_radii * radius) and _other(p, best, tolerance)][
            -SOLVE.model_points :
        ]
        step, promised = _step(best, [_on_the_way(best, p) for p in neighbours], radius, bounds)
        if promised <= tolerance and neighbours:
            radius, doubtful = 0.5 * radius, True
            continue
        length = float(np.max(np.abs(step)))
        cut = length > SOLVE.cut_step_share * radius
        if promised <= tolerance and cut and not doubtful:
            radius *= 2.0
            continue
        small = promised <= tolerance
        if small and (cut or not go_on() or short(step)):
            return End(best, not (cut and lost), LOST if cut and lost else AT_KINK if cut else AT_MINIMUM, radius)
        if radius < SOLVE.smallest_radius:
            return _edge(best, near[-1:], bounds, tolerance, radius)
        if not go_on():
            return End(best, False, USED_UP, radius)
        there = look(best.x + step)
        if small and (there is None or there.square >= best.square):
            return End(best, True, AT_MINIMUM, radius)
        refused += 1
        doubtful = lost = there is None
        if there is None:
            radius = SOLVE.radius_after_refusals * length
            continue
        share = (best.square - there.square) / promised
        if share < 0.0 and float(np.sum((best.jacobian @ step) ** 2)) < SOLVE.negligible_change_share * tolerance:
            return _edge(best, [there], bounds, tolerance, radius)
        if share < SOLVE.poor_fall_share:
            # The first time the model has something to learn.
            radius = (SOLVE.radius_after_refusal if refused == 1 else SOLVE.radius_after_refusals) * length
        elif share > SOLVE.good_fall_share:
            radius = max(radius, 2.0 * length)
        better = there.square < best.square
        refused, doubtful = (0, share < SOLVE.poor_fall_share) if better else (refused, True)
        little = share >= SOLVE.poor_fall_share and best.square - there.square <= tolerance and not cut
        fine += little
        near = [*near, best if better else there][-SOLVE.kept_points :]
        best = there if better else best
        if little and fine == SOLVE.final_steps:
            return End(best, True, AT_MINIMUM, radius)


def _edge(
    best: Point, refused: list[Point], bounds: tuple[np.ndarray, np.ndarray], tolerance: float, radius: float
) -> End:
    """The end at the best point though derivatives promise more: at a kink, or at a jump that hides much."""
    hidden = _step(best, [], 1.0, bounds)[1]
    if hidden > SOLVE.serious_fall * tolerance and any(_jump(best, p) > tolerance for p in refused):
        return End(best, False, AT_JUMP, radius)
    return End(best, True, AT_KINK, radius)


def _jump(best: Point, point: Point) -> float:
    """By how much less the sum of squares at a point would be without what no kink in each residual explains."""
    bent, missed = _apart(best, point)
    jumps = missed - np.clip(missed, np.minimum(bent, 0.0), np.maximum(bent, 0.0))
    smooth = point.residual - jumps
    return point.square - float(smooth @ smooth)


def _within(point: Point, best: Point, reach: float) -> bool:
    return bool(np.max(np.abs(point.x - best.x)) <= reach)


def _other(point: Point, best: Point, tolerance: float) -> bool:
    """The derivatives at the best do not hold as far as this point."""
    said = best.residual + best.jacobian @ (point.x - best.x)
    predicted = float(said @ said)
    return abs(predicted - point.square) > SOLVE.beyond_kink_share * (abs(predicted - best.square) + tolerance)


def _on_the_way(best: Point, point: Point) -> np.ndarray:
    """Mean derivatives between the best point and another, J_k of the model."""
    bent, missed = _apart(best, point)
    theta = np.clip(np.divide(missed, bent, out=np.full_like(bent, 0.5), where=bent != 0.0), 0.0, 1.0)
    return np.asarray(best.jacobian + theta[:, None] * (point.jacobian - best.jacobian))


def _apart(best: Point, point: Point) -> tuple[np.ndarray, np.ndarray]:
    """What the derivatives at a point say otherwise than those at the best of the way between ``(n,)``, and what the
    latter miss at its end ``(n,)``."""
    away = point.x - best.x
    bent = (point.jacobian - best.jacobian) @ away
    return bent, point.residual - best.residual - best.jacobian @ away


def _step(
    best: Point, others: list[np.ndarray], radius: float, bounds: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, float]:
    """The step of the model within radius and bounds, and the fall of the sum of squares that it promises."""
    low = np.minimum(np.maximum(bounds[0] - best.x, -radius), 0.0) - 1e-15
    high = np.maximum(np.minimum(bounds[1] - best.x, radius), 0.0) + 1e-15
    parts = [_triangle(np.column_stack([j, best.residual])) for j in (best.jacobian, *others)]
    model = _triangle(np.vstack(parts) / np.sqrt(len(parts)))
    matrix = np.vstack([model[:, :-1], np.sqrt(SOLVE.step_ridge) * np.eye(len(best.x))])
    step = lsq_linear(matrix, -np.concatenate([model[:, -1], np.zeros(len(best.x))]), (low, high), method="bvls").x
    step = np.clip(best.x + step, *bounds) - best.x
    left = model[:, -1] + model[:, :-1] @ step
    return step, best.square - float(left @ left)


def _triangle(matrix: np.ndarray) -> np.ndarray:
    """R of the QR factorisation, which keeps all sums of squares."""
    return np.asarray(np.linalg.qr(matrix)[1])
