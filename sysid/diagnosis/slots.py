"""Places of the model where physics may hide, and what of the model or of a sensor a closure changes there.

The stiffness of a body, the friction of a contact, the mass of a sheet, where a hand really is, what a wrench sensor or
a camera adds, how late a clock is: :mod:`sysid.diagnosis.closures` lets each change with what the recordings show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.effects import Effect
from sim_core.rigs import Gel, Rig, Sheet
from sysid.model.parameters import FitParameter
from sysid.observations.observations import Measured
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.outliers import DIMENSIONS
from sysid.solve.residuals import Problem


@dataclass(frozen=True)
class Slot:
    """One place. ``place``: 'gel', 'sheet', 'contact', 'robot', 'environment', 'wrench', 'camera' or 'clock';
    ``name``: of the body, contact, hand or channel; ``words``: what may be off there, with a subject."""

    place: str
    name: str
    words: str


def place_of(effect: Effect) -> str:
    """The place of the model that an effect amends, in the words of slots."""
    return {"air": "environment"}.get(effect.slot, effect.slot.removesuffix(" sensor"))


def mechanical_slots(rig: Rig) -> list[tuple[Slot, list[str]]]:
    """Slots of the mechanics and the parameters that their closures change."""
    found: list[tuple[Slot, list[str]]] = []
    for name, body in rig.bodies.items():
        if isinstance(body, Gel):
            found.append((Slot("gel", name, f"the stiffness of {name} changes"), [f"{name}.E_pa"]))
        elif isinstance(body, Sheet):
            found.append((Slot("sheet", name, f"the stiffness of {name} changes"), [f"{name}.E_pa"]))
            if rig.solver.inertia or any(rig.gravity_m_s2):
                mass = Slot("environment", name, f"what pulls and holds {name} besides elasticity changes")
                found.append((mass, [f"{name}.density_kg_m3"]))
    for contact in rig.contacts:
        if contact.friction > 0.0:
            words = f"the friction of {contact.name} changes"
            found.append((Slot("contact", contact.name, words), [f"contacts.{contact.name}.friction"]))
    for name in rig.end_effectors:
        offsets = [f"{name}.offset_{a}_m" for a in "xyz"]
        offsets += [f"{name}.offset_r{a}_deg" for a in "xyz"]
        found.append((Slot("robot", name, f"{name} is not where its pose says"), offsets))
    return found


def sensor_slots(problem: Problem) -> list[Slot]:
    """Slots of the sensors, cameras and clocks."""
    kinds = {m.channel: m.kind for run in problem.runs for m in run.measured}
    found = []
    for channel, kind in kinds.items():
        place = "wrench" if kind == "wrench" else "camera"
        found.append(Slot(place, channel, f"{channel} adds something to its readings"))
        found.append(Slot("clock", channel, f"the clock of {channel} is off"))
    return found


def coefficient_sd(slot: Slot, name: str, parameters: dict[str, FitParameter]) -> float:
    """Standard deviation of the coefficient of a column."""
    if slot.place in ("wrench", "camera"):
        return DIAGNOSIS.closure_sensor_share
    if slot.place == "clock":
        return DIAGNOSIS.closure_clock_s
    return next((sd for end, sd in DIAGNOSIS.closure_sd.items() if name.endswith(end)), parameters[name].prior_sd)


def shape_count(slot: Slot, problem: Problem) -> int:
    """How many shapes the closure of a sensor has."""
    kind = next(m.kind for run in problem.runs for m in run.measured if m.channel == slot.name)
    return 1 if slot.place == "clock" else 6 if kind == "wrench" else 2 * DIMENSIONS[kind]


def reading_size(measured: Measured) -> np.ndarray:
    """How much the readings of a channel vary: the range of each component of a wrench, ``(6,)``, and how far markers
    move, root mean square, ``(1,)``."""
    if measured.kind == "wrench":
        return np.asarray(np.ptp(np.nan_to_num(measured.values), axis=0))
    values = measured.values
    moved = np.nan_to_num(values - values[np.argmax(np.isfinite(values).any(axis=1))])
    return np.array([max(float(np.sqrt(np.mean(moved**2))), 1e-12)])


def sensed(slot: Slot, measured: Measured, values: np.ndarray, size: np.ndarray, courses: np.ndarray) -> np.ndarray:
    """Columns ``(n, m, k)`` of a sensor's closure, each of its shapes by each of the ``courses`` ``(n, c)``: of a
    wrench each component by itself; of markers shifts of the whole picture and what grows with the place in it, both
    of the ``size`` of the readings; of a clock the rate of the readings. ``values`` ``(n, m)``: as predicted."""
    t = measured.t
    if slot.place == "clock":
        rate = np.gradient(np.nan_to_num(values), t, axis=0) if len(t) > 1 else np.zeros(values.shape)
        shapes = -rate[..., None]
    elif measured.kind == "wrench":
        shapes = np.broadcast_to(np.diag(size), (len(t), 6, 6))
    else:
        k = DIMENSIONS[measured.kind]
        points = np.nan_to_num(values).reshape(len(t), -1, k)
        about = points - points.mean(axis=1, keepdims=True)
        about = about / max(float(np.abs(about).max(initial=0.0)), 1e-12)
        shifts = np.broadcast_to(np.eye(k), (*points.shape, k))
        grows = about[..., None] * np.eye(k)
        shapes = size * np.concatenate([shifts, grows], axis=-1).reshape(*values.shape, 2 * k)
    columns = shapes[..., None] * courses[:, None, None, :]
    return np.asarray(columns.reshape(*values.shape, -1))
