"""Stand-ins for the parts of launch and launch_ros that the launch files use, which remember what they were given."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import pytest


class Remembers:
    """An action or substitution with its arguments."""

    def __init__(self, *values: Any, **named: Any) -> None:
        self.values, self.named = values, named


MODULES = {
    "launch": ["LaunchDescription"],
    "launch.actions": ["DeclareLaunchArgument", "ExecuteProcess", "RegisterEventHandler", "Shutdown"],
    "launch.conditions": ["IfCondition"],
    "launch.event_handlers": ["OnProcessExit"],
    "launch.substitutions": ["Command", "LaunchConfiguration"],
    "launch_ros": [],
    "launch_ros.actions": ["Node"],
    "launch_ros.parameter_descriptions": ["ParameterValue"],
}


def stand_in(patch: pytest.MonkeyPatch) -> dict[str, type[Remembers]]:
    """Put the stand-ins in the place of launch; returns them by name."""
    kinds = {name: type(name, (Remembers,), {}) for names in MODULES.values() for name in names}
    for module, names in MODULES.items():
        made = ModuleType(module)
        for name in names:
            setattr(made, name, kinds[name])
        patch.setitem(sys.modules, module, made)
    patch.delitem(sys.modules, "thinshell_ros.launching", raising=False)
    return kinds


def parts(value: Any, kind: type[Remembers]) -> list[Remembers]:
    """All stand-ins of a kind in what a launch file describes."""
    if isinstance(value, dict):
        return [found for item in value.values() for found in parts(item, kind)]
    if isinstance(value, list | tuple):
        return [found for item in value for found in parts(item, kind)]
    if not isinstance(value, Remembers):
        return []
    return [value] * isinstance(value, kind) + parts(value.values, kind) + parts(value.named, kind)
