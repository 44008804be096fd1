"""How the discretisation error changes with the parameters: of a real rollout, against differences."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_core.rigs import Rig
from sim_core.rigs.motion import Experiment
from sim_core.solve.report import NewtonSettings
from sysid.discretisation.refinement import discretisation, discretisation_with_slopes
from sysid.model import predictor
from sysid.model.load import load_run
from sysid.model.parameters import FitParameter, fit_parameters, rig_at, start_of
from sysid.model.predictor import SerialPredictor
from sysid.observations.observations import Run
from sysid.simulate import simulate_to_bag

PRESS: list[dict[str, Any]] = [
    {
        "type": "waypoints",
        "speed_m_s": 0.05,
        "hold_s": 0.1,
        "poses": [{"position_m": [0.0, 0.0, -0.011]}, {"position_m": [0.002, 0.0, -0.012]}],
    }
]
NAMES = ["card.E_pa", "gel.E_pa", "finger.offset_z_m"]
STEPS = 3e-5, 1e-5
"""Of the differences, in plausible ranges: small, since contact is made and lost within larger ones, so rollouts are
solved to round-off."""

TIGHT = NewtonSettings(step_tolerance_m=1e-13)
"""Contacts are made within the longer one, rounding shows in the shorter one."""


@pytest.fixture(scope="module")
def pressed(small_rig: Callable[..., Rig], tmp_path_factory: pytest.TempPathFactory) -> tuple[Rig, Run]:
    rig = small_rig()
    bag: Path = tmp_path_factory.mktemp("press") / "bag"
    simulate_to_bag(rig, Experiment.model_validate({"name": "press", "motions": {"finger": PRESS}}), bag)
    return rig, load_run(rig, bag)


@pytest.mark.slow
def test_slopes_of_the_discretisation_error_are_its_differences(
    pressed: tuple[Rig, Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, run = pressed
    for name in ("simulate", "simulate_tangent"):
        monkeypatch.setattr(predictor, name, partial(getattr(predictor, name), settings=TIGHT))
    parameters: list[FitParameter] = fit_parameters(rig, NAMES)
    engine, at = SerialPredictor(), start_of(rig, parameters)
    # In units of what is plausible, so that a step is as large for an offset as for a modulus.
    width = np.array([p.prior_sd for p in parameters])

    def measured(scaled: np.ndarray) -> list[Any]:
        return discretisation(engine, rig_at(rig, parameters, scaled), [run])

    plain = engine.predict_all(rig, [run], parameters, at)
    found = discretisation_with_slopes(engine, rig, [run], plain, parameters, at)
    values = measured(at)
    for known, value in zip(found, values, strict=True):
        assert known.label == value.label and np.array_equal(known.at, at)
        for channel, shape in known.shapes[0].items():
            np.testing.assert_allclose(shape, value.shapes[0][channel], rtol=1e-9, atol=1e-12)
    for k in range(len(parameters)):
        errors: dict[tuple[str, str], list[float]] = {}
        for step in (share * width[k] for share in STEPS):
            ahead, behind = (measured(at + side * step * np.eye(len(parameters))[k]) for side in (1.0, -1.0))
            for known, high, low in zip(found, ahead, behind, strict=True):
                for channel, slopes in known.slopes[0].items():
                    difference = (high.shapes[0][channel] - low.shapes[0][channel]) / (2.0 * step)
                    largest = np.nanmax(np.abs(difference))
                    assert largest > 0.0
                    error = np.max(np.abs(slopes[:, :, k] - difference)) / largest
                    errors.setdefault((known.label, channel), []).append(error)
        assert max(min(e) for e in errors.values()) < 1e-3, (NAMES[k], errors)
