"""A fit does not worsen what it was given, and says why where an error rises all the same."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sim_core.rigs import load_rig
from sim_core.rigs.motion import load_experiment
from sysid.fit.given_values import STAYS, given, rose, said_of_rise, said_of_stay
from sysid.fit.result import ChannelError
from sysid.model.parameters import FitParameter
from sysid.simulate import simulate_to_bag
from sysid.solve.optimum import Fitted
from sysid.workflow import fit_bags

FORCE = ChannelError("press", "ft", "force", "N", 0.01, 0.036, 0.01, False, 0.01, 0.5)
TRACKS = ChannelError("press", "cam", "", "px", 0.1, 0.1, 0.1, False, 0.1, 1.6)


@dataclass
class Place:
    """A problem of which nothing is known but an outcome at any values."""

    fails: bool = False

    def evaluate(self, rig: Any, parameters: list[FitParameter], scaled: np.ndarray) -> Fitted:
        del rig, parameters
        if self.fails:
            raise ConvergenceError("It does not converge.", "Take a shorter step.")
        return outcome(scaled, converged=False)


def outcome(scaled: np.ndarray, converged: bool = True) -> Fitted:
    stiffness = FitParameter("pad.E_pa", "Pa", True, 1.0, 1e13, 1.0, "Young's modulus")
    return Fitted(
        [stiffness], scaled, None, np.zeros(3), np.zeros((3, 1)), [], [], None, 4, converged, "",  # type: ignore[arg-type]
    )  # fmt: skip


def test_values_that_explain_the_recordings_stay_where_the_search_errs_more() -> None:
    stays = given(Place(), outcome(np.ones(1)), np.zeros(1), [FORCE, TRACKS])  # type: ignore[arg-type]
    assert stays is not None and stays.scaled[0] == 0.0 and stays.converged and stays.message == STAYS
    assert "1 times the noise in the force of ft" in said_of_stay([FORCE, TRACKS])
    assert "would leave 3.6 times" in said_of_stay([FORCE, TRACKS])


def test_values_that_err_far_less_than_mesh_and_step_stay_too() -> None:
    near = [replace(FORCE, before=0.1, after=0.2), TRACKS]
    assert given(Place(), outcome(np.ones(1)), np.zeros(1), near) is not None  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "errors",
    [
        [replace(FORCE, before=0.2, after=0.3), TRACKS],  # the start does not explain them either
        [replace(FORCE, after=0.0105), TRACKS],  # what rises is noise
        [replace(FORCE, before=0.012, after=0.0105), TRACKS],
        [replace(FORCE, held_out=True)],  # a prediction is no reason to keep the start
    ],
)
def test_elsewhere_the_values_of_the_search_are_taken(errors: list[ChannelError]) -> None:
    assert given(Place(), outcome(np.ones(1)), np.zeros(1), errors) is None  # type: ignore[arg-type]


def test_values_that_cannot_be_simulated_or_were_not_searched_for_do_not_stay() -> None:
    errors = [FORCE, TRACKS]
    assert given(Place(fails=True), outcome(np.ones(1)), np.zeros(1), errors) is None  # type: ignore[arg-type]
    assert given(Place(), outcome(np.ones(1), converged=False), np.zeros(1), errors) is None  # type: ignore[arg-type]


def test_an_error_that_rises_is_explained() -> None:
    far = [replace(FORCE, before=0.3, after=0.9), TRACKS]
    assert rose(far)
    assert "mesh and time step" in said_of_rise(far)[0] and "the force of ft" in said_of_rise(far)[0]
    assert "what was known before" in said_of_rise([replace(far[0], own=0.0)])[0]
    assert said_of_rise([replace(FORCE, before=0.9)]) == []


@pytest.mark.slow
def test_a_recording_of_the_rig_itself_leaves_the_rig_as_it_is(tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    text = (root / "examples" / "own_sensor.yaml").read_text().replace("cells: [4, 5, 2]", "cells: [3, 3, 2]")
    (tmp_path / "sensor.yaml").write_text(text.replace("force_n: 0.02", "force_n: 0.005"))
    press = "name: press\nmotions: {finger: [{type: wait, duration_s: 0.6}, {type: press, depth_m: 0.0025}]}\n"
    (tmp_path / "press.yaml").write_text(press)
    rig = load_rig(str(tmp_path / "sensor.yaml"))
    simulate_to_bag(rig, load_experiment(str(tmp_path / "press.yaml")), tmp_path / "own")
    result = fit_bags(rig, [tmp_path / "own"], ["pad.E_pa"], out=tmp_path / "fit")
    assert result.converged
    assert not rose(result.errors)
    for error in result.errors:
        assert error.after_over_noise is not None and error.before_over_noise is not None
        assert error.after_over_noise <= 1.05 * error.before_over_noise
    (stiffness,) = result.estimates
    assert stiffness.ci95[0] < 2e5 < stiffness.ci95[1]
