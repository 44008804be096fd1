"""Coulomb friction with known solutions: a sheet that lies on a rigid plane, the whole scene turned at will.

A flat sheet is the ideal sledge: pressure and friction act per area, alike at all of its points. It slips if and
only if tan(slope) > mu, then accelerates at g (sin - mu cos); thrown along a level plane it stops after
v^2 / (2 mu g).

Below the limit the law of :mod:`sim_core.contact.pressure_and_friction` is an elastic slip: the sheet gives way by
u = y u_c with 2 y - y^2 = tan(slope) / mu, u_c = 2 mu p / k, and stays there. Laws that regularise Coulomb's in the
velocity creep instead, at the speed y eps_v.

Static above kinetic friction, a sheet pulled by a spring at a slow speed: it sticks up to mu_s N, then slips in half
a swing about mu_k N, so that the spring's force is a sawtooth of the height 2 (mu_s - mu_k) N (Rabinowicz, Friction
and Wear of Materials, sec. 4.8), and there is none where the two are equal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from sim_core.contact.rigid import RigidContact
from sim_core.contact.samples import sheet_samples
from sim_core.contact.shapes import HALF_SPACE
from sim_core.effects.static_friction import StaticFriction
from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.energies.term import Term
from sim_core.geometry.sheets import SheetMesh, rectangle
from sim_core.solve.step import State, advance, deflections
from sim_core.solve.system import System
from sim_core.solve.unknowns import Compliant
from sysid.validation.case import STATICS, THRESHOLDS, Case, NotCovered
from sysid.validation.specimens import rest

SHEET = {"E_pa": 1e9, "nu": 0.3, "thickness_m": 1e-3}
DENSITY, G, MU = 1000.0, 9.81, 0.4
STIFF, SOFT = 5e9, 1e6
"""Contact stiffness [Pa/m]: that of a rig that names none, and one that lets the elastic slip be seen."""

RANGE = {STIFF: 3e-5, SOFT: 1e-4}
TURNS = {
    "upright": Rotation.identity(),
    **{f"turned at random ({k})": r for k, r in enumerate(Rotation.random(3, random_state=7), start=1)},
}
COULOMB = "Coulomb's law"


@dataclass
class Sledge:
    """A sheet on a plane in a scene that is turned by ``turn``; its directions here are those of the upright one."""

    system: System
    contact: RigidContact
    turn: Rotation
    state: State
    sheet: np.ndarray
    weight: float

    def slope(self, tangent: float, heading: float = 0.0) -> None:
        """Turn gravity so that the plane falls towards ``heading`` [rad] with this tangent."""
        down = np.array([np.cos(heading), np.sin(heading), 0.0])
        steep = np.arctan(tangent)
        self.system.gravity = self.turn.apply(G * (np.sin(steep) * down - np.cos(steep) * np.array([0.0, 0.0, 1.0])))

    def step(self, dt: float, count: int = 1, targets: Callable[[float], np.ndarray] | None = None) -> None:
        """Advance by ``count`` steps; ``targets``: where what is prescribed is at a time [s]."""
        for _ in range(count):
            place = self.system.nodes if targets is None else targets(self.state.t + dt)
            self.state, _ = advance(self.system, self.state, place, dt)

    def place(self) -> np.ndarray:
        """Mean position of the sheet [m]."""
        return np.asarray(self.turn.inv().apply(self.state.x[self.sheet].mean(axis=0)))

    def throw(self, velocity: Sequence[float]) -> None:
        """Give all of the sheet a velocity [m/s]."""
        v = np.zeros_like(self.state.v)
        v[self.sheet] = self.turn.apply(velocity)
        self.state = replace(self.state, v=v, past=None)

    def slides(self) -> bool:
        """Whether all points slid in the last step."""
        return bool((self.state.internals["contact"]["slip_speed"] > 0.0).all())


def sledge(
    turn: Rotation,
    stiffness: float = STIFF,
    spring: float | None = None,
    second_order: bool = False,
    excess: float = 0.0,
) -> Sledge:
    """A sheet that rests on a level plane. ``spring`` [N/m]: all of the sheet is pulled by one along x.
    ``excess``: static over kinetic friction, less one."""
    mesh = rectangle(0.04, 0.03, (4, 3), "irregular")
    thickness = SHEET["thickness_m"]
    pressure = DENSITY * thickness * G
    load, reach = pressure / stiffness / RANGE[stiffness], RANGE[stiffness]
    gap = reach * (1.0 + 0.5 * load - np.sqrt(load + 0.25 * load**2))  # (1 - s)^2 / s = load
    upright = np.vstack([mesh.nodes + [0.0, 0.0, 0.5 * thickness + gap], np.zeros(3)])
    nodes = turn.apply(upright)
    body, matrix = len(mesh.nodes), turn.as_matrix()
    contact = RigidContact(
        "contact", sheet_samples(mesh, 0, thickness), body, np.array([HALF_SPACE, 0, 0, 0, 0], dtype=float), matrix
    )
    contact.laws.add(StaticFriction.name, StaticFriction())
    contact.configure(
        {"static_friction.excess": excess, "stiffness_pa_per_m": stiffness, "range_m": reach, "friction": MU}
    )
    axis = matrix[:, 0]
    terms: list[Term] = [
        Membrane("membrane", nodes, mesh.triangles, axis),
        Bending("bending", SheetMesh(nodes[:body], mesh.triangles), 0, axis),
    ]
    for term in terms:
        term.configure(SHEET)
    prescribed = np.zeros((len(nodes), 3), dtype=bool)
    prescribed[body] = True
    compliant = []
    if spring is not None:
        prescribed[:] = True
        compliant = [Compliant(np.arange(body), np.array([1.0 / spring, 1e9, 1e9]))]
    mass = sp.diags(np.append(mesh.node_areas * DENSITY * thickness, 0.0)).tocsr()
    system = System(
        nodes, mass, prescribed, [*terms, contact], np.zeros(3), compliant=compliant, second_order=second_order
    )
    made = Sledge(system, contact, turn, rest(system), np.arange(body), pressure * 0.04 * 0.03)
    made.slope(0.0)
    made.step(0.005, 10)
    return made


def elastic_slip(ratio: float, turn: Rotation, heading: float = 0.7) -> tuple[float, float]:
    """How far the sheet gives way on a slope of ``ratio`` mu, and how far it moves in the second after, over u_c."""
    sheet = sledge(turn, SOFT)
    start = sheet.place()
    for share in np.linspace(0.0, ratio, 41)[1:]:
        sheet.slope(share * MU, heading)
        sheet.step(0.01)
    sheet.step(0.01, 20)
    down = np.array([np.cos(heading), np.sin(heading), 0.0])
    pressure = DENSITY * SHEET["thickness_m"] * G * np.cos(np.arctan(ratio * MU))
    longest = 2.0 * MU * pressure / SOFT
    given = float((sheet.place() - start) @ down)
    sheet.step(0.02, 50)
    later = float((sheet.place() - start) @ down)
    return given / longest, (later - given) / longest


def slip_onset(turn: Rotation, heading: float) -> float:
    """tan(slope) / mu at which the sheet slips, to 0.1 %."""
    sheet = sledge(turn)
    for ratio in (0.5, 0.9, *np.arange(0.95, 1.06, 0.001)):
        sheet.slope(ratio * MU, heading)
        sheet.step(0.005, 2)
        if sheet.slides():
            return float(ratio)
    return np.inf


def acceleration(turn: Rotation, tangent: float, heading: float, dt: float = 0.005) -> float:
    """Along the slope, over g (sin - mu cos)."""
    sheet = sledge(turn)
    sheet.slope(tangent, heading)
    down = np.array([np.cos(heading), np.sin(heading), 0.0])
    path = []
    for _ in range(40):
        sheet.step(dt)
        path.append(float(sheet.place() @ down))
    steep = np.arctan(tangent)
    return float(np.diff(path[10:], 2).mean() / dt**2 / (G * (np.sin(steep) - MU * np.cos(steep))))


def stopping_distance(turn: Rotation, speed: float, heading: float, second_order: bool, dt: float) -> float:
    """Way of a sheet that is thrown along the level plane, over v^2 / (2 mu g)."""
    sheet = sledge(turn, second_order=second_order)
    start = sheet.place()
    sheet.throw([speed * np.cos(heading), speed * np.sin(heading), 0.0])
    while sheet.state.t < 0.05 + 1.3 * speed / (MU * G):
        sheet.step(dt)
    return float(np.linalg.norm(sheet.place() - start) / (speed**2 / (2.0 * MU * G)))


def sawtooth(excess: float, seconds: float = 3.5, dt: float = 5e-3) -> float:
    """Height of the sawtooth of the spring's force, over 2 (mu_s - mu_k) N (over N where there is no excess).

    Pulled so slowly that neither the speed of the pull nor the slip speed over which mu falls counts.
    """
    pull, rate = 2e-3, 10.0
    mass = DENSITY * SHEET["thickness_m"] * 0.04 * 0.03
    spring = rate**2 * mass
    sheet = sledge(Rotation.identity(), SOFT, spring=spring, second_order=excess > 0.0, excess=excess)
    begin, first = sheet.state.t, (1.0 + 0.9 * excess) * MU * sheet.weight / spring

    def targets(t: float) -> np.ndarray:
        out: np.ndarray = sheet.system.nodes.copy()
        out[sheet.sheet, 0] += first * min(1.0, t - begin) + pull * max(0.0, t - begin - 1.0)
        return out

    forces = []
    while sheet.state.t < begin + seconds:
        sheet.step(dt, targets=targets)
        forces.append(-spring * float(deflections(sheet.system)[0, 0]))
    height = float(np.ptp(forces[round(1.0 / dt) :]))
    return height / (2.0 * excess * MU * sheet.weight) if excess else height / sheet.weight


def friction_cases() -> Iterator[Case | NotCovered]:
    """All comparisons of friction."""
    mesh = "irregular 4 x 3"
    remark = (
        "the law has an elastic slip and no creep: below its limit a contact gives way by (1 - sqrt(1 - tan/mu)) u_c, "
        "u_c = 2 mu p/k, and rests"
    )
    for ratio in (0.5, 0.9):
        for name, turn in list(TURNS.items())[:2]:
            given, drift = elastic_slip(ratio, turn)
            name = f"sheet on a slope of {ratio:g} mu, {name}"
            exact = 1.0 - np.sqrt(1.0 - ratio)
            yield Case(name, "elastic slip", "u_c", exact, given, STATICS, mesh, COULOMB, remark=remark)
            yield Case(name, "creep in a second", "u_c", 0.0, drift, STATICS, mesh, COULOMB, scale=1.0, remark=remark)
    for (name, turn), heading in zip(TURNS.items(), (0.3, 1.9, 3.3, 5.2), strict=True):
        title = f"sheet on a slope, {name}"
        yield Case(title, "tan(slope) at slip", "mu", 1.0, slip_onset(turn, heading), STATICS, mesh, COULOMB)
        found = acceleration(turn, 1.5 * MU, heading)
        yield Case(title, "acceleration, tan = 1.5 mu", "g(sin-mu cos)", 1.0, found, STATICS, mesh, COULOMB)
    for second_order in (False, True):
        fine, coarse = (stopping_distance(TURNS["upright"], 0.5, 0.4, second_order, dt) for dt in (1e-3, 2e-3))
        yield Case(
            f"sheet thrown along a plane, {'BDF2' if second_order else 'implicit Euler'}", "stopping distance",
            "v^2/(2 mu g)", 1.0, fine, STATICS, "irregular 4 x 3, dt = 1 ms", COULOMB, (coarse,),
        )  # fmt: skip
    for excess in (0.25, 0.5):
        yield Case(
            f"sheet pulled by a spring, mu_s = {1.0 + excess:g} mu_k", "height of the sawtooth", "2(mu_s-mu_k)N", 1.0,
            sawtooth(excess), THRESHOLDS, "irregular 4 x 3, BDF2, dt = 5 ms", "Rabinowicz, stick-slip",
        )  # fmt: skip
    yield Case(
        "sheet pulled by a spring, mu_s = mu_k", "height of the sawtooth", "N", 0.0, sawtooth(0.0), THRESHOLDS,
        "irregular 4 x 3, implicit Euler, dt = 5 ms", "Rabinowicz, stick-slip", scale=1.0,
    )  # fmt: skip
    yield NotCovered(
        "steady creep on a slope below the limit (velocity-regularised friction)",
        "friction is an elastic slip with memory, which does not creep; its own answer is the elastic slip above",
        "Li et al. 2020, incremental potential contact",
    )
