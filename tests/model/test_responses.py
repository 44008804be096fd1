"""Responses along the frozen path against true rollouts with the effect."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sim_core.effects import all_effects
from sim_core.rigs import Rig
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import SerialPredictor
from sysid.model.responses import Modulated, way_of
from sysid.noise.estimate import declared_noise
from sysid.observations.observations import Measured, Run

TIMES = [0.0, 0.06, 0.12, 0.2, 0.3]
WAY = [[0, 0, 0], [0, 0, -0.006], [0.004, 0.001, -0.007], [0.004, 0.001, -0.007], [0, 0, -0.003]]
STAMPS = np.linspace(0.013, 0.287, 21)

TAKES_ANOTHER_PATH = {
    "contact_adhesion": 0.4,
    "command_lag": 0.6,
    "bending_plasticity": 0.6,
    "electrostatic_attraction": 0.9,
    "gel_viscosity": 0.8,
    "sheet_stiffening": 0.9,
}
"""Effects by which contact is made or lost at another time, much of the sheet yields or hardly stretches any more,
forces are many times as large along the frozen path; and the least cosine asked of these."""

SMALL = {"stream_delay": {"wrench_s": 0.003, "vision_s": 0.005}}
"""In place of examples that are later than a contact lasts: clocks are looked at by the derivative."""


def size_of(name: str) -> dict[str, float]:
    """Parameters at which an effect is asked."""
    return dict(SMALL.get(name, all_effects()[name].example))


@pytest.fixture(scope="module")
def found(small_rig: Callable[..., Rig], visit: Callable[..., Any]) -> tuple[SerialPredictor, Rig, Run, Any, list[str]]:
    """The small rig's run with the responses to all effects at their examples."""
    rig, predictor = small_rig(), SerialPredictor()
    kinds = {"wrench": ("wrench", 6), "markers": ("markers", 27), "side": ("tracks", 20)}
    blank = tuple(
        Measured(channel, kind, STAMPS, np.zeros((len(STAMPS), m)), tuple(str(k) for k in range(m)))
        for channel, (kind, m) in kinds.items()
    )
    run = Run("own", "own", (), visit(TIMES, WAY), blank, TIMES[-1])
    names = [name for name, effect in all_effects().items() if effect.applies(rig)]
    parameters = fit_parameters(rig, ["card.E_pa", "gel.E_pa"])
    scaled = start_of(rig, parameters)
    candidates = [{name: size_of(name)} for name in names]
    return predictor, rig, run, predictor.predict_responses(rig, run, parameters, scaled, candidates), names


def test_derivatives_stand_before_responses(found: Any) -> None:
    """The same as without any effect to look at."""
    predictor, rig, run, prediction, _ = found
    parameters = fit_parameters(rig, ["card.E_pa", "gel.E_pa"])
    plain = predictor.predict_with_derivatives(rig, run, parameters, start_of(rig, parameters))
    for channel, slopes in plain.derivatives.items():
        np.testing.assert_allclose(prediction.derivatives[channel][..., :2], slopes, rtol=1e-5, atol=1e-9)


def test_responses_point_where_rollouts_go(found: Any) -> None:
    """In units of the declared noise, over all channels: the direction, which ranks effects, and for those that leave
    contacts as they are also the length within a factor of two."""
    predictor, rig, run, prediction, names = found
    sigma = {m.channel: np.resize(np.ravel(declared_noise(rig, m.channel)), m.values.shape[1]) for m in run.measured}
    base = predictor.predict(rig, run).values
    for k, name in enumerate(names):
        changed = predictor.predict(rig.model_copy(update={"effects": {name: size_of(name)}}), run)
        true, seen = (
            np.concatenate([np.nan_to_num(part[c] / sigma[c]).ravel() for c in base])
            for part in (
                {c: changed.values[c] - base[c] for c in base},
                {c: prediction.derivatives[c][..., 2 + k] for c in base},
            )
        )
        if name == "contact_bonding":
            assert max(np.abs(true).max(), np.abs(seen).max()) < 1e-9, "the finger does not touch the post"
            continue
        cosine = float(true @ seen / (np.linalg.norm(true) * np.linalg.norm(seen)))
        assert cosine > TAKES_ANOTHER_PATH.get(name, 0.9), (name, cosine)
        if name not in TAKES_ANOTHER_PATH:
            assert 0.5 < np.linalg.norm(seen) / np.linalg.norm(true) < 2.0, name


def test_bonds_are_carried_along_the_path(small_rig: Callable[..., Rig], visit: Callable[..., Any]) -> None:
    """Of a press on the post: nothing on the way in, a pull on the way out."""
    rig, predictor = small_rig(), SerialPredictor()
    shift = np.array([0.055, 0.0, 0.005])
    way = (np.array([[0, 0, 0], [0, 0, -0.0055], [0, 0, -0.0055], [0, 0, -0.0035], [0, 0, 0]]) + shift).tolist()
    stamps = np.linspace(0.013, 0.287, 41)
    blank = Measured("wrench", "wrench", stamps, np.zeros((41, 6)), tuple("abcdef"))
    run = Run("own", "own", (), visit(TIMES, way), (blank,), TIMES[-1])
    effects = {"contact_bonding": {"work_j_m2": 0.02, "range_m": 2e-4}}
    parameters = fit_parameters(rig, ["gel.E_pa"])
    seen = predictor.predict_responses(rig, run, parameters, start_of(rig, parameters), [effects])
    base = predictor.predict(rig, run).values["wrench"]
    true = predictor.predict(rig.model_copy(update={"effects": effects}), run).values["wrench"] - base
    found = seen.derivatives["wrench"][..., 1]
    assert not true[stamps < 0.05].any() and not found[stamps < 0.05].any()
    assert true.any()
    cosine = float(true.ravel() @ found.ravel() / (np.linalg.norm(true) * np.linalg.norm(found)))
    assert cosine > 0.5, cosine


def test_sensors_are_looked_at_exactly(small_rig: Callable[..., Rig]) -> None:
    """Each interface has its way."""
    rig = small_rig()
    ways = {name: way_of(rig, {name: dict(effect.example)}, repr) for name, effect in all_effects().items()
            if effect.applies(rig)}  # fmt: skip
    assert ways["wrench_offset"] == "reading" and ways["stream_delay"] == "clock"
    assert ways["static_friction"] == ways["gel_relaxation"] == "law"


def test_a_clock_that_is_late_changes_what_the_nuisance_parameter_of_its_delay_does(found: Any) -> None:
    """So that no delay, whose recordings each have a clock of their own, passes for an effect by what it is curved."""
    predictor, rig, run, _, _ = found
    parameters = fit_parameters(rig, ["wrench.latency_s", "side.latency_s"])
    late = [{"stream_delay": {"wrench_s": 0.02}}, {"stream_delay": {"vision_s": 0.02}}]
    columns = predictor.predict_responses(rig, run, parameters, start_of(rig, parameters), late).derivatives
    for channel, k in (("wrench", 0), ("side", 1)):
        slopes = columns[channel]
        assert np.abs(slopes[..., k]).max() > 0.0
        np.testing.assert_allclose(slopes[..., 2 + k], 0.02 * slopes[..., k], atol=1e-4 * np.abs(slopes).max())


def test_a_parameter_that_changes_all_the_time_is_the_parameter(found: Any) -> None:
    """A hat as wide as the ages gives the derivative, of a modulus, of friction and of where the hand is; two narrow
    ones that add up to one give it together."""
    predictor, rig, run, _, _ = found
    names = ["gel.E_pa", "contacts.gel-card.friction", "finger.offset_z_m"]
    parameters = fit_parameters(rig, names)
    scaled = start_of(rig, parameters)
    always, whole = np.zeros(1), np.array([0.0, TIMES[-1]])
    changing = [Modulated(name, always, np.ones(1)) for name in names]
    changing += [Modulated(names[0], whole, np.array([1.0, 0.0])), Modulated(names[0], whole, np.array([0.0, 1.0]))]
    # Two that change along with each other are one column.
    changing += [Modulated(names[0], always, np.full(1, 2.0), (Modulated(names[1], always, np.full(1, 3.0)),))]
    columns = predictor.predict_responses(rig, run, parameters, scaled, [], changing).derivatives
    for channel, slopes in columns.items():
        size = np.abs(slopes[..., :3]).max()
        np.testing.assert_allclose(slopes[..., 3:5], slopes[..., :2], atol=1e-6 * size)
        both = 2.0 * slopes[..., 0] + 3.0 * slopes[..., 1]
        np.testing.assert_allclose(slopes[..., 8], both, atol=1e-6 * size)
        # A hand that is off from the start on also moves where everything settled.
        np.testing.assert_allclose(slopes[..., 5], slopes[..., 2], atol=1e-2 * size)
        np.testing.assert_allclose(slopes[..., 6] + slopes[..., 7], slopes[..., 0], atol=1e-6 * size)
        assert np.abs(slopes[:3, :, 7]).max() < 0.5 * np.abs(slopes[:3, :, 0]).max() + 1e-12, channel
