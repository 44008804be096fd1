"""What the schema of rigs says of itself, from which its reference is made."""

from __future__ import annotations

from sim_core.rigs import Rig
from sim_core.scene.contact_constants import OF_EDGE, OF_MODULUS, OF_THICKNESS, PRESSURE_PA, WIDEST_M

SCHEMA = Rig.model_json_schema()
MODELS = {"Rig": SCHEMA, **SCHEMA["$defs"]}


def test_every_model_and_every_key_says_what_it_is() -> None:
    silent = [name for name, model in MODELS.items() if not model.get("description")]
    silent += [
        f"{name}.{key}"
        for name, model in MODELS.items()
        for key, entry in model.get("properties", {}).items()
        if not entry.get("description") and "const" not in entry
    ]
    assert silent == []


def test_what_a_contact_is_without_its_keys_is_what_the_scene_takes() -> None:
    contact = MODELS["Contact"]["properties"]
    span, stiffness = (contact[key]["description"] for key in ("range_m", "stiffness_pa_per_m"))
    for value in (f"{1e2 * OF_EDGE:g} % of the shortest", f"{1e2 * OF_THICKNESS:g} %", f"{1e6 * WIDEST_M:g} um"):
        assert value in span
    assert OF_MODULUS == 0.25
    assert f"{1e-3 * PRESSURE_PA:g} kPa" in stiffness
