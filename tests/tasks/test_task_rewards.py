"""Rewards of tasks: their derivatives, the numbers of the paper, and how they measure folds."""

from __future__ import annotations

import pkgutil
from dataclasses import replace

import numpy as np
import pytest

import sim_core.tasks.rewards
from sim_core.tasks.measure import Seen, share_within
from sim_core.tasks.rollout import reward_of

REWARDS = [m.name for m in pkgutil.iter_modules(sim_core.tasks.rewards.__path__)]
SETTINGS = {
    "displacement_m": (-0.012, 0.01, 0.003),
    "hinges": 3.0,
    "sign": -1.0,
    "vertices": 100.0,
    "ends_weight": 10.0,
    "ends_within_m": 0.003,
}


def some_seen() -> Seen:
    rng = np.random.default_rng(4)
    counts = {"block": 6, "sheet": 5, "ball": 1, "ends": 4, "before": 2, "middle": 2, "after": 2}
    points = {name: 0.01 * rng.standard_normal((5, count, 3)) for name, count in counts.items()}
    folds = {"here": 0.4, "there": 0.1, "middle": -0.7}
    return Seen(np.arange(5) * 0.01, points, folds, 2, SETTINGS, {"sheet": 0.01 * rng.standard_normal((5, 3))})


@pytest.mark.parametrize("name", REWARDS)
def test_derivatives_are_those_of_central_differences(name: str) -> None:
    reward, seen = reward_of(name), some_seen()
    scored = reward(seen)
    rng = np.random.default_rng(5)
    along = {key: rng.standard_normal(x.shape) for key, x in seen.points.items()}
    bent = {key: float(rng.standard_normal()) for key in seen.folds}

    def at(h: float) -> float:
        points = {key: x + h * along[key] for key, x in seen.points.items()}
        folds = {key: f + h * bent[key] for key, f in seen.folds.items()}
        return reward(replace(seen, points=points, folds=folds)).reward

    slope = sum(float(np.vdot(by, along[key])) for key, by in scored.by_points.items())
    slope += sum(by * bent[key] for key, by in scored.by_folds.items())
    assert slope != 0.0
    assert (at(1e-6) - at(-1e-6)) / 2e-6 == pytest.approx(slope, rel=1e-6, abs=1e-10)


def seen_of(points: dict[str, np.ndarray], folds: dict[str, float] | None = None) -> Seen:
    return Seen(np.arange(2) * 0.01, points, folds or {}, 0, SETTINGS, {})


def grid(count: tuple[int, ...], size: tuple[float, ...], corner: tuple[float, float, float]) -> np.ndarray:
    """Points of a grid from a corner on, ``(n, 3)``."""
    stations = [np.linspace(0.0, s, n) for n, s in zip(count, size, strict=True)]
    flat = np.stack(np.meshgrid(*stations, indexing="ij"), axis=-1).reshape(-1, len(count))
    return np.pad(flat, ((0, 0), (0, 3 - len(count)))) + np.array(corner)


def test_scores_of_the_paper_follow_from_its_grids() -> None:
    """Start and best possible scores that ThinShellLab gives for its tasks (ICLR 2024, tables of the review)."""
    block = grid((6, 6, 4), (0.012, 0.012, 0.0072), (0.001, -0.006, 0.0008))
    sheet = grid((16, 16), (0.06, 0.06), (-0.045, -0.03, 0.0004))
    far = np.array([-0.058, 0.0, 0.0])  # 29 steps of 2 mm
    following, separating = reward_of("following"), reward_of("separating")
    assert following(seen_of({"block": np.stack([block, block + far])})).reward == pytest.approx(7.35, abs=0.01)
    still = seen_of({"block": np.stack([block, block]), "sheet": np.stack([sheet, sheet])})
    assert separating(still).reward == pytest.approx(5.63, abs=0.01)
    drawn = seen_of({"block": np.stack([block, block]), "sheet": np.stack([sheet, sheet + far])})
    assert separating(drawn).reward == pytest.approx(20.47, abs=0.011)
    # Angles of its hinges are at most pi - 0.5 rad, and at least 0.5 rad where they begin.
    folds = {"here": np.pi - 0.5, "there": 0.5, "middle": -(np.pi - 0.5)}
    assert reward_of("folding")(seen_of({}, folds)).reward == pytest.approx(6.42, abs=0.01)
    # The whole angle of its hinges is pi at most: a hundredth of the oracle's 42.24 + 0.5 comes of it.
    flat = {
        name: np.tile([x, 0.0, 0.0], (2, 1, 1)) for name, x in (("before", -0.01), ("middle", 0.0), ("after", -0.01))
    }
    hinges_of_pick = Seen(np.zeros(2), flat, folds, 0, {"hinges": 16, "sign": -1}, {})
    assert abs(reward_of("pick_folding")(hinges_of_pick).reward) == pytest.approx(42.26, abs=0.51)


def test_a_ball_that_is_held_up_is_not_thrown() -> None:
    """Ends that are not back are no success, however high the ball."""
    ball, ends = np.zeros((2, 1, 3)), np.zeros((2, 4, 3))
    ball[1, :, 2] = 0.03
    thrown = reward_of("throwing")(seen_of({"ball": ball, "ends": ends}))
    assert thrown.holds and thrown.reward == pytest.approx(3.0)
    ends[1, :, 2] = 0.0031
    held = reward_of("throwing")(seen_of({"ball": ball, "ends": ends}))
    assert not held.holds and held.reward == pytest.approx(3.0 - 10.0 * 4 * 0.0031**2)


def test_the_whole_angle_of_a_mountain_fold_counts_for_pick_folding() -> None:
    """Chords that rise by 0.3 rad and fall by 0.2: an angle of -0.5 rad, and the task seeks negative ones."""
    u, w = np.array([np.cos(0.3), 0.0, np.sin(0.3)]), np.array([np.cos(0.2), 0.0, -np.sin(0.2)])
    points = {"before": -0.01 * u, "middle": 0.0 * u, "after": 0.02 * w}
    seen = Seen(np.zeros(1), {k: p[None, None] for k, p in points.items()}, {"middle": -0.1}, 0, SETTINGS, {})
    assert reward_of("pick_folding")(seen).reward == pytest.approx(3.0 * (0.1 + 0.01 * 0.5))


def test_shares_of_triangles_within_a_band_are_areas() -> None:
    """Against areas counted on a fine grid of points, for triangles of all positions."""
    rng = np.random.default_rng(6)
    x = rng.uniform(-1.0, 1.0, (40, 3))
    x[0] = 0.2, 0.2, 0.9
    x[1] = 0.1, 0.8, 0.8
    a, b = (part.ravel() for part in np.meshgrid(*[(np.arange(400) + 0.5) / 400] * 2))
    inside = a + b < 1.0
    a, b = a[inside], b[inside]
    places = x[:, :1] + (x[:, 1:2] - x[:, :1]) * a + (x[:, 2:] - x[:, :1]) * b
    counted = ((places > -0.3) & (places < 0.25)).mean(axis=1)
    np.testing.assert_allclose(share_within(x, -0.3, 0.25), counted, atol=0.01)


def test_a_reward_that_there_is_not_is_refused() -> None:
    from sim_core.errors import ConfigError

    with pytest.raises(ConfigError, match=r"no reward 'foldin'.*Did you mean 'folding'"):
        reward_of("foldin")
