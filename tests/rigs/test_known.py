"""How well a rig's numbers are known stands in the rig, and holds fits to them."""

from __future__ import annotations

from typing import Any

import pytest

from sim_core.errors import ConfigError
from sim_core.rigs import list_parameters, parse_rig, rig_to_yaml, with_parameters
from sim_core.rigs.yamlfile import parse_mapping
from sysid.diagnosis.known_priors import with_known_priors
from sysid.model.parameters import fit_parameters, known_before
from sysid.settings.diagnosis import DIAGNOSIS


def test_a_share_and_a_deviation_are_beliefs_in_the_fitted_scale(small_rig: Any) -> None:
    rig = small_rig(known={"gel.E": {"relative_sd": 0.1}, "card.nu": {"sd": 0.02}})
    modulus, ratio, density = fit_parameters(rig, ["gel.E", "card.nu", "card.density"])
    assert modulus.log and modulus.known_sd == pytest.approx(0.1)
    assert not ratio.log and ratio.known_sd == pytest.approx(0.02)
    assert density.known_sd is None and not density.pulled and modulus.pulled
    halved = with_parameters(rig, {"gel.E": 0.5 * 1e5})
    assert fit_parameters(halved, ["gel.E"])[0].known_sd == pytest.approx(0.1), "a share is one of any value"


def test_a_deviation_of_a_positive_number_is_a_share_of_its_value(small_rig: Any) -> None:
    value = next(p.value for p in list_parameters(small_rig()) if p.name == "gel.E_pa" and p.value is not None)
    rig = small_rig(known={"gel.E_pa": {"sd": 0.2 * value}})
    assert fit_parameters(rig, ["gel.E"])[0].known_sd == pytest.approx(0.2)


def test_a_diagnosis_takes_the_rig_before_what_is_usual(small_rig: Any) -> None:
    rig = small_rig(known={"gel.E": {"relative_sd": 0.01}})
    modulus, other = with_known_priors(rig, fit_parameters(rig, ["gel.E", "card.E"]))
    assert modulus.known_sd == pytest.approx(0.01)
    assert other.known_sd == DIAGNOSIS.known_sd["E_pa"]


def test_a_prior_of_the_fit_takes_its_place(small_rig: Any) -> None:
    rig = small_rig(known={"gel.E": {"relative_sd": 0.01}})
    (modulus,), _ = known_before(fit_parameters(rig, ["gel.E"]), rig, {"gel.E": (2e5, 4e4)})
    assert modulus.known_sd == pytest.approx(0.2)


def test_it_is_kept_where_the_rig_is_written(small_rig: Any) -> None:
    rig = small_rig(known={"gel.E": {"relative_sd": 0.01}})
    again = parse_rig(parse_mapping(rig_to_yaml(rig), "again"), "again")
    assert again.known == rig.known and again == rig


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ({"gel.F": {"sd": 1.0}}, "no parameter 'gel.F'"),
        ({"gel.E": {"sd": 1.0}, "gel.E_pa": {"sd": 2.0}}, "are the same"),
        ({"gel.E": {}}, "neither sd nor relative_sd"),
        ({"gel.E": {"sd": 1.0, "relative_sd": 0.1}}, "or both"),
        ({"gel.E": {"sd": 0.0}}, "greater than 0"),
        ({"side.latency": {"relative_sd": 0.1}}, "no share is known"),
    ],
)
def test_what_cannot_be_is_said(small_rig: Any, known: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        small_rig(known=known)
