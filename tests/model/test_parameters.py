"""The scale, the width and the bounds with which each quantity is fitted."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sim_core.effects import all_effects, effect_by_name
from sim_core.errors import ConfigError
from sim_core.rigs import list_parameters, with_parameters
from sysid.model.parameters import SCALES, FitParameter, asked_for, bounds_cut, fit_parameters, start_of, within_bounds

STIFFNESS = "contacts.gel-post.stiffness_pa_per_m"


def test_positive_quantities_are_fitted_by_their_logarithm(small_rig: Any) -> None:
    rig = with_parameters(small_rig(), {STIFFNESS: 1e9})
    names = [STIFFNESS, "side.fx_px", "side.fy_px", "side.cx_px", "side.cy_px", "side.latency_s"]
    found = fit_parameters(rig, names)
    assert [p.log for p in found] == [True, True, True, False, False, False]
    assert [p.prior_sd for p in found] == [2.0, 0.2, 0.2, 50.0, 50.0, 0.05]
    assert np.isfinite([p.scaled_bounds for p in found]).all()
    np.testing.assert_allclose(start_of(rig, found), [np.log(1e9), *np.log([1400.0] * 2), 640.0, 360.0, 0.0])


def test_every_quantity_of_a_rig_has_a_scale(small_rig: Any) -> None:
    loads = {
        "push": {"type": "force", "force_n": [0.1, 0.0, 0.0]},
        "hang": {"type": "weight", "mass_kg": 0.01},
        "drag": {"type": "traction", "traction_pa": [10.0, 0.0, 0.0]},
        "blow": {"type": "pressure", "pressure_pa": 10.0},
    }
    rig = small_rig(loads=[{"name": name, "body": "gel", **load} for name, load in loads.items()])
    quantities = {p.name.rsplit(".", 1)[1] for p in list_parameters(rig)}
    assert quantities | {"scale_m_per_px"} == set(SCALES)
    for scale in SCALES.values():
        assert scale.lower < scale.upper and (scale.lower > 0.0 or not scale.log)


@pytest.mark.parametrize("effect", [e.name for e in all_effects().values()])
def test_starting_values_of_effects_are_within_their_bounds(effect: str) -> None:
    for p in effect_by_name(effect).parameters:
        assert all(p.lower <= v <= p.upper for v in p.typical), p


def test_a_value_outside_of_the_bounds_of_a_fit_is_an_error(small_rig: Any) -> None:
    soft = with_parameters(small_rig(), {"gel.nu": 0.499})
    with pytest.raises(
        ConfigError, match=r"gel\.nu is 0\.499 in the rig 'small', above 0\.495, .* Write a value betwe"
    ):
        fit_parameters(soft, ["gel.nu"])
    with pytest.raises(ConfigError, match=r"gel\.nu is 0\.499"):
        start_of(soft, fit_parameters(small_rig(), ["gel.nu"]))


def test_bounds_can_be_narrowed_and_not_widened(small_rig: Any) -> None:
    rig = with_parameters(small_rig(), {"gel.nu": 0.4})
    parameters = fit_parameters(rig, ["gel.E", "gel.nu"])
    same, narrow = within_bounds(parameters, rig, {"gel.nu": (0.35, 7.0)})
    assert same == parameters[0]
    assert (narrow.lower, narrow.upper) == (0.35, parameters[1].upper)
    assert narrow.physical(0.1) == 0.35
    with pytest.raises(ConfigError, match=r"between 0\.45 and 0\.44: given were 0\.45 \.\. 0\.44"):
        within_bounds(parameters, rig, {"gel.nu": (0.45, 0.44)})
    with pytest.raises(
        ConfigError, match=r"gel\.nu is 0\.4 .* below 0\.45, the bound that was given\. .* or give wider"
    ):
        within_bounds(parameters, rig, {"gel.nu": (0.45, 0.49)})
    with pytest.raises(
        ConfigError, match=r"gel\.nu leave .*: given were 0\.6 \.\. 0\.8, and its own limits are -0\.3 \.\. 0\.495"
    ):
        within_bounds(parameters, rig, {"gel.nu": (0.6, 0.8)})
    with pytest.raises(ConfigError, match="which is not fitted"):
        within_bounds(parameters[:1], rig, {"gel.nu": (0.35, 0.45)})
    with pytest.raises(ConfigError, match=r"two pairs of bounds of gel\.E_pa"):
        within_bounds(parameters, rig, {"gel.E": (1e4, 1e6), "gel.E_pa": (1e3, 1e6)})


def test_bounds_beyond_the_limits_of_a_parameter_are_reported(small_rig: Any) -> None:
    rig = with_parameters(small_rig(), {"gel.nu": 0.4})
    lower, upper = bounds_cut(rig, ["gel.E", "gel.nu"], {"gel.nu": (-2.0, 7.0), "gel.E_pa": (1e3, 1e9)})
    assert lower.startswith(
        "The lower bound of gel.nu, -2, is beyond its own limit, -0.3: it is fitted within -0.3 .. 0.495."
    )
    assert upper.startswith(
        "The upper bound of gel.nu, 7, is beyond its own limit, 0.495: it is fitted within -0.3 .. 0.495."
    )
    (stiff,) = bounds_cut(rig, ["gel.E"], {"gel.E": (1e3, 1e20)})
    assert "gel.E_pa, 1e+20, is beyond its own limit, 1e+13: it is fitted within 1000 .. 1e+13 Pa." in stiff
    assert not bounds_cut(rig, ["gel.nu"], {"gel.nu": (-math.inf, math.inf)})


def test_bounds_hold_for_what_is_known_before_and_not_for_what_the_rig_says(small_rig: Any) -> None:
    rig = with_parameters(small_rig(), {"gel.nu": 0.3})
    known = {"priors": {"gel.nu": (0.46, 0.01)}, "per_bag": (), "bags": ("one",)}
    (nu,), start = asked_for(rig, ["gel.nu"], bounds={"gel.nu": (0.45, 0.49)}, **known)
    assert (nu.lower, nu.upper, nu.known_sd) == (0.45, 0.49, 0.01)
    assert start_of(start, [nu]) == pytest.approx([0.46])
    with pytest.raises(ConfigError, match=r"What is known beforehand, gel\.nu_?.* = 0\.9, cannot be: .*gel"):
        asked_for(rig, ["gel.nu"], bounds={}, **known | {"priors": {"gel.nu": (0.9, 0.01)}})
    with pytest.raises(ConfigError, match=r"gel\.nu is 0\.46 in the rig 'small', below 0\.47"):
        asked_for(rig, ["gel.nu"], bounds={"gel.nu": (0.47, 0.49)}, **known)


@pytest.mark.parametrize(
    ("value", "sd", "at"),
    [
        # A stiffness is not at its bound because the range spans fifteen decades.
        (1e9, 0.1, False),
        (1.01, 0.1, False),
        (1.0005, 0.1, True),
        (0.9999e15, 0.1, True),
        (1e15 / 1.2, 20.0, True),
        (1e9, 20.0, False),
    ],
)
def test_a_bound_is_near_as_the_data_see_it(value: float, sd: float, at: bool) -> None:
    parameter = FitParameter("k", "Pa/m", True, 1.0, 1e15, 2.0, "")
    assert parameter.at_bound(parameter.scaled(value), sd) is at
