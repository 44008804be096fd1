"""Smoothed gradients: closed forms of toy losses, and a block that tips over or does not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import roots_legendre
from scipy.stats import norm

from sim_core.errors import ConfigError, ConvergenceError
from sim_core.gradients import rollout_loss, smoothed_gradient
from sim_core.rigs import parse_rig

TALL_BLOCK = {
    "name": "tall_block",
    "solver": {"dt_s": 0.01},
    "bodies": {
        "table": {"type": "rigid", "shape": {"type": "plane"}},
        "block": {
            "type": "affine",
            "shape": {"type": "box", "size_m": [0.02, 0.04, 0.06]},
            "pose": {"position_m": [0.0, 0.0, 0.03002]},
            "material": {"density_kg_m3": 1200.0},
        },
    },
    "contacts": [{"between": ["block", "table"], "friction": 0.9}],
    "cameras": {
        "above": {
            "model": "scaled_orthographic",
            "width_px": 1000,
            "height_px": 1000,
            "scale_m_per_px": 1e-3,
            "cx_px": 500.0,
            "cy_px": 500.0,
            "pose": {"position_m": [0.0, 0.0, 0.5], "rpy_deg": [180.0, 0.0, 0.0]},
            "sees": [{"body": "block", "points": {"positions_m": [[0.0, 0.0, 0.03]]}}],
        }
    },
}


def jump(at):
    """A step of height 2 at 0.3, and a slope of 1."""
    return 2.0 * float(at[0] > 0.3) + float(at[0]), np.ones(1)


def test_a_jump_in_closed_form():
    """dL_s/dtheta = 1 + 2 phi(0.3 / sigma) / sigma at 0: the first order says 1 without a doubt."""
    sigma, runs = 0.5, 300
    truth = 1.0 + 2.0 * norm.pdf(0.3 / sigma) / sigma
    scores, combined = [], []
    for seed in range(runs):
        found = smoothed_gradient(jump, np.zeros(1), sigma, pairs=60, seed=seed)
        assert found.first.gradient == pytest.approx(1.0) and found.first.error < 1e-12
        scores.append((found.zeroth.gradient[0] - truth) / found.zeroth.error[0])
        combined.append(found.combined.gradient[0])
        assert found.combined.gradient[0] >= found.zeroth.gradient[0] - 1.97 * found.zeroth.error[0]
    assert abs(np.mean(scores)) < 4.0 / np.sqrt(runs) + 0.1  # studentised, 60 samples
    assert 0.85 < np.std(scores) < 1.2
    assert truth - 1.0 > 1.3 and np.mean(combined) > 1.0 + 0.6 * (truth - 1.0)


def test_a_smooth_loss_in_closed_form():
    """E sin(a . (x + sigma w)) = exp(-sigma^2 |a|^2 / 2) sin(a . x)."""
    a, at, sigma, runs = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.1, -0.4]), np.array([0.2, 0.3, 0.1]), 200

    def wave(x):
        return float(np.sin(a @ x)), a * np.cos(a @ x)

    truth = np.exp(-0.5 * np.sum((sigma * a) ** 2)) * a * np.cos(a @ at)
    found = [smoothed_gradient(wave, at, sigma, pairs=40, seed=seed) for seed in range(runs)]
    rms = {}
    for kind in ("first", "zeroth", "combined"):
        misses = np.array([getattr(f, kind).gradient for f in found]) - truth
        said = np.sqrt(np.mean([getattr(f, kind).error ** 2 for f in found], axis=0))
        rms[kind] = np.sqrt(np.mean(misses**2, axis=0))
        if kind != "combined":  # whose weights come from the same samples, a bias of a part of its error
            assert np.all(np.abs(misses.mean(axis=0)) < 4.0 * said / np.sqrt(runs)), kind
            assert misses.std(axis=0) == pytest.approx(said, rel=0.2), kind
    assert np.all(rms["combined"] < 0.9 * rms["zeroth"])


def test_the_baseline_takes_the_noise_of_what_is_linear():
    """Of a quadratic the odd part of a pair is linear: nothing is left to chance, in any number of dimensions."""
    rng = np.random.default_rng(0)
    half, at = rng.standard_normal((6, 6)), rng.standard_normal(6)

    def bowl(x):
        return 0.5 * float(x @ (half + half.T) @ x), (half + half.T) @ x

    found = smoothed_gradient(bowl, at, 0.3, pairs=5, seed=1)
    expected = (half + half.T) @ at
    assert np.allclose(found.zeroth.gradient, expected, rtol=1e-12)
    assert np.allclose(found.first.gradient, expected, rtol=1e-12)
    assert found.zeroth.error.max() < 1e-12 * np.abs(expected).max()


def test_seeds_and_failures():
    def fails(at):
        if at[0] > 0.6:
            raise ConvergenceError("The step stalls.", "Shorten it.")
        return jump(at)

    once, twice, other = (smoothed_gradient(fails, np.zeros(1), 0.5, pairs=20, seed=s) for s in (3, 3, 4))
    assert once.zeroth.gradient == twice.zeroth.gradient != other.zeroth.gradient
    assert once.loss == twice.loss and once.pairs + len(once.failures) == 20
    assert once.failures and all(at[0] > 0.6 and "stalls" in said for at, said in once.failures)
    with pytest.raises(ConvergenceError, match=r"Of 4 pairs .* 0 came to an end.*stalls"):
        smoothed_gradient(fails, np.full(1, 5.0), 0.1, pairs=4)
    for sigma, pairs, words in ((0.0, 9, "above zero"), (np.nan, 9, "above zero"), (1.0, 1, "standard error")):
        with pytest.raises(ConfigError, match=words):
            smoothed_gradient(jump, np.zeros(1), sigma, pairs=pairs)
    with pytest.raises(ConfigError, match="not finite"):
        smoothed_gradient(lambda at: (np.nan, at), np.zeros(1), 1.0)


def test_a_block_that_tips_over_or_stands():
    """Weight along the table tips a tall block over, or not: its top ends 0.2 mm or 77 mm away.

    The reference is the integral of L times the normal density's slope, by Gauss-Legendre on both sides of the jump,
    which is found by bisection.
    """
    rig = parse_rig(TALL_BLOCK, "tall block")

    def loss(trace):
        place = trace.outputs["above"][:, 0, 0]
        by = np.zeros_like(trace.outputs["above"])
        by[-1, 0, 0] = 1e-3
        return 1e-3 * float(place[-1] - place[0]), {"above": by}

    evaluate = rollout_loss(rig, {}, np.linspace(0.0, 0.6, 61), loss, ["gravity.x"])
    at, sigma, low, high = 2.7, 0.3, 2.2, 3.2
    ends = evaluate(np.array([low]))[0], evaluate(np.array([high]))[0]
    assert ends[0] < 1e-3 < 0.07 < ends[1]
    while high - low > 2e-3:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if evaluate(np.array([middle]))[0] < 0.04 else (low, middle)
    truth = 0.0
    nodes, shares = roots_legendre(6)
    for a, b in ((at - 4.0 * sigma, low), (high, at + 4.0 * sigma)):
        for x, share in zip(0.5 * (a + b) + 0.5 * (b - a) * nodes, 0.5 * (b - a) * shares, strict=True):
            u = (x - at) / sigma
            truth += share * evaluate(np.array([x]))[0] * u * norm.pdf(u) / sigma**2
    found = smoothed_gradient(evaluate, np.array([at]), sigma, pairs=30, seed=0)
    assert found.pairs == 30 and not found.failures
    assert abs(found.zeroth.gradient[0] - truth) < 2.5 * found.zeroth.error[0] < 0.75 * truth
    assert found.first.gradient[0] < 0.5 * truth
    assert found.alpha[0] == 0.0 and found.combined.gradient == found.zeroth.gradient
    still = smoothed_gradient(evaluate, np.array([1.0]), 0.1, pairs=4, seed=0)
    spread = np.hypot(still.first.error, still.zeroth.error)
    assert abs(still.first.gradient - still.zeroth.gradient) < 4.0 * spread + 1e-6 * still.first.gradient
    assert still.first.error < 0.01 * still.first.gradient


def test_noise_beyond_a_bound_names_what_to_do():
    def evaluate(at):
        if at[0] < 0.0:
            raise ConfigError("friction is below 0.", "Correct the value.")
        return float(at[0] ** 2), 2.0 * at

    with pytest.raises(ConfigError, match=r"Smoothing leaves what can be simulated.*Smooth by less"):
        smoothed_gradient(evaluate, np.array([0.1]), 0.1, pairs=30)
