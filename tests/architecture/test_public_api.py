"""The declared public API: its names exist, and their docstrings say shapes and units of arrays."""

from __future__ import annotations

import importlib
import inspect
import re
from typing import Any

import pytest
from public_api import PUBLIC, names

DECLARED = [f"{module}:{name}" for module in PUBLIC for name in names(module)]
ARRAY = re.compile(r"ndarray|NDArray|Floats?Array|Floats\b")
SHAPE = re.compile(r"``?\([\w\s,.+*-]*\)``?|shape \(|\(n, ?[^)]*\)")
UNIT = re.compile(r"\[[^\]]+\]|\bSI\b")


def found(declared: str) -> Any:
    module, name = declared.split(":")
    return getattr(importlib.import_module(module), name)


def arrays_of(thing: Any) -> list[str]:
    """Arguments, fields and results of a public function or class that are arrays."""
    if inspect.isclass(thing):
        notes = dict(getattr(thing, "__annotations__", {}))
        notes = {name: note for name, note in notes.items() if not name.startswith("_")}
    elif inspect.isfunction(thing):
        notes = dict(thing.__annotations__)
    else:
        notes = {}
    return [name for name, note in notes.items() if ARRAY.search(str(note)) and "Callable" not in str(note)]


@pytest.mark.parametrize("module", PUBLIC)
def test_a_public_module_says_what_it_is_and_names_each_thing_once(module: str) -> None:
    assert importlib.import_module(module).__doc__
    declared = importlib.import_module(module).__all__
    assert sorted(set(declared)) == sorted(declared)


@pytest.mark.parametrize("declared", DECLARED)
def test_a_public_name_exists_and_is_described(declared: str) -> None:
    thing = found(declared)
    if not (inspect.isclass(thing) or inspect.isfunction(thing)):
        return  # a constant or an alias, described by its own docstring in the source
    words = inspect.getdoc(thing) or ""
    assert len(words.split()) >= 3, f"{declared} has no docstring"
    if thing.__doc__ and arrays_of(thing):
        assert UNIT.search(words), f"{declared} does not say the units of {arrays_of(thing)}"
        assert SHAPE.search(words), f"{declared} does not say the shapes of {arrays_of(thing)}"
