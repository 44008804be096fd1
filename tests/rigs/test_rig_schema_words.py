"""What the schema of rigs says of itself, from which its reference is made."""

from __future__ import annotations

from sim_core.rigs import Rig
from sim_core.scene.scene import CONTACT_RANGE_M, CONTACT_STIFFNESS_PA_PER_M

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
    for key, value in {"stiffness_pa_per_m": CONTACT_STIFFNESS_PA_PER_M, "range_m": CONTACT_RANGE_M}.items():
        assert float(contact[key]["description"].rsplit("left out: ", 1)[1]) == value
