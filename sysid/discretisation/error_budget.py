"""Cells, time step and contact constants by which the error of each is below a third of the noise.

Each is halved once where the rig stands, alone, and what that changes in the readings y tells the error that is left,

    e = 2^p / (2^p - 1) (y_halved - y)

(Richardson's extrapolation), of second order in the size of cells, of the integrator's order in the time step, and of
first order in the range of contact at the same scale of pressure. What is above a third of the noise, rms over a
quantity of a channel, is halved for good, and all are measured anew. The first time that the cells of gels are too
large, and rigid bodies touch them, those in and around the contact are made finer alone
(:mod:`sysid.discretisation.contact_mesh`), as the fields are steep there; after that, all are halved.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim_core.errors import ConfigError, ThinshellError
from sim_core.rigs import Affine, Gel, GelFile, Outline, Rectangle, Rig, Sheet
from sim_core.scene import build_scene
from sim_core.scene.contact_constants import constants_of, finest_edge
from sysid.discretisation.contact_mesh import refined_where_touched
from sysid.model.predictor import Prediction, SerialPredictor
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import quantities
from sysid.observations.observations import Run
from sysid.progress.callback import Progress
from sysid.settings.discretisation import DISCRETISATION

MESH, STEP, CONTACT = "cells", "time step", "contact"

Key = tuple[str, str]
"""Channel and quantity."""


@dataclass(frozen=True)
class Measurement:
    """How far a rig is from convergence. ``ratios``: error over noise of each cause, by channel and quantity;
    ``seconds``: wall time of a simulation of all runs as the rig is, and with each cause halved."""

    ratios: Mapping[str, Mapping[Key, float]]
    plain_s: float
    seconds: Mapping[str, float]

    def worst(self, cause: str) -> float:
        """Largest error over noise of a cause."""
        return max(self.ratios[cause].values(), default=0.0)

    @property
    def too_large(self) -> list[str]:
        """Causes whose error is not below its bound."""
        return [cause for cause in self.ratios if self.worst(cause) > DISCRETISATION.budget_over_noise]


@dataclass
class Convergence:
    """What was found. ``rig``: with cells, step and contact constants; ``rounds``: measurements, the last of it;
    ``changes``: what was changed, in words; ``left``: for each cause that is still too large, what it would cost."""

    rig: Rig
    rounds: list[Measurement] = field(default_factory=list)
    changes: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)

    @property
    def converged(self) -> bool:
        """Whether every error is below its bound."""
        return not self.left

    def table(self) -> str:
        """The errors at first and at last, what was changed, and what is left."""
        first, last = self.rounds[0], self.rounds[-1]
        lines = [f"{'error over noise, at most 0.33':34}{'before':>10}{'after':>10}"]
        for cause, ratios in last.ratios.items():
            for (channel, quantity), ratio in ratios.items():
                before = first.ratios[cause].get((channel, quantity), 0.0)
                lines.append(f"{f'{cause}: {channel} {quantity}':34}{before:10.3g}{ratio:10.3g}")
        lines.append(f"{'wall time of a simulation [s]':34}{first.plain_s:10.3g}{last.plain_s:10.3g}")
        return "\n".join([*lines, *self.changes, *self.left])


def converge(
    rig: Rig,
    runs: Sequence[Run],
    noise: Mapping[str, ChannelNoise],
    *,
    most_s: float = 600.0,
    on_progress: Progress | None = None,
) -> Convergence:
    """Refine a rig until halving its cells, its time step, and the range of its contacts changes no channel of the runs
    by more than a third of its noise. ``most_s`` [s]: longest wall time of one simulation of all runs that is begun."""
    engine, found = SerialPredictor(), Convergence(rig)

    def tell(words: str) -> None:
        if on_progress is not None:
            on_progress(len(found.rounds) / DISCRETISATION.budget_rounds, f"round {len(found.rounds) + 1}: {words}")

    for k in range(DISCRETISATION.budget_rounds):
        measured = _measured(engine, found.rig, runs, noise, tell)
        found.rounds.append(measured)
        found.left, affordable = [], []
        for cause in measured.too_large:
            cost = _cost(measured, cause, found.rig)
            if cost[0] <= most_s and k + 1 < DISCRETISATION.budget_rounds and _can_halve(found.rig, cause):
                affordable.append(cause)
            else:
                found.left.append(_left(found.rig, cause, measured.worst(cause), cost[1], most_s))
        if not affordable:
            break
        for cause in affordable:
            found.rig = _halved(found, cause, runs)
    if on_progress is not None:
        on_progress(1.0, "done")
    return found


def _measured(
    engine: SerialPredictor,
    rig: Rig,
    runs: Sequence[Run],
    noise: Mapping[str, ChannelNoise],
    tell: Callable[[str], None],
) -> Measurement:
    """Simulate the runs as the rig is, and with each cause halved, which ``tell`` hears before."""

    def simulated(words: str, make: Callable[[Run], Prediction]) -> tuple[list[Prediction], float]:
        tell(f"simulating the rig {words}")
        begin = time.perf_counter()
        try:
            return [make(run) for run in runs], time.perf_counter() - begin
        except ThinshellError as error:
            raise type(error)(f"The rig could not be simulated {words}: {error.problem}", error.remedy) from error

    plain, plain_s = simulated("as it is", lambda run: engine.predict(rig, run))
    if plain_s < DISCRETISATION.timed_twice_s:  # kernels that are compiled once do not count
        plain, plain_s = simulated("as it is", lambda run: engine.predict(rig, run))
    ways: dict[str, tuple[int, Callable[[Run], Prediction]]] = {
        MESH: (DISCRETISATION.mesh_order, lambda run: engine.predict(rig, run, 2)),
        STEP: (rig.solver.order, lambda run: engine.predict(rig, run, 1, 0.5 * rig.solver.dt_s)),
    }
    if rig.contacts:
        sharper = with_half_range(rig)
        ways[CONTACT] = (DISCRETISATION.contact_order, lambda run: engine.predict(sharper, run))
    ratios, seconds = {}, {}
    for cause, (order, make) in ways.items():
        halved, seconds[cause] = simulated(f"with half the {cause}", make)
        ratios[cause] = _ratios(runs, plain, halved, noise, 2.0**order / (2.0**order - 1.0))
    return Measurement(ratios, plain_s, seconds)


def _ratios(
    runs: Sequence[Run],
    plain: Sequence[Prediction],
    halved: Sequence[Prediction],
    noise: Mapping[str, ChannelNoise],
    factor: float,
) -> dict[Key, float]:
    """Error over noise by channel and quantity: rms, the largest of all runs."""
    found: dict[Key, float] = {}
    for run, there, here in zip(runs, plain, halved, strict=True):
        for m in run.measured:
            error = factor * (here.values[m.channel] - there.values[m.channel]) / noise[m.channel].sigma
            error = np.where(np.isfinite(m.values), error, np.nan)
            for quantity, group in quantities(m):
                if np.isfinite(error[:, group]).any():
                    key = (m.channel, quantity)
                    found[key] = max(found.get(key, 0.0), float(np.sqrt(np.nanmean(error[:, group] ** 2))))
    return found


def _cost(measured: Measurement, cause: str, rig: Rig) -> tuple[float, float]:
    """Wall time [s] of the next check if a cause is halved, and of a simulation in which its error is small enough, as
    the last halving has made it longer."""
    growth = max(measured.seconds[cause] / measured.plain_s, 1.0)
    order = {MESH: DISCRETISATION.mesh_order, STEP: rig.solver.order, CONTACT: DISCRETISATION.contact_order}[cause]
    halvings = int(np.ceil(np.log2(max(measured.worst(cause) / DISCRETISATION.budget_over_noise, 1.0)) / order))
    return growth * measured.seconds[cause], measured.plain_s * growth**halvings


def _can_halve(rig: Rig, cause: str) -> bool:
    """Whether the schema of rigs lets a cause be halved."""
    if cause == MESH:
        return with_half_cells(rig) != rig
    return cause != CONTACT or with_half_range(rig) != rig


def _left(rig: Rig, cause: str, ratio: float, seconds: float, most_s: float) -> str:
    """What to say of a cause that stays too large."""
    words = f"The error by {cause} is {ratio:.2g} times the noise, more than a third"
    if not _can_halve(rig, cause):
        return f"{words}, and cannot be made smaller in the rig: refine its mesh files, or its range is the least."
    return (
        f"{words}: about {seconds:.0f} s of wall time a simulation would make it small enough, where {most_s:.0f} s "
        "are allowed."
    )


def _halved(found: Convergence, cause: str, runs: Sequence[Run]) -> Rig:
    """The rig with one cause smaller, which the changes tell."""
    rig = found.rig
    if cause == STEP:
        found.changes.append(f"Time step: {rig.solver.dt_s:g} s -> {0.5 * rig.solver.dt_s:g} s.")
        return rig.model_copy(update={"solver": rig.solver.model_copy(update={"dt_s": 0.5 * rig.solver.dt_s})})
    if cause == CONTACT:
        found.changes.append("Range of contact: half as wide, at the same scale of pressure.")
        return with_half_range(rig)
    local = refined_where_touched(rig, runs)
    if local is not None:
        found.changes += local.notes
        return local.rig
    found.changes.append("Cells: half as wide in each direction.")
    return with_half_cells(rig)


def with_half_cells(rig: Rig) -> Rig:
    """A rig whose sheets, gels and affine bodies have cells of half the size; bodies from mesh files keep theirs."""
    bodies = dict(rig.bodies)
    for name, body in rig.bodies.items():
        update: dict[str, Any]
        if isinstance(body, Sheet) and isinstance(body.shape, Rectangle):
            update = {"cells": tuple(2 * n for n in body.shape.cells)}
        elif isinstance(body, Sheet) and isinstance(body.shape, Outline):
            update = {"edge_m": 0.5 * body.shape.edge_m}
        elif isinstance(body, Gel) and not isinstance(body.shape, GelFile):
            boxes = tuple(box.model_copy(update={"edge_m": 0.5 * box.edge_m}) for box in body.shape.refine)
            update = {"cells": tuple(2 * n for n in body.shape.cells), "refine": boxes}
        elif isinstance(body, Affine):
            shape = body.shape
            edge = body.edge_m or (max(shape.size_m) if shape.type == "box" else 0.2 * shape.radius_m)
            bodies[name] = body.model_copy(update={"edge_m": 0.5 * edge})
            continue
        else:
            continue
        bodies[name] = body.model_copy(update={"shape": body.shape.model_copy(update=update)})
    return rig.model_copy(update={"bodies": bodies})


def with_half_range(rig: Rig) -> Rig:
    """A rig whose contacts act over half the range, at the same scale of pressure; constants that it left to the
    simulator are written out."""
    scene = build_scene(rig)
    edges = {name: finest_edge(body) for name, body in scene.bodies.items() if isinstance(body.spec, Gel)}
    contacts = []
    for contact in rig.contacts:
        law = constants_of(rig, contact, edges)
        if law.range_m < 2.0 * DISCRETISATION.least_contact_range_m:
            contacts.append(contact)
            continue
        numbers = {"range_m": 0.5 * law.range_m, "stiffness_pa_per_m": 2.0 * law.stiffness_pa_per_m}
        contacts.append(contact.model_copy(update=numbers))
    return rig.model_copy(update={"contacts": tuple(contacts)})


def refuse_no_noise(lacking: Sequence[str]) -> None:
    """Raise where sensors have no noise against which an error could be small."""
    if lacking:
        raise ConfigError(
            f"The rig declares no noise of {', '.join(lacking)}, so no error is small against it.",
            "Write the noise of each sensor into the rig, or give a recording, which tells it.",
        )
