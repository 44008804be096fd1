"""The page on motions names every kind and every key that an experiment may have, with unit, default and bounds."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from sim_core.rigs import load_rig
from sim_core.rigs.fields import unit_of
from sim_core.rigs.motion import Experiment, compile_experiment
from sim_core.rigs.yamlfile import validate

PAGE = (Path(__file__).parents[2] / "docs" / "motions.md").read_text()
SECTIONS = {
    title.strip("` ").lower(): text for title, text in re.findall(r"^##+ (.*?)\n(.*?)(?=^##|\Z)", PAGE, re.M | re.S)
}
SCHEMA = Experiment.model_json_schema()
TAGS = SCHEMA["properties"]["motions"]["patternProperties"].popitem()[1]["items"]["discriminator"]["mapping"]
KINDS = {tag: SCHEMA["$defs"][path.rsplit("/", 1)[1]] for tag, path in TAGS.items()}
DESCRIBED = {"keys of an experiment": SCHEMA, "poses": SCHEMA["$defs"]["Pose"], **KINDS}


def rows(section: str) -> dict[str, tuple[str, str, str]]:
    """Unit, default and bounds by key, as a section has them."""
    found = re.findall(r"^\| `(\w+)` \| (.*?) ?\| (.*?) ?\| (.*?) ?\| (.+) \|$", SECTIONS[section], re.M)
    return {key: (unit, default, bounds) for key, unit, default, bounds, _ in found}


def bounds_in_words(schema: dict[str, Any]) -> str:
    """Those of a number, of each entry of a list of numbers, or the words to choose from."""
    schema = schema.get("anyOf", [schema])[0]
    schema = schema.get("prefixItems", [schema])[0]
    if "enum" in schema:
        return " or ".join(f"`{word}`" for word in schema["enum"])
    if schema.get("type") == "boolean":
        return "`true` or `false`"
    low = f"above {schema['exclusiveMinimum']:g}" if "exclusiveMinimum" in schema else f"{schema.get('minimum', ''):}"
    if "maximum" in schema:
        return f"{low.removesuffix('.0')} to {schema['maximum']:g}"
    return f"from {low.removesuffix('.0')}" if low else ""


def default_in_words(key: str, model: dict[str, Any]) -> str:
    """As YAML; in words where the key has no value."""
    if key in model.get("required", ()):
        return "required"
    default = model["properties"][key]["default"]
    if default is None:
        return "none"
    if default == "":
        return ""
    if isinstance(default, dict) and default:
        return "the start pose"
    return f"`{yaml.safe_dump(default, default_flow_style=True).removesuffix('...' + chr(10)).strip()}`"


def test_every_kind_is_in_the_list_and_has_a_section_with_an_example() -> None:
    listed = re.findall(r"^\| \[`(\w+)`\]\(#(\w+)\) \|", SECTIONS["kinds of motion"], re.M)
    assert all(kind == link for kind, link in listed)
    assert sorted(kind for kind, _ in listed) == sorted(KINDS)
    assert set(KINDS) <= set(SECTIONS)


@pytest.mark.parametrize("section", DESCRIBED)
def test_every_key_has_its_unit_default_and_bounds(section: str) -> None:
    model = DESCRIBED[section]
    shared = rows("keys of a move") if "(#keys-of-a-move)" in SECTIONS[section] else {}
    expected = {
        key: (unit_of(key), default_in_words(key, model), bounds_in_words(found))
        for key, found in model["properties"].items()
        if key != "type"
    }
    assert shared | rows(section) == expected


@pytest.mark.parametrize("kind", KINDS)
def test_the_example_of_a_kind_can_be_run(kind: str) -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", SECTIONS[kind], re.S)
    motion = yaml.safe_load(text)
    assert motion["type"] == kind
    experiment = validate(Experiment, {"name": "example", "motions": {"finger": [motion]}}, kind)
    assert compile_experiment(experiment, load_rig("card_press"))["finger"].duration > 0.0


def test_the_first_example_is_an_experiment() -> None:
    text = re.findall(r"```yaml\n(.*?)```", PAGE, re.S)[0]
    experiment = validate(Experiment, yaml.safe_load(text), "page")
    # A press of 6 mm takes 1.875 * 6 / 20 s each way, twice with 0.2 s of rest; the slide 1.875 * 10 / 10 s each way.
    duration = compile_experiment(experiment, load_rig("card_press"))["finger"].duration
    assert duration == pytest.approx(0.3 + 2 * (2 * 0.5625 + 0.2) + 2 * 1.875, abs=0.01)
