"""Options that are numbers with bounds. What cannot be used is reported as everywhere: value, bound, remedy."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import typer

from sim_core.errors import ConfigError


def whole_number(name: str, help: str, least: int, most: int | None = None) -> Any:
    """An option that takes a whole number from ``least`` to ``most``."""
    return _option(name, help, "N", _checked(name, "whole number", int, least, most))


def number(name: str, help: str, least: float, most: float | None = None, metavar: str = "X") -> Any:
    """An option that takes a number from ``least`` to ``most``."""
    return _option(name, help, metavar, _checked(name, "number", float, least, most))


def _option(name: str, help: str, metavar: str, checked: Callable[[str], float]) -> Any:
    return typer.Option(name, metavar=metavar, parser=checked, help=f"{help.removesuffix('.')}; {checked.__doc__}.")


def _checked(
    name: str, noun: str, kind: Callable[[str], float], least: float, most: float | None
) -> Callable[[str], float]:
    """The number that a word stands for. Raises ``ConfigError``."""
    bounds = f"at least {least:g}" if most is None else f"from {least:g} to {most:g}"

    def checked(word: str) -> float:
        try:
            value = kind(word)
        except ValueError:
            value = math.nan
        if math.isnan(value):
            raise ConfigError(f"{name} is {word!r}, not a {noun}.", f"Write a {noun}, {bounds}, or leave {name} out.")
        if value < least or (most is not None and value > most):
            wanted = "larger" if value < least else "smaller"
            raise ConfigError(
                f"{name} is {word}, but must be {bounds}.", f"Write a {wanted} {noun}, or leave {name} out."
            )
        return value

    checked.__doc__ = bounds
    return checked
