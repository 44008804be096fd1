"""``thinshell settings``: the numbers by which results are decided."""

from __future__ import annotations

import json
from collections.abc import Mapping
from inspect import cleandoc
from textwrap import fill
from typing import Annotated, Any

import typer

from sim_core.errors import ConfigError


def settings(
    room: Annotated[str | None, typer.Argument(metavar="[ROOM]", help="One room; without it, all.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """List the numbers by which fits and diagnoses are decided: unit, meaning, and how each was chosen.

    They are no options; results record them.

    Example: thinshell settings diagnosis
    """
    from sim_core.settings import CHOSEN, described, values
    from sysid.settings import all_settings

    found = all_settings()
    if room is not None:
        if room not in found:
            raise ConfigError(f"There are no settings of {room!r}.", f"Choose one of {', '.join(found)}.")
        found = {room: found[room]}
    if as_json:
        print(json.dumps({name: values(of) for name, of in found.items()}, indent=2, allow_nan=False))
        return
    for name, of in found.items():
        print(fill(f"{name}: {cleandoc(type(of).__doc__ or '')}", 100))
        for one in described(of):
            unit = "" if one.unit == "1" else f" {one.unit}"
            print(f"  {one.name} = {_value(one.value)}{unit}  ({one.chosen})")
            print(fill(one.meaning, 100, initial_indent="      ", subsequent_indent="      "))
        print()
    print("In brackets is how a setting was chosen:")
    for chosen, words in CHOSEN.items():
        print(f"  {chosen:{max(map(len, CHOSEN))}}  it {words}")


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_value(one)}" for key, one in value.items())
    if isinstance(value, tuple):
        return ", ".join(f"({_value(one)})" if isinstance(one, tuple) else _value(one) for one in value)
    return f"{value:.7g}" if isinstance(value, float) else str(value)
