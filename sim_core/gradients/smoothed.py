"""The gradient of a loss that is smoothed by noise: what there is to descend where the loss itself jumps or kinks.

    L_s(theta) = E L(theta + sigma w),    w standard normal

Two estimates of dL_s/dtheta from pairs of rollouts at theta + sigma w and theta - sigma w:

    first order    mean of [grad L(+) + grad L(-)] / 2
    zeroth order   mean of w [L(+) - L(-)] / (2 sigma) - (w w^T - 1) b

The first has little noise, but knows nothing of jumps: where L is discontinuous it is the derivative of the parts
alone, wrong however many samples there are, with a standard error that does not say so. The second is right for any
loss. b is the mean of the exact gradients of all other pairs, a baseline for the linear part of the loss: w w^T - 1 has
no mean and does not depend on b, so b takes noise away and changes no expectation. What is left of a nearly linear
loss is due to few large w: fewer than some hundred pairs may then have too small a standard error. So may they where
the loss jumps so far away that few of them see it.

Both are combined component by component (Suh, Simchowitz, Zhang & Tedrake, Do differentiable simulators give better
policy gradients?, ICML 2022, sec. 4):

    alpha g_1 + (1 - alpha) g_0,    alpha = alpha_least where |g_1 - g_0| <= epsilon, else 0

alpha_least has the least empirical variance; epsilon is the 95 % confidence radius of g_0. Where the two contradict
each other by more than chance explains, they keep (gamma - epsilon) / |g_1 - g_0| of the first order, with a tolerated
error gamma that is the user's; here none of it is kept. So the combination is never farther from the zeroth order than
that is uncertain. Its weights come from the same samples, which is a bias of a part of its error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.errors import ConfigError, ConvergenceError
from sim_core.gradients.adjoint import simulate_adjoint
from sim_core.gradients.directions import directions
from sim_core.gradients.losses import Loss
from sim_core.rigs import Rig, resolve_name, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.solve.step import NewtonSettings

CONFIDENCE = 1.96
"""Standard errors in a radius of 95 % confidence."""

Evaluate = Callable[[np.ndarray], tuple[float, np.ndarray]]
"""Value and gradient ``(n,)`` of a loss at parameters ``(n,)``; raises ``ConvergenceError`` when a rollout fails, and
``ConfigError`` where there is none."""


@dataclass(frozen=True)
class Estimate:
    """``gradient`` of the smoothed loss and its standard ``error``, ``(n,)``."""

    gradient: np.ndarray
    error: np.ndarray


@dataclass(frozen=True)
class Smoothed:
    """``loss``: the smoothed loss, with its standard error ``loss_error``; ``first``, ``zeroth``, ``combined``:
    estimates of its gradient; ``alpha``: share ``(n,)`` of the first order in the combination, whose error is that of
    chance alone; ``pairs``: of rollouts that came to an end; ``failures``: parameters ``(n,)`` at which a rollout
    failed [their units], and what it said. A pair of which one failed is left out: all is given that nothing fails."""

    loss: float
    loss_error: float
    first: Estimate
    zeroth: Estimate
    combined: Estimate
    alpha: np.ndarray
    pairs: int
    failures: tuple[tuple[np.ndarray, str], ...]


def smoothed_gradient(
    evaluate: Evaluate, at: np.ndarray, sigma: np.ndarray | float, *, pairs: int = 32, seed: int = 0
) -> Smoothed:
    """Gradient at the parameters ``at`` ``(n,)`` of a loss smoothed by ``sigma``, ``(n,)`` or one for all [their
    units].

    ``pairs``: of rollouts to be made. The same ``seed`` gives the same bits. Raises ``ConvergenceError`` when fewer
    than two pairs come to an end.
    """
    at = np.atleast_1d(np.asarray(at, dtype=float))
    width = np.broadcast_to(np.asarray(sigma, dtype=float), at.shape)
    if not (np.isfinite(width).all() and (width > 0.0).all()):
        raise ConfigError(f"The width of smoothing {sigma} is not finite and above zero.", "Give a positive sigma.")
    if pairs < 2:
        raise ConfigError(f"{pairs} pairs of rollouts have no standard error.", "Make at least 2, better 30.")
    made, losses, gradients = [], [], []
    failures: list[tuple[np.ndarray, str]] = []
    for w in np.random.default_rng(seed).standard_normal((pairs, len(at))):
        try:
            ends = [_evaluated(evaluate, at + sign * width * w, failures) for sign in (1.0, -1.0)]
        except ConvergenceError:
            continue
        made.append(w)
        losses.append([value for value, _ in ends])
        gradients.append(width * np.mean([slope for _, slope in ends], axis=0))
    if len(made) < 2:
        raise ConvergenceError(
            f"Of {pairs} pairs of rollouts {len(made)} came to an end; the last failure: {failures[-1][1]}",
            "Smooth by less, or start from parameters at which rollouts do not fail.",
        )
    return _estimates(np.array(made), np.array(losses), np.array(gradients), width, tuple(failures))


def rollout_loss(
    rig: Rig,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    loss: Loss,
    names: Sequence[str],
    settings: NewtonSettings | None = None,
) -> Evaluate:
    """Loss of rollouts of a rig at ``times`` [s] ``(n,)`` as a function of its parameters ``names`` ``(k,)``, in their
    units, which also gives the derivatives ``(k,)`` by them."""
    full, scene = [resolve_name(rig, name) for name in names], build_scene(rig)

    def evaluate(values: np.ndarray) -> tuple[float, np.ndarray]:
        scene.use(with_parameters(rig, dict(zip(full, values.tolist(), strict=True))))
        found = simulate_adjoint(scene, poses, times, loss, directions(scene.rig, full), settings=settings)
        return found.value, np.array([found.parameters[name] for name in full])

    return evaluate


def _evaluated(evaluate: Evaluate, at: np.ndarray, failures: list[tuple[np.ndarray, str]]) -> tuple[float, np.ndarray]:
    try:
        value, slope = evaluate(at)
    except ConvergenceError as error:
        failures.append((at, str(error)))
        raise
    except ConfigError as error:
        raise ConfigError(
            f"Smoothing leaves what can be simulated, at {at}: {error.problem}",
            "Smooth by less, so that bounds are five sigma away, or by the logarithm of the parameter.",
        ) from error
    if not (np.isfinite(value) and np.isfinite(slope).all()):
        raise ConfigError(f"The loss or its gradient is not finite at {at}.", "Correct the loss.")
    return value, slope


def _estimates(
    w: np.ndarray,
    losses: np.ndarray,
    gradients: np.ndarray,
    width: np.ndarray,
    failures: tuple[tuple[np.ndarray, str], ...],
) -> Smoothed:
    """Estimates from pairs: noise ``(N, n)``, losses ``(N, 2)``, mean gradients by w ``(N, n)``."""
    count = len(w)
    others = (gradients.sum(axis=0) - gradients) / (count - 1)
    odd = 0.5 * (losses[:, 0] - losses[:, 1]) - (w * others).sum(axis=1)
    first, zeroth = gradients / width, (odd[:, None] * w + others) / width
    g1, g0 = first.mean(axis=0), zeroth.mean(axis=0)
    spread1, spread0 = first - g1, zeroth - g0
    gain = (spread0 * (spread0 - spread1)).sum(axis=0)
    total = ((spread0 - spread1) ** 2).sum(axis=0)
    least = np.clip(np.divide(gain, total, out=np.ones_like(gain), where=total > 0.0), 0.0, 1.0)
    radius, apart = CONFIDENCE * _error(zeroth), np.abs(g1 - g0)
    alpha = np.where(apart <= radius, least, 0.0)
    combined = alpha * first + (1.0 - alpha) * zeroth
    value = losses.mean(axis=1)
    return Smoothed(
        float(value.mean()),
        float(_error(value)),
        _estimate(first),
        _estimate(zeroth),
        _estimate(combined),
        alpha,
        count,
        failures,
    )


def _estimate(samples: np.ndarray) -> Estimate:
    return Estimate(samples.mean(axis=0), _error(samples))


def _error(samples: np.ndarray) -> np.ndarray:
    """Standard error of a mean over the first axis."""
    return np.asarray(samples.std(axis=0, ddof=1) / np.sqrt(len(samples)))
