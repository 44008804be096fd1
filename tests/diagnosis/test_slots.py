"""Which place of the model is unreliable, without a law, on the small rig."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim_core.rigs import Rig, with_parameters
from sysid.diagnosis.beliefs import believed
from sysid.diagnosis.slots import mechanical_slots, slot_evidence
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import SerialPredictor
from sysid.noise.estimate import as_declared
from sysid.observations.observations import Measured, Run
from sysid.solve.residuals import Problem

TIMES = [0.0, 0.06, 0.12, 0.2, 0.3]
WAY = [[0, 0, 0], [0, 0, -0.006], [0.004, 0.001, -0.007], [0.004, 0.001, -0.007], [0, 0, -0.003]]
STAMPS = np.linspace(0.013, 0.287, 31)
KINDS = {"wrench": ("wrench", 6), "markers": ("markers", 27), "side": ("tracks", 20)}


@pytest.fixture(scope="module")
def told(small_rig: Callable[..., Rig], visit: Callable[..., Any]) -> Callable[..., list[tuple[str, str]]]:
    """Slots in the order of their evidence, for readings that a function spoils."""
    rig, predictor = small_rig(), SerialPredictor()
    blank = tuple(
        Measured(channel, kind, STAMPS, np.zeros((len(STAMPS), m)), tuple(str(k) for k in range(m)))
        for channel, (kind, m) in KINDS.items()
    )
    run = Run("own", "own", (), visit(TIMES, WAY), blank, TIMES[-1])

    def ranked(spoil: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]], truth: Rig = rig) -> Any:
        rng = np.random.default_rng(0)
        values = spoil(predictor.predict(truth, run).values)
        full = []
        for m in blank:
            sigma = as_declared(rig, m).sigma
            noisy = values[m.channel] + sigma * rng.standard_normal(m.values.shape)
            full.append(replace(m, values=noisy))
        noise = {m.channel: as_declared(rig, m) for m in full}
        problem = Problem([replace(run, measured=tuple(full))], noise, predictor, prior=True)
        parameters = believed(rig, fit_parameters(rig, ["card.E", "gel.E"]))
        base = problem.fit(rig, parameters, start_of(rig, parameters), max_evaluations=4)
        return slot_evidence(predictor, problem, base, max(1.0, base.misfit))

    return ranked


def test_every_body_contact_and_hand_is_a_place(small_rig: Callable[..., Rig]) -> None:
    places = {(s.place, s.name) for s, _ in mechanical_slots(small_rig())}
    assert {("gel", "gel"), ("sheet", "card"), ("robot", "finger"), ("contact", "gel-card")} <= places


def test_a_drift_of_the_wrench_is_found_at_the_wrench(told: Callable[..., Any]) -> None:
    def drift(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        added = 0.05 * np.sin(9.0 * STAMPS)[:, None] * np.array([1.0, 0.5, 0.0, 0.0, 0.0, 0.0])
        return {**values, "wrench": values["wrench"] + added}

    found = told(drift)
    assert (found[0].slot.place, found[0].slot.name) == ("wrench", "wrench")
    assert found[0].gain > 20.0 and found[0].explained > 0.5


def test_a_shift_of_the_picture_is_found_at_the_camera(told: Callable[..., Any]) -> None:
    def shift(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {**values, "side": values["side"] + 1.5 * np.sin(12.0 * STAMPS)[:, None]}

    best = told(shift)[0]
    assert (best.slot.place, best.slot.name) == ("camera", "side")


def test_where_nothing_is_missing_no_place_has_evidence(told: Callable[..., Any]) -> None:
    assert all(s.gain < 8.0 for s in told(lambda values: values))


def test_a_hand_that_is_elsewhere_is_found_at_the_robot(
    told: Callable[..., Any], small_rig: Callable[..., Rig]
) -> None:
    truth = with_parameters(small_rig(), {"finger.offset_x_m": 8e-4, "finger.offset_z_m": -4e-4})
    places = [(s.slot.place, s.slot.name) for s in told(lambda values: values, truth)]
    assert places[0] == ("robot", "finger")
