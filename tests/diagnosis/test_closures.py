"""Features of recordings that closures go by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_core.rigs.trajectory import PoseTrajectory
from sysid.diagnosis.closures import Course, courses
from sysid.observations.observations import Measured, Run

T = np.linspace(0.0, 2.0, 401)


def run(name: str, heights: np.ndarray, force: np.ndarray | None = None) -> Run:
    """A hand that goes up and down without a turn."""
    positions = np.column_stack([np.zeros((len(T), 2)), heights])
    poses = {"hand": PoseTrajectory(T, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(T), 1)))}
    wrench = (
        np.zeros((len(T), 6))
        if force is None
        else np.column_stack([np.zeros((len(T), 2)), force, np.zeros((len(T), 3))])
    )
    return Run(name, name, (name,), poses, (Measured("wrench", "wrench", T, wrench, tuple("abcdef")),), float(T[-1]))


def features(*runs: Run) -> list[list[Course]]:
    """Of recordings that are predicted as they are measured."""
    return courses(runs, [{m.channel: m.values for m in one.measured} for one in runs])


def test_noise_of_a_force_is_no_feature() -> None:
    """What a sensor reads in addition to what is predicted changes nothing."""
    up = 0.02 * np.sin(np.pi * T)
    clean = run("a", up, 3.0 * np.abs(up))
    noisy = clean.measured[0].values + np.random.default_rng(1).standard_normal((len(T), 6))
    spoilt = replace(clean, measured=(replace(clean.measured[0], values=noisy),))
    (found,) = courses([spoilt], [{"wrench": clean.measured[0].values}])
    for one, other in zip(found, features(clean)[0], strict=True):
        np.testing.assert_array_equal(one.values, other.values)


def test_features_are_those_of_the_motion_and_of_the_load() -> None:
    up = 0.02 * np.sin(np.pi * T)
    first, second = features(run("a", up, 3.0 * np.abs(up)), run("b", 0.5 * up, -1.0 * np.abs(up)))
    a, b = ({c.feature: c for c in found} for found in (first, second))
    # Times count from the first recording on, over all of them.
    assert (a["time"].values[0], b["time"].values[-1]) == (-1.0, 1.0)
    assert b["time"].values[0] == pytest.approx(0.0)
    # One scale for all recordings, whose sign has no meaning.
    place = a["place 1"].values * np.sign(a["place 1"].at(np.array([0.5]))[0])
    np.testing.assert_allclose(place, np.sin(np.pi * a["place 1"].times), atol=2e-3)
    assert np.max(np.abs(b["place 1"].values)) == pytest.approx(0.5, abs=2e-3)
    np.testing.assert_allclose(a["square"].values, a["place 1"].values ** 2)
    np.testing.assert_allclose(a["speed"].values, np.abs(np.cos(np.pi * a["speed"].times)), atol=0.02)
    turned = a["direction 1"].at(np.array([0.25, 0.75, 1.25, 1.75])) * np.sign(a["direction 1"].at(np.array([0.25]))[0])
    np.testing.assert_allclose(turned, [1.0, -1.0, -1.0, 1.0], atol=0.02)
    # A hand that goes along one line has one axis, and its velocity has the sign of where it goes.
    assert "place 2" not in a and "force 2" not in a
    velocity = a["velocity 1"].values * np.sign(a["place 1"].at(np.array([0.5]))[0])
    np.testing.assert_allclose(velocity, np.cos(np.pi * a["velocity 1"].times), atol=0.02)
    assert np.max(a["load"].values) == pytest.approx(1.0)
    assert np.max(b["load"].values) == pytest.approx(1.0 / 3.0, abs=0.02)


def test_motions_and_forces_along_several_lines_have_features_along_each() -> None:
    """A hand that goes round an ellipse under a force that turns the other way."""
    plain = run("round", 0.02 * np.sin(np.pi * T))
    hand = plain.poses["hand"]
    positions = hand.positions + np.outer(0.01 * np.cos(np.pi * T), [1.0, 0.0, 0.0])
    turning = np.column_stack([2.0 * np.sin(np.pi * T), 0.0 * T, 6.0 * np.cos(np.pi * T), np.zeros((len(T), 3))])
    (found,) = features(
        replace(
            plain,
            poses={"hand": replace(hand, positions=positions)},
            measured=(replace(plain.measured[0], values=turning),),
        )
    )
    by = {c.feature: c for c in found}
    assert [f for f in by if f.startswith("place")] == ["place 1", "place 2"]
    assert [f for f in by if f.startswith("force")] == ["force 1", "force 2"]
    second = by["place 2"].values * np.sign(by["place 2"].values[0])
    np.testing.assert_allclose(second, np.cos(np.pi * by["place 2"].times), atol=0.02)
    force = by["force 1"].values * np.sign(by["force 1"].values[0])
    np.testing.assert_allclose(force, np.cos(np.pi * by["force 1"].times), atol=0.05)


def test_what_does_not_happen_has_no_feature_that_is_no_number() -> None:
    (found,) = features(run("still", np.zeros(len(T))))
    assert all(np.isfinite(c.values).all() for c in found)
    (without,) = features(replace(run("still", np.zeros(len(T))), measured=()))
    assert np.all({c.feature: c for c in without}["load"].values == 0.0)
