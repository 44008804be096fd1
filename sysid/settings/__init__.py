"""Settings of identification and diagnosis: one file a room, which holds one frozen object of its name in capitals."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from typing import Any


def all_settings() -> dict[str, Any]:
    """The settings objects by the name of their room."""
    names = sorted(module.name for module in iter_modules(__path__))
    return {name: getattr(import_module(f"{__name__}.{name}"), name.upper()) for name in names}
