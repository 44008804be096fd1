"""The catalogue of effects, from the registry."""

from __future__ import annotations

import inspect
import sys
from math import isfinite
from pathlib import Path

from sim_core.effects import Effect, EffectParameter, all_effects
from sim_core.effects import hooks as interfaces

PICTURES = Path(__file__).resolve().parents[1] / "pictures" / "effects"
"""What :mod:`gallery` draws."""

HEAD = """# Catalogue of effects

This page is made from the registry of effects. An effect is a piece of physics that a rig may name
(`effects: {NAME: {...}}`), a fit may estimate (`effects.NAME.PARAMETER`) and a diagnosis looks for. `thinshell effects`
prints the same. Pictures show what each does to the readings of a rig, with the sizes of its example, over the noise of
one reading (`make gallery`). [How effects are named in a rig, and how to add one](../effects.md).
"""


def page() -> str:
    """The page as Markdown: a table of all, then a section for each."""
    effects = all_effects()
    rows = [
        f"| [`{name}`](#{name}) | {effect.slot} | {interface(effect)} | {effect.title} |"
        for name, effect in effects.items()
    ]
    table = ["| effect | acts on | interface | what happens |", "| --- | --- | --- | --- |", *rows]
    return "\n\n".join([HEAD, "\n".join(table), *(_section(effect) for effect in effects.values())]) + "\n"


def interface(effect: Effect) -> str:
    """Name of the interface that an effect implements."""
    kinds = [c.__name__ for c in type(effect).__mro__ if c.__module__ == interfaces.__name__]
    return f"`{kinds[0]}`" if kinds else ""


def _section(effect: Effect) -> str:
    lines = [f"## {effect.name}", "", f"*{effect.title[0].upper()}{effect.title[1:]}.* {effect.words}", ""]
    if (PICTURES / f"{effect.name}.png").is_file():
        lines += [f"![Readings without {effect.name} and with it](../pictures/effects/{effect.name}.png)", ""]
    if effect.signature:
        lines += [f"**Left out of a model.** {effect.signature}", ""]
    if effect.twins:
        twins = ", ".join(f"[`{twin}`](#{twin})" for twin in effect.twins)
        lines += [f"**Easily mistaken for** {twins}. {effect.separated_by}", ""]
    elif effect.separated_by:
        lines += [f"**To make sure of it.** {effect.separated_by}", ""]
    passive = "It can only store or take up energy." if effect.passive else "It may give energy."
    lines += [f"It needs {effect.scope.needs} and follows the {effect.follows}. {passive}", ""]
    if effect.source:
        lines += [f"Source: {effect.source}.", ""]
    if formula := inspect.cleandoc(sys.modules[type(effect).__module__].__doc__ or ""):
        indented = "\n".join(f"    {line}".rstrip() for line in formula.splitlines())
        lines += ['??? note "The law"', "", "    ```text", indented, "    ```", ""]
    lines += ["| parameter | unit | bounds | does nothing at | meaning |", "| --- | --- | --- | --- | --- |"]
    lines += [_row(p) for p in effect.parameters]
    given = ", ".join(f"{key}: {_number(value)}" for key, value in effect.example.items())
    lines += ["", "```yaml", "effects:", f"  {effect.name}: {{{given}}}", "```"]
    return "\n".join(lines)


def _number(value: float) -> str:
    """A number as YAML reads it: 1e+10 without a point would be a text."""
    text = f"{value:g}"
    return text if "e" not in text or "." in text else text.replace("e", ".0e")


def _row(p: EffectParameter) -> str:
    low, high = (f"{bound:g}" if isfinite(bound) else "any" for bound in (p.lower, p.upper))
    vanishing = "" if p.vanishing is None else f"{p.vanishing:g}"
    return f"| `{p.name}` | {p.unit} | {low} to {high} | {vanishing} | {p.words} |"
