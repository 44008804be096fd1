"""Material values and rest angles that differ from element to element, and shapes at rest.

    scene.fields["gel.E_pa"] = np.where(scene.fields.places("gel.E_pa")[:, 0] > 0.0, 5e4, 1e5)
    scene.fields["card.rest_m"] += [0.0, 0.0, 1e-3] * bump[:, None]

A field is kept as its share of the rig's number, so a rig with another number (:meth:`Scene.use`) scales all of it, and
a field that is everywhere that number changes no bit of a rollout. Energies are linear in the modulus and masses in the
density of an element; of a sheet's thickness h the membrane has the first power, bending the third, mass the first:

    E_element = f E_uniform,    f = prod_q (q / q_rig)^p

Where the rig's effects let a sheet yield, the curvature at which it does and its hardening are shares of the rig's
too, in each triangle's flow alone (:mod:`sim_core.energies.plastic_flow`); where they let a gel relax, in one branch,
so are the share of its stress that fades and the time constant.

Poisson's ratio and the dampings are no factors of an energy, and may be zero. Their fields are kept as the difference
from the rig's number, so a rig with another number shifts all of it; each element has the moduli of its own nu and the
rig's E, times f.

A shape at rest is that of a scene whose body is meshed with the same elements on other nodes: lengths, areas, volumes,
masses, curvatures and rest angles are measured on it, what is sampled for contact bears by its areas, and the body is
there when a rollout starts. What the rig picks by place stays with the material: nodes in clamps, bonded faces, markers
and tracked points, by their weights on nodes; a sheet's material direction 1, of which each triangle has the part in
its plane. Of the rig's mesh are, too, the sizes of cells by which contact chooses how far to look ahead, where a round
rigid core stops coarse faces, and how much area a point of a core stands for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.strain_law import StrainLaws
from sim_core.energies.term import Declaring
from sim_core.errors import ConfigError
from sim_core.geometry import solids
from sim_core.geometry.sheets import SheetMesh
from sim_core.materials.elastic import poisson_ratios
from sim_core.rigs import Gel, Rig, Sheet
from sim_core.rigs.fields import split_unit
from sim_core.rigs.parameters import nearest_names
from sim_core.scene.assembly import elements, mass_of

if TYPE_CHECKING:
    from sim_core.scene.scene import Scene

MASS = "mass"

REST_ANGLE, REST = "rest_angle_rad", "rest_m"

ROUND_OFF = 1e-12
"""Of a difference from the rig's number, relative."""

FLAT = 1e-9
"""Least area of a triangle at rest over the square of its longest side."""

MASS_POWERS = {"thickness_m": 1, "density_kg_m3": 1}
"""Power of each quantity in the mass of an element; terms declare those in their energies."""

NU, YIELD, HARDENING = "nu", "yield_curvature_per_m", "hardening_ratio"

FLOW = (YIELD, HARDENING)
"""Quantities of a sheet that yields."""

RELAXATION = {"relaxation_g": "share", "relaxation_tau_s": "tau_s"}
"""Quantities of a gel that relaxes, and the numbers of the effect that they are."""

MASS_DAMPING, STIFFNESS_DAMPING = "mass_damping_per_s", "stiffness_damping_s"

SHIFTED = (NU, MASS_DAMPING, STIFFNESS_DAMPING)
"""Quantities that are kept as differences from the rig's."""

MATERIAL = ("E_pa", NU, "thickness_m", "density_kg_m3", MASS_DAMPING, STIFFNESS_DAMPING)
"""Quantities of a sheet that differ from triangle to triangle; of a gel all but the thickness."""


class Fields:
    """All fields of a scene by name: ``<gel>.E_pa``, ``.nu``, ``.density_kg_m3``, ``.mass_damping_per_s``,
    ``.stiffness_damping_s`` and, of a gel that relaxes, ``.relaxation_g`` (the share) and ``.relaxation_tau_s``, one
    value a tetrahedron; ``<sheet>.E_pa``, ``.nu``, ``.thickness_m``, ``.density_kg_m3``, both dampings and, of a sheet
    that yields, ``.yield_curvature_per_m`` and ``.hardening_ratio``, one a triangle; ``<sheet>.rest_angle_rad``, one a
    hinge (inner edge): the angle between the normals of its triangles; ``<sheet>.rest_m`` and ``<gel>.rest_m``, one
    vector a node ``(n, 3)``: its position at rest in the world, as in ``scene.bodies[name].rest``, when mounts are at
    their start poses. Units may be left out.

    nu is above -1 and below 0.5 everywhere, dampings are not below zero and the share that relaxes is in [0, 1), also
    when a rig with another number shifts or scales them (:meth:`check`).
    The thickness is that which stretches, bends and weighs; contact finds the surface where the rig's number puts it.
    Rest angles are those of the shape at rest, but for what they were set to in addition: that difference stays when
    the shape changes. Shapes build the scene anew (:meth:`sim_core.scene.scene.Scene.reshape`).
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._shares: dict[str, np.ndarray] = {}
        self._shifts: dict[str, np.ndarray] = {}  # added to the rig's number
        self._creases: dict[str, np.ndarray] = {}  # rest angles added to those of the shape
        self.changes = 0
        """How often values were set since the scene was built; arrays that are handed out are copies."""

    @property
    def names(self) -> tuple[str, ...]:
        """All that there are."""
        found: list[str] = []
        for name, body in self._scene.bodies.items():
            if isinstance(body.spec, Gel):
                branches = self._branches(name)
                relaxes = [b for b in branches if self._numbers(f"{name}.elastic_laws")[f"{b}.share"] > 0.0]
                more = (*(RELAXATION if len(branches) == len(relaxes) == 1 else ()), REST)
                found += [f"{name}.{key}" for key in (*MATERIAL, *more) if key != "thickness_m"]
            elif isinstance(body.spec, Sheet):
                flow = FLOW if YIELD in self._numbers(f"{name}.bending") else ()
                fixed = (NU,) if body.spec.law == "neo_hookean" else ()
                found += [f"{name}.{key}" for key in (*MATERIAL, *flow, REST_ANGLE, REST) if key not in fixed]
        return tuple(found)

    def resolve(self, name: str) -> str:
        """Full name of a field."""
        spellings: dict[str, list[str]] = {}
        for full in self.names:
            stem = full.removesuffix("_rad") if full.endswith(REST_ANGLE) else split_unit(full)[0]
            if name in (full, stem):
                return full
            spellings |= {full: [full], stem: [full]}
        raise ConfigError(f"The rig {self._scene.rig.name!r} has no field {name!r}.", nearest_names(name, spellings))

    def __getitem__(self, name: str) -> np.ndarray:
        """Values in SI units, one an element, hinge or node."""
        body, key = self.resolve(name).split(".")
        if key == REST:
            return np.array(self._scene.bodies[body].rest)
        if key == REST_ANGLE:
            return np.array(self.bending(body).rest_angles)
        number = self._number(body, key)
        if key in SHIFTED:
            return np.asarray(number + self._shift_of(body, key))
        return np.asarray(number * self.share(body, self.quantity(body, key)))

    def __setitem__(self, name: str, values: np.ndarray | float) -> None:
        """Take values in SI units for all elements, hinges or nodes, or one for all elements or hinges."""
        full = self.resolve(name)
        body, key = full.split(".")
        given, shape = np.asarray(values, dtype=float), self.places(full).shape
        shape = shape if key == REST else shape[:1]
        if (given.ndim > 0 or key == REST) and given.shape != shape:
            raise ConfigError(
                f"The field {full} has {' x '.join(map(str, shape))} values, not an array of shape {given.shape}.",
                "Give one value an element, or one vector a node, in the order of Fields.places.",
            )
        if not np.isfinite(given).all():
            raise ConfigError(f"The field {full} has values that are not finite.", "Correct them.")
        if key not in (*SHIFTED, "relaxation_g", REST_ANGLE, REST) and not (given > 0.0).all():
            raise ConfigError(f"The field {full} has values that are not above zero.", "Correct them.")
        if key == REST:
            self._reshape(body, given)
        elif key == REST_ANGLE:
            if np.abs(given).max(initial=0.0) >= np.pi:
                raise ConfigError(f"The field {full} has angles of pi and more.", "Fold an edge by less than pi.")
            bending = self.bending(body)
            self._creases[body] = given - bending.built_angles
            bending.set_rest_angles(given)
        else:
            number = self._number(body, key)
            _check_values(full, np.atleast_1d(given), self._thin(body))
            if key in SHIFTED:
                self._shifts[full] = np.broadcast_to(given - number, shape).copy()
            else:
                self._shares[f"{body}.{self.quantity(body, key)}"] = np.broadcast_to(given / number, shape).copy()
            self._spread(body)
        self.changes += 1

    def check(self, rig: Rig) -> None:
        """Refuse a rig of the same geometry whose numbers would shift a field out of its bounds."""
        for full, shift in self._shifts.items():
            body, key = full.split(".")
            number = self._number(body, key, rig)
            _check_values(full, number + shift, self._thin(body), number)
        for full, share in self._shares.items():
            body, _, quantity = full.partition(".")
            if quantity in [f"{branch}.share" for branch in self._branches(body)]:
                number = self._numbers(f"{body}.elastic_laws", rig).get(quantity, 0.0)
                _check_values(f"{body}.relaxation_g", number * share, self._thin(body), number)

    def quantity(self, body: str, key: str) -> str:
        """What the terms of a body call the number of a field."""
        return f"{self._branches(body)[0]}.{RELAXATION[key]}" if key in RELAXATION else key

    def _branches(self, body: str) -> list[str]:
        """Keys of the effects by which a gel relaxes."""
        laws = (term.laws for term in self._scene.bodies[body].terms if isinstance(term, StrainLaws))
        return [key for own in laws for key, law, _ in own if law.name == "gel_relaxation"]

    def _number(self, body: str, key: str, rig: Rig | None = None) -> float:
        """What a rig (None: that of the scene) has for a quantity."""
        if key in (*FLOW, *RELAXATION):
            term = "bending" if key in FLOW else "elastic_laws"
            return self._numbers(f"{body}.{term}", rig)[self.quantity(body, key)]
        return float(getattr((rig or self._scene.rig).bodies[body].material, key))  # type: ignore[union-attr]

    def _numbers(self, term: str, rig: Rig | None = None) -> dict[str, float]:
        """What a term takes of a rig (None: that of the scene) and its effects."""
        return self._scene.values(rig or self._scene.rig).terms[term]

    def _thin(self, body: str) -> bool:
        """Whether a body is a sheet, in plane stress."""
        return isinstance(self._scene.bodies[body].spec, Sheet)

    def _changed(self) -> set[str]:
        """Bodies with fields of their elements."""
        return {full.split(".")[0] for full in (*self._shares, *self._shifts)}

    def _reshape(self, body: str, rest: np.ndarray | None) -> None:
        """Give a body another shape at rest (None: that of the rig)."""
        mesh = self._scene.bodies[body].mesh
        if rest is not None and isinstance(mesh, SheetMesh):
            there = SheetMesh(rest, mesh.triangles)
            sides = np.ptp(rest[mesh.triangles], axis=1).max(axis=1)
            thin = np.flatnonzero(there.areas <= FLAT * sides**2)
            if len(thin):
                raise ConfigError(
                    f"The field {body}.{REST} leaves triangle {thin[0]} without area, and {len(thin) - 1} more.",
                    "Keep its nodes apart.",
                )
        self._scene.reshape(body, rest)
        for name in self._changed():
            self._spread(name)
        for name, change in self._creases.items():
            bending = self.bending(name)
            bending.set_rest_angles(bending.built_angles + change)

    def reset(self) -> None:
        """Back to the rig's numbers, and to its shapes at rest."""
        self.changes += 1
        changed = self._changed()
        self._shares.clear()
        self._shifts.clear()
        for name in self._creases:
            self.bending(name).set_rest_angles(self.bending(name).built_angles)
        self._creases.clear()
        for body in changed:
            self._spread(body)
        for name, built in self._scene.bodies.items():
            if built.rest is not built.drawn:
                self._reshape(name, None)

    def places(self, name: str) -> np.ndarray:
        """Middles of the elements or hinges of a field, or its nodes, at rest in the world [m], ``(m, 3)``."""
        body, key = self.resolve(name).split(".")
        built = self._scene.bodies[body]
        if key == REST:
            return np.array(built.rest)
        corners = self.bending(body).hinges.nodes[:, :2] if key == REST_ANGLE else elements(built)[:, :4]
        return np.asarray(built.rest[corners].mean(axis=1))

    def bending(self, body: str) -> Bending:
        """The term by which a sheet bends."""
        return next(t for t in self._scene.bodies[body].terms if isinstance(t, Bending))

    def factor(self, body: str, part: str) -> np.ndarray:
        """Factor of each element on the energy of a term, by its full name, or on the mass."""
        built = self._scene.bodies[body]
        powers = dict(MASS_POWERS)
        if part != MASS:
            term = next(t for t in built.terms if t.name == part)
            powers = {q.name: q.power for q in term.quantities if q.power} if isinstance(term, Declaring) else {}
        out = np.ones(len(elements(built)))
        for key, power in powers.items():
            out *= self.share(body, key) ** power
        return out if part != MASS or built.outside is None else out * built.outside

    def mass_blocks(self, body: str) -> tuple[np.ndarray, np.ndarray]:
        """Nodes ``(m, k)`` of a body's elements among all, and masses ``(m, k, k)`` of the elements as they are, per
        unit of what the rig has for the density of the body."""
        built = self._scene.bodies[body]
        mesh, factor = built.mesh, self.factor(body, MASS)
        if isinstance(mesh, SheetMesh):
            blocks = (mesh.areas / 3.0)[:, None, None] * np.eye(3)
        else:
            assert isinstance(mesh, solids.TetMesh)
            blocks = solids.element_masses(mesh)
        return built.nodes[elements(built)], factor[:, None, None] * blocks

    def share(self, body: str, key: str) -> np.ndarray:
        """What the elements of a body ``(m,)`` have of the rig's number for a quantity that is kept as a share, as the
        terms call it."""
        share = self._shares.get(f"{body}.{key}")
        return np.ones(len(elements(self._scene.bodies[body]))) if share is None else share

    def _shift_of(self, body: str, key: str) -> np.ndarray:
        shift = self._shifts.get(f"{body}.{key}")
        return np.zeros(len(elements(self._scene.bodies[body]))) if shift is None else shift

    def _spread(self, name: str) -> None:
        """Hand a body's factors, differences and shares on to its terms and its mass."""
        body = self._scene.bodies[name]
        for term in body.terms:
            if isinstance(term, Membrane | Bending | NeoHookean):
                term.scale(self.factor(name, term.name))
                term.shift_nu(self._shift_of(name, NU))
                term.shift_damping(self._shift_of(name, STIFFNESS_DAMPING))
            if isinstance(term, Bending):
                term.scale_flow(*(self.share(name, key) for key in FLOW))
            if isinstance(term, StrainLaws):
                own = {q.name: f"{name}.{q.name}" for q in term.quantities if q.shares}
                term.scale_numbers({q: self._shares[full] for q, full in own.items() if full in self._shares})
        factor, more = self.factor(name, MASS), self._shift_of(name, MASS_DAMPING)
        body.unit_mass = mass_of(body, factor)
        self._scene.renew_mass(body, mass_of(body, factor * more) if more.any() else None)


def _check_values(full: str, values: np.ndarray, thin: bool, number: float | None = None) -> None:
    """Refuse values of a field that no material has. ``thin``: of a sheet; ``number``: that of the rig that shifts or
    scales it (None: the values are given)."""
    key = full.split(".")[1]
    if key == NU:
        poisson_ratios(f"The field {full}", 0.0, values, thin)
        return
    low, high, words = float(values.min()), float(values.max()), ""
    if key in SHIFTED and low < -ROUND_OFF * max(high, abs(number or 0.0)):
        words = f"the value {low:.6g}, below zero"
    elif key == "relaxation_g" and (low < 0.0 or high >= 1.0):
        words = f"values from {low:.6g} to {high:.6g}, not in [0, 1)"
    if words and number is None:
        raise ConfigError(f"The field {full} has {words}.", "Correct it.")
    if words:
        raise ConfigError(
            f"With {number:.6g}, the number of the rig, the field {full} has {words}.",
            "Give the rig another number, or set the field anew.",
        )
