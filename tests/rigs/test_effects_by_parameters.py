"""Effects that a rig does not name are added by giving their parameters a value."""

import pytest

from sim_core.effects import active_effects
from sim_core.errors import ConfigError
from sim_core.rigs import list_parameters, load_rig, with_parameters


def test_an_effect_is_added_with_the_values_that_are_given() -> None:
    rig = load_rig("card_press")
    given = {"effects.static_friction.excess": 0.3, "effects.contact_adhesion@gel-card.work_j_m2": 0.1,
             "effects.contact_adhesion@gel-card.range_m": 1e-4, "gel.E": 1e5}  # fmt: skip
    changed = with_parameters(rig, given)
    assert changed.effects == {
        "static_friction": {"excess": 0.3},
        "contact_adhesion@gel-card": {"work_j_m2": 0.1, "range_m": 1e-4},
    }
    assert [i.targets for i in active_effects(changed)][1] == ("gel-card",)
    values = {p.name: p.value for p in list_parameters(changed)}
    assert values["effects.static_friction.excess"] == 0.3
    assert values["gel.E_pa"] == 1e5
    assert with_parameters(changed, {"effects.static_friction.excess": 0.1}).effects["static_friction"] == {
        "excess": 0.1
    }
    assert rig.effects == {}


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("effects.static_frict.excess", 0.3, "Did you mean 'static_friction'?"),
        ("effects.static_friction.excess", -2.0, "excess"),
        ("effects.contact_adhesion.work_j_m2", 0.1, "range_m"),
        ("effects.air_drag@gel.drag_coefficient", 1.0, "gel"),
        ("effects.static_friction", 0.3, "no parameter"),
    ],
)
def test_an_effect_that_cannot_be_added_is_an_error_with_a_remedy(name: str, value: float, said: str) -> None:
    with pytest.raises(ConfigError, match=said.replace("?", r"\?")):
        with_parameters(load_rig("card_press"), {name: value})
