"""What effects can act on in a rig, and the words that say what a rig needs to have it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sim_core.rigs import Gel, MarkerSensor, Rig, Sheet, WrenchSensor

__all__ = [
    "CAMERAS",
    "CONTACTS",
    "END_EFFECTORS",
    "FRICTION_CONTACTS",
    "GELS",
    "MARKER_SENSORS",
    "SHEETS",
    "STREAMS",
    "WRENCH_SENSORS",
    "Scope",
]


@dataclass(frozen=True)
class Scope:
    """``needs``: what a rig must have, as a noun phrase; ``names``: of all that there is of it in a rig, in the rig's
    order."""

    needs: str
    names: Callable[[Rig], tuple[str, ...]]


SHEETS = Scope("a sheet", lambda rig: tuple(n for n, b in rig.bodies.items() if isinstance(b, Sheet)))
GELS = Scope("a gel", lambda rig: tuple(n for n, b in rig.bodies.items() if isinstance(b, Gel)))
CONTACTS = Scope("a contact", lambda rig: tuple(c.name for c in rig.contacts))
FRICTION_CONTACTS = Scope(
    "a contact with friction", lambda rig: tuple(c.name for c in rig.contacts if c.friction > 0.0)
)
WRENCH_SENSORS = Scope(
    "a wrench sensor", lambda rig: tuple(n for n, s in rig.sensors.items() if isinstance(s, WrenchSensor))
)
MARKER_SENSORS = Scope(
    "a marker sensor", lambda rig: tuple(n for n, s in rig.sensors.items() if isinstance(s, MarkerSensor))
)
CAMERAS = Scope("a camera", lambda rig: tuple(rig.cameras))
STREAMS = Scope("a sensor or a camera", lambda rig: (*rig.sensors, *rig.cameras))
END_EFFECTORS = Scope("an end effector", lambda rig: tuple(rig.end_effectors))
