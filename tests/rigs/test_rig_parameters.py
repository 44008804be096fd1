"""Names, bounds and changes of a rig's parameters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.rigs import list_parameters, load_rig, resolve_name, with_parameters
from sim_core.rigs.load import names_in

RIG = load_rig("card_press")


@pytest.mark.parametrize("name", names_in("rigs"))
def test_every_parameter_is_found_by_its_name_and_lies_in_its_bounds(name: str) -> None:
    rig = load_rig(name)
    for parameter in list_parameters(rig):
        assert resolve_name(rig, parameter.name) == parameter.name
        assert parameter.description
        if parameter.value is not None:
            assert parameter.lower <= parameter.value <= parameter.upper
            assert with_parameters(rig, {parameter.name: parameter.value}) == rig


@pytest.mark.parametrize(
    ("written", "full"),
    [
        ("card.E", "card.E_pa"),
        ("sheet.E", "card.E_pa"),
        (" card.thickness ", "card.thickness_m"),
        ("contacts.card-gel.friction", "contacts.gel-card.friction"),
        ("contact.gel-card.stiffness", "contacts.gel-card.stiffness_pa_per_m"),
        ("gel-card.friction", "contacts.gel-card.friction"),
        ("outside.latency", "outside.latency_s"),
    ],
)
def test_short_names(written: str, full: str) -> None:
    assert resolve_name(RIG, written) == full


@pytest.mark.parametrize(
    ("written", "remedy"),
    [
        ("gel.F", "Did you mean 'gel.E_pa'?"),  # not gel.nu, although more letters agree
        ("gell.E", "Did you mean 'gel.E_pa'?"),
        ("gel.E_Pa", "Did you mean 'gel.E_pa'?"),
        ("sheet.thicknes", "Did you mean 'card.thickness_m'?"),
        ("gel-pst.friction", "Did you mean 'contacts.gel-post.friction'?"),
        ("post-gell.frction", "Did you mean 'contacts.gel-post.friction'?"),
        ("outside.latncy", "Did you mean 'outside.latency_s'?"),
        # What the owner has, not what something else has that is spelt alike; and whose the quantity may be.
        (
            "gel.young",
            "Write one of: gel.E_pa, gel.density_kg_m3, gel.mass_damping_per_s, gel.nu, gel.stiffness_damping_s.",
        ),
        ("friction", "Write one of: contacts.gel-card.friction, contacts.gel-post.friction."),
        ("post.friction", "Did you mean 'contacts.gel-post.friction'?"),
        ("table.friction", "Write one of: contacts.gel-card.friction, contacts.gel-post.friction."),
    ],
)
def test_an_unknown_name_is_answered_with_the_nearest(written: str, remedy: str) -> None:
    with pytest.raises(ConfigError) as caught:
        resolve_name(RIG, written)
    assert caught.value.problem == f"The rig 'card_press' has no parameter {written!r}."
    assert caught.value.remedy == remedy


@pytest.mark.parametrize(
    ("owner", "frame"),
    [
        ("finger", "of the end effector's own frame, as its poses tell it"),
        ("outside", "of the camera's own frame, as 'pose' in the rig tells it"),
    ],
)
def test_offsets_name_the_frame_that_they_are_measured_in(owner: str, frame: str) -> None:
    """There the true pose is: shifted along, and then turned about, the axes of the nominal pose."""
    descriptions = {p.name: p.description for p in list_parameters(RIG)}
    for axis in "xyz":
        assert descriptions[f"{owner}.offset_{axis}_m"] == f"shift of the true pose along {axis} {frame}"
        assert (
            descriptions[f"{owner}.offset_r{axis}_deg"]
            == f"turn of the true pose, after the shift, about {axis} {frame}"
        )
    changed = with_parameters(RIG, {f"{owner}.offset_x": 0.01, f"{owner}.offset_rx": 30.0})
    part = changed.end_effectors.get(owner) or changed.cameras[owner]
    upright = Rotation.from_euler("z", 90.0, degrees=True)
    origin, turn = part.truly(np.array([0.1, 0.0, 0.0]), upright)
    assert origin == pytest.approx([0.1, 0.01, 0.0])
    assert (upright.inv() * turn).as_rotvec(degrees=True) == pytest.approx([30.0, 0.0, 0.0])


def test_a_changed_rig_differs_only_there() -> None:
    changed = with_parameters(RIG, {"card.E": 1e9, "gel-card.stiffness": 1e9})
    values = {p.name: p.value for p in list_parameters(changed)}
    before = {p.name: p.value for p in list_parameters(RIG)}
    assert {name for name in values if values[name] != before[name]} == {
        "card.E_pa",
        "contacts.gel-card.stiffness_pa_per_m",
    }
    assert before["card.E_pa"] == 2.5e9


@pytest.mark.parametrize(
    ("values", "pattern"),
    [
        ({"card.EE": 1.0}, r"no parameter 'card.EE'.*Did you mean 'card.E_pa'"),
        ({"card.nu": 0.6}, r"bodies.card.material.nu is 0.6, but must be at most 0.5"),
        ({"card.E": -1.0}, r"at least 1"),
        ({"card.E": float("nan")}, r"not a finite number"),
        ({"card.E": 1e9, "card.E_pa": 2e9}, r"given twice"),
    ],
)
def test_faulty_values_are_refused(values: dict[str, float], pattern: str) -> None:
    with pytest.raises(ConfigError, match=pattern):
        with_parameters(RIG, values)
