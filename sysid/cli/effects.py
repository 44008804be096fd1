"""``thinshell effects``: the physics that a model may leave out, as the registry has it."""

from __future__ import annotations

import json
import math
from typing import Annotated, Any

import typer


def effects(
    name: Annotated[
        str | None, typer.Argument(metavar="[EFFECT]", help="One effect, in full; without it, a list.")
    ] = None,
    rig: Annotated[
        str | None, typer.Option("--rig", metavar="RIG", help="Only those that can act on this rig.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """List the effects that a rig may name and a diagnosis looks for, or tell all about one.

    Example: thinshell effects gel_relaxation
    """
    from sim_core.effects import all_effects, effect_by_name
    from sim_core.rigs import load_rig

    chosen = [effect_by_name(name)] if name is not None else list(all_effects().values())
    if rig is not None:
        loaded = load_rig(rig)
        chosen = [e for e in chosen if e.applies(loaded)]
    found = [_described(e) for e in chosen]
    if as_json:
        print(json.dumps(found, indent=2, allow_nan=False))
    elif name is not None:
        for effect in found:
            print(_in_full(effect))
    else:
        width = max((len(e["name"]) for e in found), default=0)
        places = max((len(e["slot"]) for e in found), default=0)
        for e in found:
            print(f"{e['name']:{width}}  {e['slot']:{places}}  {e['title']}")
        print("\n'thinshell effects NAME' tells all about one.")


def _described(effect: Any) -> dict[str, Any]:
    """What the registry says of an effect."""

    def finite(value: float | None) -> float | None:
        return value if value is not None and math.isfinite(value) else None

    return {
        "name": effect.name,
        "title": effect.title,
        "slot": effect.slot,
        "words": effect.words,
        "signature": effect.signature,
        "source": effect.source,
        "follows": effect.follows,
        "passive": effect.passive,
        "needs": effect.scope.needs,
        "twins": list(effect.twins),
        "separated_by": effect.separated_by,
        "parameters": [
            {"name": p.name, "unit": p.unit, "lower": finite(p.lower), "upper": finite(p.upper),
             "vanishes_at": None if p.vanishing is None else str(p.vanishing), "words": p.words}
            for p in effect.parameters
        ],
    }  # fmt: skip


def _in_full(effect: dict[str, Any]) -> str:
    lines = [f"{effect['name']}: {effect['title']} (acts on: {effect['slot']})", "", effect["words"], ""]
    lines += [f"Left out of a model: {effect['signature']}"] if effect["signature"] else []
    if effect["twins"]:
        lines.append(f"Easily mistaken for {', '.join(effect['twins'])}. To tell them apart: {effect['separated_by']}")
    elif effect["separated_by"]:
        lines.append(f"To make sure of it: {effect['separated_by']}")
    lines += [f"Source: {effect['source']}"] if effect["source"] else []
    passive = "it can only take up energy" if effect["passive"] else "it may give energy"
    lines += [f"It needs {effect['needs']}, follows the {effect['follows']}, and {passive}.", "", "parameters"]
    for p in effect["parameters"]:
        vanishes = f"; does nothing at {p['vanishes_at']}" if p["vanishes_at"] is not None else ""
        bounds = " to ".join("any" if p[end] is None else f"{p[end]:g}" for end in ("lower", "upper"))
        lines.append(f"  {p['name']} [{p['unit']}]  {bounds}{vanishes}")
        lines.append(f"      {p['words']}")
    first = ", ".join(f"{p['name']}: ..." for p in effect["parameters"])
    lines += ["", "in a rig file (on one target alone: NAME@TARGET, several of a kind: NAME@TARGET#LABEL)"]
    lines += [f"  effects: {{{effect['name']}: {{{first}}}}}"]
    return "\n".join(lines)
