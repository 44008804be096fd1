"""``thinshell rigs`` and ``thinshell params``: what there is to choose from."""

from __future__ import annotations

import json
import math
from typing import Annotated

import typer

from sysid.cli.options import RigArgument


def rigs() -> None:
    """List the rigs and experiments that come with the package."""
    from sim_core.rigs.load import load_rig, names_in
    from sim_core.rigs.motion import load_experiment

    rows = [("rig", name, load_rig(name).description) for name in names_in("rigs")]
    rows += [("experiment", name, load_experiment(name).description) for name in names_in("experiments")]
    width = max((len(name) for _, name, _ in rows), default=0)
    for kind, name, description in rows:
        print(f"{kind:10}  {name:{width}}  {description}")


def params(
    rig: RigArgument,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """List the parameters of a rig: name, value, unit and bounds."""
    from sim_core.rigs import list_parameters, load_rig

    found = list_parameters(load_rig(rig))
    if as_json:
        rows = [
            {
                "name": p.name,
                "value": p.value,
                "unit": p.unit,
                "lower": p.lower if math.isfinite(p.lower) else None,
                "upper": p.upper if math.isfinite(p.upper) else None,
                "description": p.description,
            }
            for p in found
        ]
        print(json.dumps(rows, indent=2))
        return
    width = max((len(p.name) for p in found), default=0)
    for p in found:
        value = "by the simulator" if p.value is None else f"{p.value:.6g} {p.unit}".strip()
        print(f"{p.name:{width}}  {value:20}  {p.lower:g} .. {p.upper:g}  {p.description}".rstrip())
