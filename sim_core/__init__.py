"""Differentiable simulation of thin shells, soft gels and frictional contact. No ROS needed.

The names below are imported when they are asked for first, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim_core.errors import ThinshellError
    from sim_core.rigs.load import load_rig
    from sim_core.rigs.motion import compile_experiment, load_experiment
    from sim_core.rigs.parameters import list_parameters, with_parameters
    from sim_core.scene.scene import build_scene
    from sim_core.trace_file import load_trace, save_trace
    from sim_core.trajectories.make import rollout

__all__ = [
    "ThinshellError",
    "build_scene",
    "compile_experiment",
    "list_parameters",
    "load_experiment",
    "load_rig",
    "load_trace",
    "rollout",
    "save_trace",
    "with_parameters",
]

_HOMES = {
    "ThinshellError": "errors",
    "build_scene": "scene.scene",
    "compile_experiment": "rigs.motion",
    "list_parameters": "rigs.parameters",
    "load_experiment": "rigs.motion",
    "load_rig": "rigs.load",
    "load_trace": "trace_file",
    "rollout": "trajectories.make",
    "save_trace": "trace_file",
    "with_parameters": "rigs.parameters",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
