"""Nuisances are estimated with the parameters: offsets in time, untared wrenches, cameras that are off."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.rigs import load_rig, parse_rig, with_parameters
from sim_core.rigs.pose_offset import OFFSETS
from sim_core.simulate import Trace
from sysid.fit.options import FitOptions
from sysid.model.nuisance_parameters import KINDS, bias_sd, checked_kinds, has_bias, nuisance_parameters
from sysid.model.parameters import FitParameter, fit_parameters, rig_at, start_of
from sysid.model.pose_influence import influencing_end_effectors
from sysid.model.predictor import Prediction, SerialPredictor
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.model import MODEL
from sysid.solve.covariance import uncertainty
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.residuals import Problem
from sysid.uncertainty.nuisance_estimates import (
    REMEDIES,
    Nuisance,
    confounded_with_nuisances,
    kind_of,
    nuisances_of,
    remarks,
    with_explicit_bias,
)

T = np.linspace(0.0, 2.0, 80)
RNG = np.random.default_rng(11)
LABELS = ("force x", "force y", "force z", "torque x", "torque y", "torque z")
SIGMA = np.repeat([1e-2, 1e-3], 3)
NOISE = {"gauge": ChannelNoise(SIGMA, 0.3, "test")}
ASKED = [FitParameter(n, "-", False, -1e3, 1e3, 5.0, "") for n in "ab"]
SLOPES = 0.3 * np.stack(
    [np.outer(np.sin(3 * T), [1.0, 0.5, -0.8, 0.1, 0.05, -0.08]), np.outer(T, [0.6, -0.4, 1.0, 0.05, -0.02, 0.06])],
    axis=2,
)
BIAS = np.array([0.3, -0.2, 0.5, 0.02, -0.01, 0.03])
TRUTH = np.array([0.7, -1.1])


class Linear:
    """An engine whose readings are linear in two numbers."""

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        slopes = SLOPES[:, :, : len(scaled)]
        return [Prediction({"gauge": slopes @ scaled}, {"gauge": slopes}, cast(Trace, None)) for _ in runs]


@pytest.fixture
def stubs(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("sysid.solve.residuals", "sysid.uncertainty.nuisance_estimates"):
        monkeypatch.setattr(f"{module}.start_of", lambda rig, parameters: np.zeros(len(parameters)))
    monkeypatch.setattr("sysid.solve.residuals.rig_at", lambda rig, parameters, scaled: rig)


def run_of(bias: np.ndarray, slopes: np.ndarray = SLOPES) -> Run:
    values = slopes @ TRUTH + bias + SIGMA * np.random.default_rng(3).standard_normal((len(T), 6))
    return Run("press", "", (), {}, (Measured("gauge", "wrench", T, values, LABELS),), 2.0)


def problem_of(run: Run, error_shapes: list[ErrorShape] | None = None, bias: bool = True) -> Problem:
    return Problem([run], NOISE, cast(SerialPredictor, Linear()), error_shapes or [], bias=bias)


MESH = ErrorShape("mesh", ({"gauge": 0.05 * np.outer(np.cos(5 * T), RNG.normal(size=6))},))


@pytest.mark.parametrize("error_shapes", [[], [MESH]])
def test_eliminating_biases_is_least_squares_with_a_column_for_each(
    stubs: None, error_shapes: list[ErrorShape]
) -> None:
    """Values, chi-square, covariance and biases, by the normal equations of all unknowns at once."""
    run = run_of(BIAS)
    problem = problem_of(run, error_shapes)
    found = problem.fit(cast(Any, None), ASKED, start=np.zeros(2), tolerance=1e-9)

    plain = problem_of(run, error_shapes, bias=False)
    (measured,) = run.measured
    sd = bias_sd(measured)
    assert sd is not None
    basis = plain.basis(0, measured)
    common = [p.shape[:, :, None] * p.functions[:, None] for p in basis.common]
    columns = np.concatenate([SLOPES, np.eye(6) * np.ones((len(T), 1, 1)), *common], axis=2)
    each = np.concatenate([p.shape[:, :, None] * p.functions[:, None] for p in basis.own], axis=2)
    own = np.einsum("njl,jk->njkl", each, np.eye(6)).reshape(len(T), 6, -1)
    columns = plain.whiten(0, measured, np.concatenate([columns, own], axis=2)).reshape(6 * len(T), -1)
    target = plain.whiten(0, measured, measured.values - basis.expected).ravel()
    pull = np.concatenate([np.zeros(2), 1.0 / sd**2, np.ones(columns.shape[1] - 8)])
    normal = columns.T @ columns + np.diag(pull)
    best = np.linalg.solve(normal, columns.T @ target)
    least = target @ target - best @ columns.T @ target
    np.testing.assert_allclose(found.scaled, best[:2], rtol=1e-5)
    np.testing.assert_allclose(problem.bias_of(found, 0, measured), best[2:8], rtol=1e-6, atol=1e-9)
    assert found.chi2 == pytest.approx(least, rel=1e-6)
    covariance = np.linalg.inv(normal)
    eliminated = np.linalg.inv(found.jacobian.T @ found.jacobian)
    np.testing.assert_allclose(eliminated, covariance[:2, :2], rtol=1e-6)
    whole = with_explicit_bias(problem, found)
    np.testing.assert_allclose(
        np.linalg.inv(whole.jacobian.T @ whole.jacobian), covariance[:8, :8], rtol=1e-5, atol=1e-14
    )
    assert whole.chi2 == pytest.approx(least, rel=1e-6)
    assert whole.samples == found.samples == 6 * len(T)
    (there,) = found.predictions
    hidden = np.where(np.arange(len(T))[:, None] < 10, np.nan, there.values["gauge"])
    blind = problem.compare([replace(there, values={"gauge": hidden})], cast(Any, None), ASKED, found.scaled)
    assert with_explicit_bias(problem, blind).samples == blind.samples == 6 * (len(T) - 10)


def test_a_bias_pulls_parameters_away_unless_it_is_allowed_for(stubs: None) -> None:
    run = run_of(BIAS)
    fits = [
        problem_of(run, bias=b).fit(cast(Any, None), ASKED, start=np.zeros(2), tolerance=1e-6) for b in (True, False)
    ]
    off = [np.abs(f.scaled - TRUTH) for f in fits]
    assert np.all(off[0] < 3.0 * uncertainty(fits[0]).sd) and off[0].max() < 0.02
    assert off[1].max() > 0.2
    biases = nuisances_of(problem_of(run), fits[0])
    assert [n.name for n in biases] == [f"gauge {label} bias" for label in LABELS]
    assert all(n.informed and n.far and abs(n.value - b) < 4.0 * n.sd for n, b in zip(biases, BIAS, strict=True))
    assert {n.unit for n in biases} == {"N", "N m"} and {n.run for n in biases} == {"press"}
    (said,) = remarks(cast(Any, None), biases, trusted=True)
    assert said.startswith("In press, gauge has a bias of force x 0.30") and "tare it" in said
    (open_,) = remarks(cast(Any, None), biases, trusted=False)
    assert open_.startswith("In press, gauge has a bias of force x 0.30") and "stands for something else" in open_
    assert "tare it" not in open_


def test_a_gauge_along_one_axis_has_one_bias(stubs: None) -> None:
    run = run_of(BIAS)
    (full,) = run.measured
    one = np.where(np.arange(6) == 2, full.values, np.nan)
    problem = problem_of(replace(run, measured=(replace(full, values=one),)))
    found = problem.fit(cast(Any, None), ASKED, start=np.zeros(2), tolerance=1e-6)
    (bias,) = nuisances_of(problem, found)
    assert bias.name == "gauge force z bias" and abs(bias.value - BIAS[2]) < 4.0 * bias.sd
    assert with_explicit_bias(problem, found).chi2 == pytest.approx(found.chi2, rel=1e-6)


def test_what_only_a_bias_hides_is_said(stubs: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """A weight that never changes cannot be separated from a bias of the sensor that carries it."""
    constant = SLOPES.copy()
    constant[:, :, 1] = constant[-1, :, 1]
    monkeypatch.setitem(globals(), "SLOPES", constant)
    problem = problem_of(run_of(np.zeros(6), constant))
    found = problem.fit(cast(Any, None), ASKED, start=np.zeros(2))
    known = uncertainty(found)
    assert known.sd[1] > 0.5 * ASKED[1].prior_sd and any("do not determine b" in s for s in known.sentences)
    (said,) = confounded_with_nuisances(problem, found, KINDS)
    assert said.startswith("b would be determined if force sensors had no bias")
    assert confounded_with_nuisances(problem_of(run_of(np.zeros(6)), bias=False), found, KINDS) == []


def test_nuisances_have_a_prior_and_stay_there_without_information(stubs: None) -> None:
    """The third parameter changes nothing: it stays at the rig's value, and no word is said of it."""
    late = FitParameter("gauge.latency_s", "s", False, -10.0, 10.0, 0.03, "", nuisance=True)

    class Blind(Linear):
        def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
            (p,) = super().predict_all(rig, runs, parameters, scaled[:2])
            return [
                replace(p, derivatives={"gauge": np.concatenate([p.derivatives["gauge"], 0.0 * SLOPES[:, :, :1]], 2)})
            ]

    problem = Problem([run_of(np.zeros(6))], NOISE, cast(SerialPredictor, Blind()))
    found = problem.fit(cast(Any, None), [*ASKED, late], start=np.array([0.0, 0.0, 0.01]))
    assert found.pulls == 1 and found.samples == 6 * len(T)
    assert found.scaled[2] == pytest.approx(0.0, abs=1e-6)
    known = uncertainty(found)
    assert known.sd[2] >= 0.99 * 0.03 and known.sentences == ()
    alone = Problem([run_of(np.zeros(6))], NOISE, cast(SerialPredictor, Linear())).fit(
        cast(Any, None), ASKED, start=np.zeros(2)
    )
    np.testing.assert_allclose(known.sd[:2], uncertainty(alone).sd, rtol=1e-2)
    (n,) = nuisances_of(problem, found)
    assert not n.informed and not n.far and remarks(cast(Any, None), [n], trusted=True) == []


def test_a_parameter_that_only_the_clock_hides_is_no_better_known_than_the_clock(stubs: None) -> None:
    """One second of delay reads as 200 b, so that b is known to 200 times 30 ms."""
    late = FitParameter("gauge.latency_s", "s", False, -10.0, 10.0, 0.03, "", nuisance=True)

    class Late(Linear):
        def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
            slopes = np.concatenate([SLOPES, 200.0 * SLOPES[:, :, 1:]], axis=2)
            return [Prediction({"gauge": slopes @ scaled}, {"gauge": slopes}, cast(Trace, None))]

    problem = Problem([run_of(np.zeros(6))], NOISE, cast(SerialPredictor, Late()))
    found = problem.fit(cast(Any, None), [*ASKED, late], start=np.zeros(3), tolerance=1e-9)
    known = uncertainty(replace(found, residual=0.0 * found.residual))
    np.testing.assert_allclose(known.sd[1:], [200.0 * 0.03, 0.03], rtol=0.01)
    assert known.sd[0] < 0.1
    assert len(known.sentences) == 1 and "do not determine b:" in known.sentences[0]
    assert confounded_with_nuisances(problem, found, KINDS) == [f"b would be determined if {REMEDIES['time']}."]


def test_every_stream_and_camera_has_its_nuisances_once(small_rig: Any) -> None:
    rig = small_rig()
    kinds = (("wrench", "wrench", 6), ("markers", "markers", 27), ("side", "tracks", 20))
    measured = tuple(Measured(c, k, T, np.zeros((len(T), n)), ()) for c, k, n in kinds)
    runs = [Run(n, "", (), {}, measured, 2.0) for n in ("press@0:2", "press@2:4")]
    asked = fit_parameters(rig, ["gel.E"])
    found = {p.name: p for p in nuisance_parameters(rig, runs, asked, KINDS)}
    assert list(found) == [
        "wrench.latency_s",
        "markers.latency_s",
        "side.latency_s",
        "side.fx_px",
        "side.cx_px",
        "side.cy_px",
        *(f"finger.{key}" for key in OFFSETS),
    ]
    assert [found[f"finger.{key}"].prior_sd for key in OFFSETS] == [5e-4] * 3 + [0.5] * 3
    assert all(p.nuisance for p in found.values())
    assert nuisance_parameters(rig, runs, asked, ()) == [] and not has_bias(rig, runs, asked, ())
    assert has_bias(rig, runs, asked, KINDS)
    own = fit_parameters(rig, ["side.latency_s", "side.fy_px", *(f"finger.{key}" for key in OFFSETS[1:])])
    left = [p.name for p in nuisance_parameters(rig, runs, own, KINDS)]
    assert left == ["wrench.latency_s", "markers.latency_s", "side.cx_px", "side.cy_px", "finger.offset_x_m"]
    late = small_rig(effects={"stream_delay": {"wrench_s": 0.0, "vision_s": 0.0}})
    effect = fit_parameters(late, ["effects.stream_delay.vision_s"])
    assert [p.name for p in nuisance_parameters(late, runs, effect, ("time",))] == ["wrench.latency_s"]
    scale = found["side.fx_px"]
    squeezed = with_parameters(rig, {"side.fy_px": 1500.0})
    there = rig_at(squeezed, [scale], start_of(squeezed, [scale]) + np.log(1.005)).cameras["side"]
    assert (there.fx_px, there.fy_px) == pytest.approx((1407.0, 1507.5))


def test_offsets_are_as_uncertain_as_the_rig_says(small_rig: Any) -> None:
    finger = small_rig().end_effectors["finger"].model_dump()
    known = {"offset_sd_m": [1e-3, 5e-4, 0.0], "offset_sd_deg": [0.0, 0.0, 2.0]}
    rig = small_rig(end_effectors={"finger": finger | known})
    runs = [Run("one", "", (), {}, (Measured("wrench", "wrench", T, np.zeros((len(T), 6)), ()),), 2.0)]
    found = nuisance_parameters(rig, runs, [], ("pose",))
    assert {p.name: p.prior_sd for p in found} == {
        "finger.offset_x_m": 1e-3,
        "finger.offset_y_m": 5e-4,
        "finger.offset_rz_deg": 2.0,
    }
    for wrong in (-1e-4, 0.5):  # the latter in millimetres
        with pytest.raises(ConfigError, match=rf"end_effectors\.finger\.offset_sd_m.*{wrong:g}"):
            small_rig(end_effectors={"finger": finger | {"offset_sd_m": [1e-3, 5e-4, wrong]}})


@pytest.mark.parametrize("places", ["rig", "first_frame"])
def test_a_camera_that_places_the_markers_has_the_nuisances_of_any(places: str) -> None:
    rig = load_rig("knit_acrylic_garter_x")
    run = Run("pull", "", (), {}, (Measured("video", "tracks", T, np.zeros((len(T), 10)), ()),), 2.0)
    asked = fit_parameters(rig, ["knit.E_pa"])
    (sight,) = (video := rig.cameras["video"]).sees
    seen = sight.model_copy(update={"points": sight.points.model_copy(update={"placed": places})})
    offsets = [f"puller.{key}" for key in OFFSETS]
    for origin, expected in ((video.origin_id, ["scale_m_per_px"]), (None, ["scale_m_per_px", "cx_px", "cy_px"])):
        camera = video.model_copy(update={"sees": (seen,), "origin_id": origin})
        there = rig.model_copy(update={"cameras": {"video": camera}})
        found = [p.name for p in nuisance_parameters(there, [run], asked, KINDS)]
        assert found == ["video.latency_s", *(f"video.{e}" for e in expected), *offsets]


def test_the_width_of_a_bias_follows_large_readings() -> None:
    values = np.zeros((len(T), 6))
    np.testing.assert_array_equal(bias_sd(Measured("g", "wrench", T, values, LABELS)), np.repeat(MODEL.bias_sd, 3))
    values[5, 1] = -40.0
    values[:, 0] = np.nan
    np.testing.assert_array_equal(bias_sd(Measured("g", "wrench", T, values, LABELS)), [20.0] * 3 + [0.5] * 3)
    assert bias_sd(Measured("g", "markers", T, values, LABELS)) is None


TWO_HANDS = {
    "name": "two_hands",
    "bodies": {
        "table": {"type": "rigid", "shape": {"type": "plane"}, "pose": {"position_m": [0.0, 0.0, -0.1]}},
        "card": {
            "type": "sheet", "shape": {"type": "rectangle", "length_m": 0.06, "width_m": 0.04, "cells": [4, 2]},
            "material": {"preset": "card_200gsm"},
        },
        "strip": {
            "type": "sheet", "shape": {"type": "rectangle", "length_m": 0.06, "width_m": 0.04, "cells": [4, 2]},
            "pose": {"position_m": [0.5, 0.0, 0.0]}, "material": {"preset": "card_200gsm"},
        },
    },
    "clamps": [
        {"name": "left_grip", "body": "card", "mount": "left", "region": {"x_m": [-0.03, -0.02]}},
        {"name": "right_grip", "body": "strip", "mount": "right", "region": {"x_m": [-0.03, -0.02]}},
    ],
    "contacts": [{"between": ["card", "table"]}, {"between": ["strip", "table"]}],
    "end_effectors": {
        "left": {"topics": {"current_pose": "left/pose", "target_pose": "left/target"}},
        "right": {"start": {"position_m": [0.5, 0.0, 0.0]}},
        "idle": {"topics": {"current_pose": "idle/pose", "target_pose": "idle/target"}},
    },
    "sensors": {
        "grip": {"type": "wrench", "on": "left_grip", "topic": "grip"},
        "under": {"type": "wrench", "on": "table", "topic": "under"},
        "hand": {"type": "wrench", "on": "idle", "topic": "hand"},
    },
}  # fmt: skip


@pytest.mark.parametrize(
    ("channel", "expected"), [("grip", ["left"]), ("under", ["left", "right"]), ("hand", ["idle"])]
)
def test_an_end_effector_acts_through_what_it_carries_and_touches(channel: str, expected: list[str]) -> None:
    """The table passes on nothing from one sheet to the other, but feels both."""
    assert influencing_end_effectors(parse_rig(TWO_HANDS, "two hands"), [channel]) == expected


def test_remarks_say_how_an_end_effector_is_off(small_rig: Any) -> None:
    shift = Nuisance("finger.offset_x_m", "", "m", 0.0, 4e-4, (3.804e-4, 4.196e-4), 1e-5, 5e-4, False, ())
    turn = Nuisance("finger.offset_rz_deg", "", "deg", 0.1, -0.3, (-0.3392, -0.2608), 0.02, 0.5, False, ())
    vague = replace(shift, sd=6e-4)
    assert [kind_of(small_rig(), n.name) for n in (shift, turn)] == ["pose", "pose"]
    kinds = {name: kind_of(small_rig(), f"side.{name}") for name in ("cx_px", "offset_x_m", "latency_s")}
    assert kinds == {"cx_px": "camera", "offset_x_m": "camera", "latency_s": "time"}
    assert remarks(small_rig(), [shift, turn, vague], trusted=True) == [
        "The end effector finger is shifted by 0.400 +- 0.010 mm along x of its own frame: write finger.offset_x_m = "
        "0.0004 into the rig, or correct how its poses are calibrated.",
        "The end effector finger is turned by -0.400 +- 0.020 deg about z of its own frame, where the rig says 0.1 "
        "deg: write finger.offset_rz_deg = -0.3 into the rig, or correct how its poses are calibrated.",
    ]


def test_kinds_are_checked() -> None:
    assert checked_kinds(["all"]) == set(KINDS) and checked_kinds(["none"]) == set()
    assert checked_kinds(["time", "bias"]) == {"time", "bias"}
    assert FitOptions().kinds == set(KINDS), "what a laboratory leaves unknown is estimated by default"
    for wrong, said in ((["tine"], "no nuisance 'tine'"), (["none", "time"], "'none' stands with others")):
        with pytest.raises(ConfigError, match=said):
            checked_kinds(wrong)


def test_remarks_say_what_to_write(small_rig: Any) -> None:
    rig = small_rig()
    late = Nuisance("wrench.latency_s", "", "s", 0.0, 0.021, (0.019, 0.023), 0.001, 0.03, False, ())
    scale = Nuisance("side.fx_px", "", "px", 1400.0, 1407.0, (1406.0, 1408.0), 4e-4, 0.01, True, ("side.fy_px",))
    near = replace(late, name="side.latency_s", value=0.002)
    vague = replace(late, sd=0.02)
    said = remarks(rig, [late, scale, near, vague], trusted=True)
    topic = rig.sensors["wrench"].topic
    assert said == [
        f"The stream {topic} lags by 21.0 +- 1.0 ms: write wrench.latency_s = 0.021 into the rig.",
        "The scale of the camera side is off by 0.499 +- 0.040 %: write side.fx_px = 1407 and side.fy_px in proportion "
        "into the rig, or calibrate the camera.",
    ]
    (lead,) = remarks(rig, [replace(late, value=-0.021, start=-0.005)], trusted=True)
    assert "leads by 21.0" in lead and "where the rig says -5 ms" in lead
