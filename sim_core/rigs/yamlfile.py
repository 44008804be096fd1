"""YAML files into checked models, with one clear sentence for everything that can be wrong.

Scalars follow YAML 1.2: ``1e6`` is a number, ``010`` is ten, ``on`` and ``no`` are words. Duplicate
keys, tabs, empty files and files that hold no mapping are errors.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from sim_core.errors import ConfigError, nearest_match
from sim_core.rigs.fields import Strict, describe, unit_of

Model = TypeVar("Model", bound=Strict)

MAX_BYTES = 10_000_000

RECORDINGS = {".mcap", ".db3", ".bag"}
"""Endings of files of recordings."""


class _Loader(yaml.SafeLoader):
    """Safe loader with the scalars of YAML 1.2 that refuses a key given twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[object] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                problem = "a list or a mapping is used as a key"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            if key in seen and key != "<<":
                problem = f"the key {key!r} is given twice"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep=deep)

    def construct_decimal(self, node: yaml.ScalarNode) -> int:
        """A whole number in decimal digits, leading zeros or not."""
        return int(node.value)


_SCALARS = {
    "bool": (r"^(true|True|TRUE|false|False|FALSE)$", "tTfF"),
    "int": (r"^[-+]?[0-9]+$", "-+0123456789"),
    "float": (
        r"^([-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN))$",
        "-+.0123456789",
    ),
    "null": (r"^(~|null|Null|NULL|)$", "~nN\0"),
    "merge": (r"^<<$", "<"),
}
_Loader.yaml_implicit_resolvers = {}
for _tag, (_pattern, _first) in _SCALARS.items():
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}",
        re.compile(_pattern),
        [*_first.replace("\0", ""), *([""] if "\0" in _first else [])],
    )
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_decimal)


def read_mapping(path: Path) -> dict[str, Any]:
    """Read a YAML file that holds one mapping at its top level."""
    try:
        if path.is_dir():
            raise ConfigError(f"{path} is a folder, not a YAML file.", _wanted(path))
        if path.exists() and not path.is_file():
            raise ConfigError(f"{path} is neither a file nor a folder (a device, a pipe or a socket).", _wanted(path))
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise ConfigError(
                f"{path} has {size} bytes, more than the {MAX_BYTES} that a configuration may have.",
                _wanted(path),
            )
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path} does not exist.", _near_files(path)) from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path} is not a text file in UTF-8.", _wanted(path)) from None
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}.", "Check the path and its permissions.") from None
    return parse_mapping(text, str(path))


def _wanted(path: Path) -> str:
    """What to give instead of what is no YAML file."""
    inside = [path, *path.iterdir()] if path.is_dir() else [path]
    if any(RECORDINGS & {s.lower() for s in p.suffixes} or p.name == "metadata.yaml" for p in inside):
        return "This looks like a recording; rigs and experiments come before recordings."
    return "Name the YAML file inside it." if path.is_dir() else "Name a YAML file."


def parse_mapping(text: str, source: str) -> dict[str, Any]:
    """Parse YAML text that holds one mapping; ``source`` names it in errors."""
    try:
        data = yaml.load(text, Loader=_Loader)  # a subclass of SafeLoader
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        remedy = "Keep one of the two." if "twice" in (error.problem or "") else "Correct the line."
        if mark and "\t" in text.splitlines()[min(mark.line, len(text.splitlines()) - 1)]:
            remedy = "The line holds a tab; YAML indents with spaces."
        raise ConfigError(f"{source}{place}: {error.problem}.", remedy) from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ConfigError(f"{source} is not YAML: {' '.join(str(error).split())}.", "Correct the file.") from None
    if data is None:
        raise ConfigError(f"{source} is empty.", "Write a rig or an experiment as 'key: value' lines.")
    if not isinstance(data, dict):
        raise ConfigError(
            f"{source} holds {describe(data)}, not a mapping.", "Write 'key: value' lines at the top level."
        )
    return data


def validate(model: type[Model], data: Mapping[str, Any], source: str) -> Model:
    """Check a mapping against a model; the first problem becomes a ``ConfigError``."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        problem, remedy = _explain(problems[0], data)
        more = len(problems) - 1
        if more:
            remedy += f" ({more} more problem{'s' if more > 1 else ''} in this file.)"
        raise ConfigError(f"{source}: {problem}", remedy) from None


def _near_files(path: Path) -> str:
    folder = path.parent
    if not folder.is_dir():
        return f"The folder {folder} does not exist either; check the path."
    names = [entry.name for entry in folder.iterdir() if entry.suffix in {".yaml", ".yml"}]
    return nearest_match(path.name, names) if names else "Check the path."


def _steps(location: tuple[int | str, ...], data: object) -> list[int | str]:
    """The path as the file has it: tags that the checker inserts for kinds of a body are left out."""
    steps: list[int | str] = []
    current: Any = data
    for index, step in enumerate(location):
        if isinstance(current, Mapping) and step in current:
            current = current[step]
        elif isinstance(current, list | tuple) and isinstance(step, int):
            current = current[step] if step < len(current) else None
        elif isinstance(current, Mapping) and isinstance(step, str) and _is_tag(step, current):
            continue
        elif index < len(location) - 1 or step == "[key]":
            continue
        steps.append(step)
    return steps


def _join(steps: list[int | str]) -> str:
    text = ""
    for step in steps:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else str(step)
    return text


def _is_tag(step: str, current: Mapping[str, Any]) -> bool:
    return step in (current.get("type"), current.get("model"))


def _explain(error: ErrorDetails, data: Mapping[str, Any]) -> tuple[str, str]:
    kind = error["type"]
    context: dict[str, Any] = error.get("ctx", {})
    location = error["loc"]
    if kind == "trouble":
        where = _join([*_steps(location, data), *context["path"]])
        return f"{where} {context['problem']}".strip(), context["remedy"]
    where = _join(_steps(location, data)) or "the file"
    value = error["input"]
    if kind in {"union_tag_invalid", "union_tag_not_found"}:
        return _explain_tag(error, where)
    bounds = {
        "greater_than": ("gt", "greater than"),
        "greater_than_equal": ("ge", "at least"),
        "less_than": ("lt", "less than"),
        "less_than_equal": ("le", "at most"),
    }
    if kind in bounds:
        key, words = bounds[kind]
        unit = unit_of(str(location[-1])) or unit_of(str(location[-2])) if len(location) > 1 else ""
        remedy = f"The unit is {unit}; check that the value is in it." if unit else "Correct the value."
        return f"{where} is {describe(value)}, but must be {words} {context[key]:g}.", remedy
    if kind == "finite_number":
        return f"{where} is {value}, which is not a finite number.", "Write a number."
    if kind in {"float_type", "int_type", "int_from_float"}:
        wanted = "a number" if kind == "float_type" else "a whole number"
        remedy = f"Write {wanted}."
        if isinstance(value, str):
            remedy = f"Write {wanted} without quotation marks and without a unit (1.0e6, not '1e6 Pa')."
        return f"{where} is {describe(value)}, not {wanted}.", remedy
    if kind == "bool_type":
        return f"{where} is {describe(value)}.", "Write true or false."
    if kind == "string_type":
        return (
            f"{where} is {describe(value)}, not a text.",
            "Write a name; put quotation marks around a number or a date.",
        )
    if kind == "string_pattern_mismatch":
        return f"{where} is {describe(value)}, which cannot be used as a name here.", _pattern_hint(context["pattern"])
    if kind == "literal_error":
        return f"{where} is {describe(value)}.", f"Choose one of: {context['expected']}."
    if kind in {"too_short", "too_long", "tuple_type", "list_type"}:
        count = context.get("min_length") or context.get("max_length")
        amount = {"too_short": f" of {count} or more", "too_long": f" of at most {count}"}.get(kind, "")
        return f"{where} is {describe(value)}.", f"Write a list{amount}."
    if kind in {"dict_type", "model_type", "mapping_type", "model_attributes_type"}:
        return f"{where} is {describe(value)}, not a mapping.", "Write 'key: value' lines below it."
    return f"{where} is {describe(value)}: {error['msg']}.", "Correct the value."


def _explain_tag(error: ErrorDetails, where: str) -> tuple[str, str]:
    context: dict[str, Any] = error.get("ctx", {})
    key = str(context["discriminator"]).strip("'")
    expected = [tag.strip(" '") for tag in str(context.get("expected_tags", "")).split(",") if tag.strip()]
    if error["type"] == "union_tag_invalid":
        return f"{where}.{key} is {context['tag']!r}.", nearest_match(context["tag"], expected)
    if not isinstance(error["input"], Mapping):
        return (
            f"{where} is {describe(error['input'])}, not a mapping.",
            f"Write 'key: value' lines, beginning with '{key}: ...'.",
        )
    return f"{where}.{key} is missing.", f"Add '{key}: ...', which says what kind it is."


def _pattern_hint(pattern: str) -> str:
    if pattern == r"^[a-z][a-z0-9_]*$":
        return "Use small letters, digits and _, beginning with a letter."
    return "Use letters, digits, _ and /, beginning with a letter, as ROS names do."
