"""The reference of rig files, from the schema that checks them."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import yaml

from sim_core.materials.presets import PRESETS, preset_values
from sim_core.rigs import Rig
from sim_core.rigs.fields import unit_of

HEAD = """# Keys of a rig file

This page is made from the schema that checks rig files. Units are SI unless the key says otherwise, and each key ends
with its unit. An unknown key is an error that names the nearest one. A default of *none* means that the key may be left
out; what then holds is in its meaning. [How to write a rig](../rigs.md) explains the parts by an example.
"""

Schema = dict[str, Any]


def page() -> str:
    """The page as Markdown: one section for each model, in the order in which a rig reaches them."""
    schema = Rig.model_json_schema()
    models = {"Rig": schema, **schema["$defs"]}
    sections = [_section(name, models[name], where) for name, where in _reached(models).items()]
    return "\n\n".join([HEAD, *sections, _presets()]) + "\n"


def _reached(models: dict[str, Schema]) -> dict[str, list[str]]:
    """Models by name, depth first from the rig, with the keys under which they stand."""
    found: dict[str, list[str]] = {}

    def visit(name: str, where: str) -> None:
        if name in found:
            if where not in found[name]:
                found[name].append(where)
            return
        found[name] = [where] if where else []
        for key, entry in models[name].get("properties", {}).items():
            below = f"{where}.{key}" if where else key
            for inner, suffix in _referenced(entry):
                visit(inner, below + suffix)

    visit("Rig", "")
    return found


def _referenced(entry: Schema, suffix: str = "") -> Iterator[tuple[str, str]]:
    """Models that an entry may hold, with what stands between its key and them."""
    if "$ref" in entry:
        yield entry["$ref"].rsplit("/", 1)[1], suffix
    for choice in (*entry.get("anyOf", ()), *entry.get("oneOf", ())):
        yield from _referenced(choice, suffix)
    if isinstance(entry.get("items"), dict):
        yield from _referenced(entry["items"], suffix + "[]")
    for inner in (*entry.get("patternProperties", {}).values(), entry.get("additionalProperties")):
        if isinstance(inner, dict):
            yield from _referenced(inner, suffix + ".NAME")


def _section(name: str, model: Schema, where: list[str]) -> str:
    lines = [f"## {name}", ""]
    tags = [(k, e["const"]) for k, e in model.get("properties", {}).items() if "const" in e]
    if where:
        places = ", ".join(f"`{place}`" for place in where[:4]) + (" and more" if len(where) > 4 else "")
        lines += [f"Stands at {places}" + "".join(f", with `{key}: {value}`" for key, value in tags) + ".", ""]
    lines += [words(model.get("description", "")), ""]
    lines += ["| key | takes | unit | default | bounds | meaning |", "| --- | --- | --- | --- | --- | --- |"]
    for key, entry in model.get("properties", {}).items():
        cells = (takes(entry), unit_of(key), default(key, model), bounds(entry), words(entry.get("description", "")))
        lines.append(f"| `{key}` | " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines)


def words(text: str) -> str:
    """Prose of a docstring as Markdown."""
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", inspect.cleandoc(text)).replace("``", "`")


def takes(entry: Schema) -> str:
    """What a key takes, in words; models are links to their sections."""
    if "const" in entry:
        return f"`{entry['const']}`"
    if "enum" in entry:
        return " or ".join(f"`{word}`" for word in entry["enum"])
    if "$ref" in entry:
        name = entry["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#{name.lower()})"
    if choices := entry.get("anyOf") or entry.get("oneOf"):
        return " or ".join(takes(choice) for choice in choices if choice.get("type") != "null")
    kind = entry.get("type")
    if kind == "array":
        if "prefixItems" in entry:
            return f"list of {len(entry['prefixItems'])}: {takes(entry['prefixItems'][0])}"
        return f"list of {takes(entry['items'])}"
    if kind == "object":
        inner = next(iter(entry.get("patternProperties", {}).values()), entry.get("additionalProperties", {}))
        return f"names, each with {takes(inner)}"
    return {"number": "number", "integer": "whole number", "boolean": "`true` or `false`"}.get(str(kind), "text")


def default(key: str, model: Schema) -> str:
    """The value that holds where a key is left out, as YAML."""
    if key in model.get("required", ()):
        return "required"
    value = model["properties"][key].get("default")
    if value is None:
        return "*none*"
    if value == "":
        return "empty"
    text = yaml.safe_dump(value, default_flow_style=True, width=1000).removesuffix("...\n").strip()
    return f"`{text}`" if len(text) <= 60 else "its defaults"


def bounds(entry: Schema) -> str:
    """Bounds of a number, or of each entry of a list of numbers."""
    for choice in entry.get("anyOf", [entry]):
        number = choice.get("prefixItems", [choice.get("items", choice)])[0]
        low = f"above {number['exclusiveMinimum']:g}" if "exclusiveMinimum" in number else ""
        low = low or (f"from {number['minimum']:g}" if "minimum" in number else "")
        high = f"below {number['exclusiveMaximum']:g}" if "exclusiveMaximum" in number else ""
        high = high or (f"to {number['maximum']:g}" if "maximum" in number else "")
        if low or high:
            return f"{low} {high}".strip()
    return ""


def _presets() -> str:
    lines = ["## Material presets", "", "A key next to `preset:` takes the place of the preset's value.", ""]
    keys = ("E_pa", "nu", "density_kg_m3", "thickness_m")
    lines += [
        "| preset | " + " | ".join(f"`{key}`" for key in keys) + " | source |",
        "| --- | " + "--- | " * len(keys) + "--- |",
    ]
    for name in PRESETS:
        values = preset_values(name)
        numbers = " | ".join(f"{values[key]:g}" if key in values else "" for key in keys)
        lines.append(f"| `{name}` | {numbers} | {getattr(PRESETS[name], 'source', '')} |")
    return "\n".join(lines)
