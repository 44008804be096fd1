"""Errors of markers as arrows: the instant, the lengths and the axes."""

from __future__ import annotations

import re
from typing import Any, cast

import numpy as np
import pytest

from sysid.fit.marker_field import MarkerField, marker_fields
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.report.marker_pictures import LONGEST, MOST_FIELDS, longer, marker_pictures
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 2.0, 21)
GRID = np.stack(np.meshgrid([100.0, 200.0, 300.0], [50.0, 80.0], indexing="xy"), axis=-1).reshape(-1, 2)


def compared(kind: str, measured: np.ndarray, was: np.ndarray, now: np.ndarray) -> list[MarkerField]:
    labels = tuple(str(k) for k in range(measured.shape[1]))
    run = Run("slide", "", (), {}, (Measured("below", kind, T, measured, labels),), 2.0)
    noise = {"below": ChannelNoise(np.full(len(labels), 0.1), np.zeros(len(labels)), "given")}
    problem = Problem([run], noise, cast(Any, None))
    rig = cast(Any, None)
    fits = [
        problem.compare([Prediction({"below": values}, {}, cast(Any, None))], rig, [], np.zeros(0))
        for values in (was, now)
    ]
    return marker_fields(problem, fits[0], fits[1], held_out=True)


def test_the_instant_is_that_of_the_largest_error_and_markers_out_of_sight_are_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("sysid.solve.residuals.rig_at", lambda rig, parameters, scaled: rig)
    measured = np.tile(GRID.ravel(), (21, 1)) + T[:, None]
    was, now = measured.copy(), measured.copy()
    was[13, ::2] -= 3.0
    now[13, 1::2] += 1.0
    measured[13, 4:6] = np.nan
    (field,) = compared("tracks", measured, was, now)
    assert field.t == pytest.approx(1.3) and field.held_out and field.axes == ("u", "v") and field.downwards
    assert len(field.places) == 5
    np.testing.assert_allclose(field.before, np.tile([3.0, 0.0], (5, 1)))
    np.testing.assert_allclose(field.after, np.tile([0.0, -1.0], (5, 1)))


def test_of_points_in_space_those_two_axes_are_shown_along_which_they_spread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid.solve.residuals.rig_at", lambda rig, parameters, scaled: rig)
    points = np.column_stack([GRID[:, 0], np.full(6, 7.0), GRID[:, 1]])
    measured = np.tile(points.ravel(), (21, 1))
    (field,) = compared("markers", measured, measured + 1.0, measured)
    assert field.axes == ("x", "z") and not field.downwards and field.unit == "m"
    np.testing.assert_allclose(field.before, -1.0)


@pytest.mark.parametrize("size", [3e-5, 0.7, 40.0, 900.0])
def test_arrows_are_as_long_as_can_be_seen_by_a_round_factor(size: float) -> None:
    errors = size * np.array([[0.6, 0.8], [0.1, 0.0]])
    factor = longer([errors, 0.3 * errors], 200.0)
    assert LONGEST * 200.0 / 2.5 * (1.0 - 1e-9) <= factor * size <= LONGEST * 200.0 * (1.0 + 1e-9)
    assert re.fullmatch(r"[125](e-?\d+)?", f"{factor:.0e}".replace("e+00", "").replace("e+0", "e").replace("e-0", "e-"))
    assert longer([0.0 * errors], 200.0) == 1.0


def test_the_pictures_are_those_of_the_largest_errors_with_one_held_out() -> None:
    def field(name: str, size: float, held_out: bool) -> MarkerField:
        errors = np.tile([size, 0.0], (6, 1))
        return MarkerField(name, "below", "px", held_out, 0.5, GRID, errors, 0.1 * errors, 0.1, ("u", "v"), True)

    many = [field(f"r{k}", 1.0 + k, False) for k in range(9)] + [field("check", 0.5, True)]
    found = marker_pictures(many, ("before", "after"), both=True)
    assert set(found) == {(f"r{k}", False) for k in range(4, 9)} | {("check", True)} and len(found) == MOST_FIELDS
    svg = found["r8", False][0].svg
    assert "before: rms 64 times the noise" in svg and "after: rms 6.4 times the noise" in svg
    assert svg.count("var(--before)") and svg.count("var(--after)")
    alone = marker_pictures([field("r", 40.0, False)], ("baseline", "baseline"), both=False)["r", False][0].svg
    assert "var(--after)" in alone and "var(--before)" not in alone
