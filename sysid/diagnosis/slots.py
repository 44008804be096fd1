"""Which equation or sensor is unreliable, without any law: evidence for each place where physics may hide.

Every slot of the model gets a closure that says nothing of its law, only of its place: the stiffness of a body, the
friction of a contact, the mass of a sheet, where a hand really is, what a wrench sensor or a camera adds, how late a
clock is, each free to change in time as a sum of hat functions in every recording by itself. How much better the
recordings are then explained, less what so much freedom costs (the evidence of Laplace, as in
:mod:`sysid.diagnosis.screening`), ranks the slots. A closure is valid only inside the recordings that it is found from:
it says where to look, and predicts nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.effects import Effect
from sim_core.rigs import Gel, Rig, Sheet
from sysid.model.parameters import FitParameter, fit_parameters
from sysid.model.prediction_source import Responding
from sysid.model.predictor import Prediction
from sysid.model.responses import Modulated
from sysid.observations.observations import Measured, Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted
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


@dataclass(frozen=True)
class SlotEvidence:
    """``gain`` [nats]: evidence of the closure over the baseline; ``explained``: share of chi-square beyond noise that
    it takes away."""

    slot: Slot
    gain: float
    explained: float


def mechanical_slots(rig: Rig) -> list[tuple[Slot, list[str]]]:
    """Slots of the mechanics and the parameters that their closures change."""
    found: list[tuple[Slot, list[str]]] = []
    for name, body in rig.bodies.items():
        if isinstance(body, Gel):
            found.append((Slot("gel", name, f"the stiffness of {name} changes"), [f"{name}.E_pa"]))
        elif isinstance(body, Sheet):
            found.append((Slot("sheet", name, f"the stiffness of {name} changes"), [f"{name}.E_pa"]))
            if rig.solver.inertia or any(rig.gravity_m_s2):
                mass = Slot("environment", name, f"what pulls and holds {name} beside elasticity changes")
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


def slot_evidence(engine: Responding, problem: Problem, base: Fitted, kappa: float) -> list[SlotEvidence]:
    """Evidence of each slot beside a fitted baseline, best first. ``kappa``: misfit over noise that the best model
    leaves, by which data count less."""
    slots = mechanical_slots(base.rig)
    names = [name for _, parameters in slots for name in parameters]
    parameters = {p.name: p for p in fit_parameters(base.rig, names)}
    modulated = {
        run.name: [
            Modulated(n, np.array([c - w, c, c + w]), np.array([0.0, 1.0, 0.0]))
            for n in parameters
            for c, w in hats(run)
        ]
        for run in problem.runs
    }
    jobs = [
        engine.submit_responses(base.rig, run, base.parameters, base.scaled, [], modulated[run.name])
        for run in problem.runs
    ]
    predictions = [job.result() for job in jobs]
    sensors = sensor_slots(problem)
    columns, owners = _columns(problem, base, predictions, list(parameters), sensors)
    assembled = problem.assemble(columns, [str(k) for k in range(len(owners) + len(base.parameters))], base.scaled)
    rows: list[list[np.ndarray]] = [[] for _ in problem.runs]
    at = 0
    for i, _, times in assembled.labels:
        rows[i].append(np.arange(at, at + len(times)))
        at += len(times)
    shared = len(base.parameters)
    width = np.array([p.known_sd or p.prior_sd for p in base.parameters])
    inner = assembled.jacobian[:, :shared].T @ assembled.jacobian[:, :shared] / kappa + np.diag(1.0 / width**2)
    pull = base.residual[len(base.residual) - base.pulls :] / width if base.pulls else np.zeros(shared)
    slope = assembled.jacobian[:, :shared].T @ assembled.residual / kappa + pull
    left = np.linalg.solve(inner, slope) if shared else np.zeros(0)
    beyond = max(float(assembled.residual @ assembled.residual) - base.samples, 1.0)
    found = []
    for slot, wanted in [*slots, *((s, [s.name]) for s in sensors)]:
        mine = np.array([k for k, (kind, name) in enumerate(owners) if (kind, name) in _keys(slot, wanted)], dtype=int)
        if not len(mine):
            continue
        sd = np.array([coefficient_sd(slot, owners[k][1], parameters) for k in mine])
        gain, fall = 0.0, 0.0
        for part in rows:
            here = np.concatenate(part) if part else np.zeros(0, dtype=int)
            j, r = assembled.jacobian[here], assembled.residual[here]
            d = j[:, shared + mine] * sd
            cross = d.T @ j[:, :shared] / kappa
            g = d.T @ r / kappa - cross @ left
            information = d.T @ d / kappa - cross @ (np.linalg.solve(inner, cross.T) if shared else cross.T)
            whole = information + np.eye(len(mine))
            gain += 0.5 * float(g @ np.linalg.solve(whole, g)) - 0.5 * float(np.linalg.slogdet(whole)[1])
            fall += kappa * float(g @ np.linalg.solve(whole, g))
        found.append(SlotEvidence(slot, gain, min(1.0, max(0.0, fall / beyond))))
    return sorted(found, key=lambda s: -s.gain)


def hats(run: Run) -> list[tuple[float, float]]:
    """Centres and widths [s] of the hat functions of a recording."""
    width = run.end / (DIAGNOSIS.closure_hats - 1)
    return [(k * width, width) for k in range(DIAGNOSIS.closure_hats)]


def sensor_slots(problem: Problem) -> list[Slot]:
    """Slots of the sensors, cameras and clocks."""
    kinds = {m.channel: m.kind for run in problem.runs for m in run.measured}
    found = []
    for channel, kind in kinds.items():
        place = "wrench" if kind == "wrench" else "camera"
        found.append(Slot(place, channel, f"{channel} adds something to its readings"))
        found.append(Slot("clock", channel, f"the clock of {channel} is off"))
    return found


def _keys(slot: Slot, wanted: Sequence[str]) -> set[tuple[str, str]]:
    kind = slot.place if slot.place in ("wrench", "camera", "clock") else "parameter"
    return {(kind, name) for name in wanted}


def coefficient_sd(slot: Slot, name: str, parameters: dict[str, FitParameter]) -> float:
    """Standard deviation of the coefficient of a column."""
    if slot.place in ("wrench", "camera"):
        return DIAGNOSIS.closure_sensor_share
    if slot.place == "clock":
        return DIAGNOSIS.closure_clock_s
    return next((sd for end, sd in DIAGNOSIS.closure_sd.items() if name.endswith(end)), parameters[name].prior_sd)


def _columns(
    problem: Problem, base: Fitted, predictions: Sequence[Prediction], names: Sequence[str], sensors: Sequence[Slot]
) -> tuple[list[Prediction], list[tuple[str, str]]]:
    """Predictions with the derivatives by the baseline's parameters and by all coefficients, and to what each of the
    latter belongs."""
    shared = len(base.parameters)
    owners = [("parameter", n) for n in names for _ in range(DIAGNOSIS.closure_hats)]
    widths = {slot: shape_count(slot, problem) for slot in sensors}
    for slot in sensors:
        owners += [(slot.place, slot.name)] * (DIAGNOSIS.closure_hats * widths[slot])
    out = []
    for run, prediction in zip(problem.runs, predictions, strict=True):
        derivatives = {}
        for m in run.measured:
            parts = [prediction.derivatives[m.channel]]
            for slot in sensors:
                shape = (*m.values.shape, DIAGNOSIS.closure_hats * widths[slot])
                values, size = prediction.values[m.channel], reading_size(m)
                mine = slot.name == m.channel
                parts.append(sensed(slot, m, values, size, _hats_at(run, m.t)) if mine else np.zeros(shape))
            derivatives[m.channel] = np.concatenate(parts, axis=-1)
        out.append(Prediction(prediction.values, derivatives, prediction.trace))
    assert all(d.shape[-1] == shared + len(owners) for p in out for d in p.derivatives.values())
    return out, owners


def shape_count(slot: Slot, problem: Problem) -> int:
    """How many shapes the closure of a sensor has."""
    kind = next(m.kind for run in problem.runs for m in run.measured if m.channel == slot.name)
    return 1 if slot.place == "clock" else 6 if kind == "wrench" else 2 * DIMENSIONS[kind]


def _hats_at(run: Run, t: np.ndarray) -> np.ndarray:
    return np.stack([np.maximum(0.0, 1.0 - np.abs(t - c) / w) for c, w in hats(run)], axis=-1)


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
