"""System identification and mismatch diagnosis from recordings. No ROS needed.

The names below are imported when they are asked for first, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid.fit.options import FitOptions
    from sysid.recording.reader import read_recording
    from sysid.simulate import simulate_to_bag
    from sysid.workflow.diagnose import diagnose_bags
    from sysid.workflow.fit import fit_bags

__all__ = ["FitOptions", "diagnose_bags", "fit_bags", "read_recording", "simulate_to_bag"]

_HOMES = {
    "FitOptions": "fit.options",
    "diagnose_bags": "workflow.diagnose",
    "fit_bags": "workflow.fit",
    "read_recording": "recording.reader",
    "simulate_to_bag": "simulate",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
