"""The scene: one rig, meshed and assembled, with what follows which mount and what is measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product

import numpy as np
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from sim_core.effects.base import Instance
from sim_core.effects.hooks import BodyForce, FieldMap, FrictionLaw, MaterialLaw, MechanicsMap, NormalLaw, Part
from sim_core.effects.registry import active, active_effects, amended
from sim_core.energies.affine import AffineShape, coordinates
from sim_core.energies.bending import Bending
from sim_core.energies.grading import Grading
from sim_core.energies.mass_damping import MassDamping
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.rubber_film import RUBBER, check_numbers
from sim_core.energies.strain_law import StrainLaws
from sim_core.energies.term import Term
from sim_core.errors import ConfigError
from sim_core.rigs import WORLD, Affine, Gel, Rig, Rigid, Sheet
from sim_core.scene.assembly import (
    BuiltBody,
    add_terms,
    affine_moments,
    build_body,
    element_middles,
    held_nodes,
    leave_to_mount,
    strain_laws,
)
from sim_core.scene.contact_constants import constants_of, finest_edge
from sim_core.scene.fields import Fields
from sim_core.scene.joints import Link, embedding, guides, joint_label, make_link
from sim_core.scene.loads import load_numbers, load_terms, term_name
from sim_core.scene.touching import (
    ContactTerm,
    bearing_surfaces,
    contact_of_surfaces,
    contact_with_rigid,
    half_thicknesses,
    without_gap,
)
from sim_core.solve.system import System
from sim_core.solve.unknowns import Compliant

PARTS: dict[str, type[Membrane | Bending | NeoHookean]] = {
    "membrane": Membrane,
    "bending": Bending,
    "solid": NeoHookean,
}
"""Terms of a sheet or a gel by the part of it that a material law amends, or a field map scales."""

Frame = tuple[np.ndarray, Rotation]
"""Origin [m] ``(3,)`` and rotation of a frame in the world."""


@dataclass
class Values:
    """Everything numeric that the mechanics depend on, without geometry.

    ``terms``: parameters of each term by its name. ``density``: mass per unit of a body's
    ``unit_mass``. ``gravity``: acceleration [m/s^2] ``(3,)``. ``compliance``: of each compliant end effector along the
    world axes [m/N] ``(3,)``.
    """

    terms: dict[str, dict[str, float]]
    density: dict[str, float]
    gravity: np.ndarray
    compliance: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Follower:
    """Nodes that follow a mount rigidly. ``local``: in the mount's frame [m], ``(k, 3)``; ``axes``: components that are
    held, 1 or 0 ``(3,)``; others a mount may hold that is named later."""

    mount: str
    nodes: np.ndarray
    local: np.ndarray
    axes: np.ndarray


class Scene:
    """A rig ready to be stepped. Build with :func:`build_scene`."""

    def __init__(self, rig: Rig, refine: int) -> None:
        self.given = rig
        """The rig as it was given."""
        rig = amended(rig)
        self.rig, self._refine = rig, refine
        """The rig with the amendments of its numbers that its effects make."""
        self.start: dict[str, Frame] = {WORLD: (np.zeros(3), Rotation.identity())}
        for name, effector in rig.end_effectors.items():
            self.start[name] = (effector.start.position(), effector.start.rotation())
        self.strained: set[str] = set()
        """Sheets of which it was reported that they are strained beyond the range of their law."""
        self._build({})
        self.fields = Fields(self)
        """Material values, rest angles and shapes at rest that differ from node to node, element to element."""

    def _build(self, shapes: Mapping[str, np.ndarray]) -> None:
        """Mesh and assemble. ``shapes``: where nodes of sheets and gels are at rest, in the frames of these bodies [m],
        if not where the rig has them."""
        rig = self.rig
        self._shapes = dict(shapes)
        self.bodies: dict[str, BuiltBody] = {}
        count = 0
        for name, spec in rig.bodies.items():
            carrier = self.start[self._carrier(spec)]
            body = build_body(rig, name, carrier, count, self._refine, shapes.get(name))
            self.bodies[name] = body
            count += len(body.nodes)
        self._affine = [b for b in self.bodies.values() if isinstance(b.spec, Affine)]
        self._join()
        self.followers: list[Follower] = []
        self.holders: dict[str, np.ndarray] = {}
        self._prescribed = np.zeros((len(self.rest), 3), dtype=bool)
        self._hold()
        self.contacts: dict[str, list[ContactTerm]] = {}
        terms = self._terms()
        self._by_effects: dict[str, list[str]] = {}  # names of the terms that effects add, by the effects' keys
        terms += self._effect_terms()
        values = self.values(rig)
        self.compliant = list(values.compliance)
        """End effectors that give way, in the order of the system's groups."""
        mass = self._mass(self._densities(values))
        self.system = System(
            self.rest,
            mass,
            self._prescribed,
            terms,
            values.gravity,
            rig.solver.inertia,
            [Compliant(self.carried(e), c) for e, c in values.compliance.items()],
            rig.solver.integrator == "bdf2",
            embedding(self._affine, self.links, self.rest, {n: m for m, nodes in self._stands.values() for n in nodes}),
        )
        self._masses: dict[tuple[float, ...], sp.csr_matrix] = {}
        self._applied_mass: tuple[float, ...] | None = None
        self.apply(values)

    def reshape(self, body: str, rest: np.ndarray | None) -> None:
        """Let the nodes of a sheet or a gel be at ``rest`` [m] ``(n, 3)`` at the start, in the world, when nothing
        strains them (None: where the rig has them). All is built anew, the system too; simulations and tapes that were
        made before are of no use any more."""
        shapes = {name: shape for name, shape in self._shapes.items() if name != body}
        if rest is not None and not np.array_equal(rest, self.bodies[body].drawn):
            origin, rotation = self.bodies[body].spec.pose.within(self.start[self.mount_of(body)])
            shapes[body] = np.ascontiguousarray(rotation.inv().apply(rest - origin))
        kept, loads = dict(self.__dict__), self.system.loads
        try:
            self._build(shapes)
        except BaseException:
            self.__dict__.update(kept)
            raise
        self.system.loads[:] = loads

    @staticmethod
    def _carrier(spec: Sheet | Gel | Rigid | Affine) -> str:
        if isinstance(spec, Sheet | Affine):
            return WORLD
        return spec.mount or WORLD

    def _join(self) -> None:
        """Make the joints, with nodes of their own where they connect to a mount."""
        self.links: list[Link] = []
        self._stands: dict[str, tuple[str, list[int]]] = {}
        places = [b.rest for b in self.bodies.values()]
        count = sum(len(p) for p in places)
        for index, joint in enumerate(self.rig.joints):
            label, body = joint_label(index, joint), self.bodies[joint.body]
            if joint.to in self.bodies:
                to = self.bodies[joint.to].control
            else:
                to = np.arange(count, count + 4)
                places.append(body.rest[-4:])
                self._stands[label] = joint.to, list(to)
                count += 4
            self.links.append(make_link(label, joint, body, to))
        self.rest = np.vstack(places)
        drawn = [b.drawn for b in self.bodies.values()]
        self._drawn = np.vstack([*drawn, self.rest[sum(len(p) for p in drawn) :]])

    def _hold(self) -> None:
        """Find which nodes follow which mount."""
        self._held: dict[str, np.ndarray] = {}
        for body in self.bodies.values():
            if isinstance(body.spec, Rigid):
                self._follow(body.name, body.spec.mount, body.nodes)
                continue
            held = np.zeros(len(body.nodes), dtype=bool)
            for label, holder in held_nodes(self.rig, body).items():
                if all(holder.axes):
                    held |= holder.inside
                    if isinstance(body.spec, Sheet | Gel):
                        leave_to_mount(body, holder.inside)
                self._follow(label, holder.mount, body.nodes[holder.inside], holder.axes)
            self._held[body.name] = held
        for label, (mount, nodes) in self._stands.items():
            self._follow(label, mount, np.array(nodes))

    def _follow(
        self, label: str, mount: str, nodes: np.ndarray, axes: tuple[bool, bool, bool] = (True, True, True)
    ) -> None:
        origin, rotation = self.start[mount]
        local = rotation.inv().apply(self.rest[nodes] - origin)
        self.followers.append(Follower(mount, nodes, local, np.array(axes, dtype=float)))
        self.holders[label] = nodes
        self._prescribed[nodes] |= np.array(axes)

    @property
    def all_held(self) -> bool:
        """Whether every body is held, so that it has an equilibrium of its own."""
        return all(self._is_held(b) for b in self.bodies.values())

    def _is_held(self, body: BuiltBody) -> bool:
        """Whether a body is driven, or a node of it is held, or no motion as a whole is left to it."""
        if body.mesh is None or self._held[body.name].any():
            return True
        held = self._prescribed[body.nodes]
        if not held.any():
            return False
        arms = body.rest - body.rest.mean(axis=0)
        turns = np.stack([np.cross(axis, arms) / np.ptp(body.rest, axis=0).max() for axis in np.eye(3)], axis=-1)
        motions = np.concatenate([np.broadcast_to(np.eye(3), (len(arms), 3, 3)), turns], axis=-1)
        return int(np.linalg.matrix_rank(motions[held], tol=1e-6)) == 6

    def _terms(self) -> list[Term]:
        terms: list[Term] = []
        self._edges = {b.name: finest_edge(b) for b in self.bodies.values() if isinstance(b.spec, Gel)}
        self._beyond: dict[str, float] = {}  # distance at which a contact has no gap, beyond half the thicknesses
        for body in self.bodies.values():
            if body.mesh is not None and not isinstance(body.spec, Affine):
                add_terms(body, self.rest, self._held[body.name], ~self._prescribed[body.nodes].all(axis=1))
                terms += body.terms
        if self._affine:
            volumes = {b.name: affine_moments(b.spec)[0] for b in self._affine if isinstance(b.spec, Affine)}
            control = np.array([b.control for b in self._affine])
            terms.append(AffineShape("affine.shape", control, self.rest, np.array(list(volumes.values()))))
            terms += guides(self.links, self.rest, {name: v ** (1.0 / 3.0) for name, v in volumes.items()})
        for contact in self.rig.contacts:
            first, second = (self.bodies[b] for b in contact.between)
            self.contacts[contact.name] = built = self._contact(contact.name, first, second)
            self._beyond.update({t.name: t.offset - half_thicknesses(self.rig, contact) for t in built})
            terms += built
        return [*terms, *load_terms(self.rig, self.bodies)]

    def _contact(self, name: str, a: BuiltBody, b: BuiltBody) -> list[ContactTerm]:
        if isinstance(a.spec, Rigid) and isinstance(b.spec, Rigid):
            raise ConfigError(
                f"The contact {name} is between two rigid bodies, which are moved, not simulated.",
                "Remove it.",
            )
        if isinstance(a.spec, Rigid):
            a, b = b, a
        if isinstance(b.spec, Rigid):
            return contact_with_rigid(f"contact.{name}", a, b, self.rest, self._drawn)
        return contact_of_surfaces(f"contact.{name}", a, b, self.rest, self._drawn)

    def _effect_terms(self) -> list[Term]:
        """Terms that effects add; and hand the laws that they add to contacts over to these."""
        found: list[Term] = []
        self._laws: dict[str, dict[str, tuple[str, StrainLaws]]] = {}  # by body and part: the term that is amended
        for instance in active(self.rig, BodyForce):
            terms = instance.effect.terms(self, instance.key, instance.targets, instance.values)
            self._by_effects[instance.key] = [term.name for term in terms]
            found += terms
        for instance in active(self.rig, FieldMap):
            for graded in self._graded(instance):
                grading = graded.grading or Grading(element_middles(self.bodies[graded.name.rpartition(".")[0]]))
                grading.add(instance.key, instance.effect)
                graded.grade(grading)
        for name in RUBBER.targets(self.rig):
            self._host(name, "membrane").add(RUBBER.name, RUBBER)
        for instance in active(self.rig, MaterialLaw):
            for name, part in product(instance.targets, instance.effect.parts):
                self._host(name, part).add(instance.key, instance.effect)
        found += [laws for by_part in self._laws.values() for _, laws in by_part.values()]
        for instance in (*active(self.rig, NormalLaw), *active(self.rig, FrictionLaw)):
            for term in self._touched(instance):
                term.laws.add(instance.key, instance.effect)
        return found

    def _host(self, name: str, part: Part) -> StrainLaws:
        """The term of the material laws of a part of a body, made where there is none yet."""
        body, hosts = self.bodies[name], self._laws.setdefault(name, {})
        if part not in hosts:
            own = next(t for t in body.terms if isinstance(t, PARTS[part]))
            hosts[part] = own.name, strain_laws(own)
            body.terms.append(hosts[part][1])
        return hosts[part][1]

    def _graded(self, instance: Instance) -> list[Membrane | Bending | NeoHookean]:
        """Terms whose elements an effect scales."""
        kinds = tuple(PARTS[part] for part in instance.effect.parts)
        return [term for name in instance.targets for term in self.bodies[name].terms if isinstance(term, kinds)]

    def _touched(self, instance: Instance) -> list[ContactTerm]:
        """Terms of the contacts that an effect acts on."""
        return [term for contact in instance.targets for term in self.contacts[contact]]

    def _densities(self, values: Values) -> tuple[float, ...]:
        return tuple(values.density.get(name, 0.0) for name in self.bodies)

    def _mass(self, densities: tuple[float, ...]) -> sp.csr_matrix:
        blocks = [
            b.unit_mass * density if b.unit_mass is not None else sp.csr_matrix((len(b.nodes),) * 2)
            for b, density in zip(self.bodies.values(), densities, strict=True)
        ]
        blocks += [sp.csr_matrix((4, 4)) for _ in self._stands]
        return sp.block_diag(blocks).tocsr()

    def values(self, rig: Rig) -> Values:
        """Numbers of a rig (of the same geometry) as the terms take them, effects included."""
        rig = amended(rig)
        values = Values({}, {}, np.asarray(rig.gravity_m_s2, dtype=float))
        for name, spec in rig.bodies.items():
            if isinstance(spec, Sheet):
                m = spec.material
                sheet = {"E_pa": m.E_pa, "nu": m.nu, "thickness_m": m.thickness_m}
                sheet["stiffness_damping_s"] = m.stiffness_damping_s
                values.terms[f"{name}.membrane"] = dict(sheet)
                values.terms[f"{name}.bending"] = dict(sheet)
                values.density[name] = m.density_kg_m3 * m.thickness_m
            elif isinstance(spec, Gel):
                gel = spec.material
                elastic = {"E_pa": gel.E_pa, "nu": gel.nu, "stiffness_damping_s": gel.stiffness_damping_s}
                values.terms[f"{name}.elastic"] = elastic
                values.density[name] = gel.density_kg_m3
            elif isinstance(spec, Affine):
                values.density[name] = spec.material.density_kg_m3
            if isinstance(spec, Sheet | Gel):
                damping = {"mass_damping_per_s": spec.material.mass_damping_per_s, "density": values.density[name]}
                values.terms[f"{name}.mass_damping"] = damping
        for load in rig.loads:
            values.terms[term_name(load)] = load_numbers(load, values.gravity)
        for contact in rig.contacts:
            terms = self.contacts[contact.name]
            law = constants_of(rig, contact, self._edges)
            for term in terms:
                offset = self._beyond[term.name] + half_thicknesses(rig, contact) + contact.standoff_m
                values.terms[term.name] = {
                    "friction": contact.friction,
                    "stiffness_pa_per_m": law.stiffness_pa_per_m / bearing_surfaces(contact, terms),
                    "range_m": law.range_m,
                    "offset_m": without_gap(term, offset, law),
                }
        for instance in active_effects(rig):
            effect, given = instance.effect, instance.values
            if isinstance(effect, MechanicsMap):
                effect.amend_values(rig, instance.targets, values, given)
            if isinstance(effect, BodyForce):
                for name in self._by_effects.get(instance.key, ()):
                    values.terms[name] = dict(effect.numbers(given))
            if isinstance(effect, FieldMap):
                for graded in self._graded(instance):
                    values.terms[graded.name].update({f"{instance.key}.{key}": v for key, v in given.items()})
            if isinstance(effect, NormalLaw | FrictionLaw):
                for term in self._touched(instance):
                    values.terms[term.name].update({f"{instance.key}.{key}": v for key, v in given.items()})
        for name in RUBBER.targets(rig):
            check_numbers(f"{name}.membrane", values.terms[f"{name}.membrane"])
        by_key = {instance.key: instance.values for instance in active_effects(rig)}
        for by_part in self._laws.values():
            for own, laws in by_part.values():
                values.terms[laws.name] = laws.numbers(values.terms[own], by_key)
        return values

    def apply(self, values: Values) -> None:
        """Configure all terms, masses, gravity and compliances."""
        for term in self.system.terms:
            if term.name in values.terms:
                term.configure(values.terms[term.name])
        self._apply_mass(self._densities(values))
        self.system.gravity = values.gravity
        self.system.on_core = None  # it has the numbers of before
        self.system.set_compliance(list(values.compliance.values()))

    def _apply_mass(self, masses: tuple[float, ...]) -> None:
        if masses != self._applied_mass:
            if masses not in self._masses:
                if len(self._masses) > 8:
                    self._masses.clear()
                self._masses[masses] = self._mass(masses)
            self.system.set_mass(self._masses[masses])
            self._applied_mass = masses

    def renew_mass(self, body: BuiltBody, more_damping: sp.csr_matrix | None = None) -> None:
        """Take over a ``unit_mass`` that was changed, and what damps in addition
        (:meth:`sim_core.energies.mass_damping.MassDamping.set_unit_mass`)."""
        for term in body.terms:
            if isinstance(term, MassDamping) and body.unit_mass is not None:
                term.set_unit_mass(body.unit_mass, more_damping)
        applied, self._applied_mass = self._applied_mass, None
        self._masses.clear()
        if applied is not None:
            self._apply_mass(applied)

    def use(self, rig: Rig) -> None:
        """Take the numbers of a rig of the same geometry."""
        given, rig = rig, amended(rig)
        self.fields.check(rig)
        self.given, self.rig = given, rig
        self.apply(self.values(rig))

    def carried(self, mount: str) -> np.ndarray:
        """All nodes that follow a mount."""
        nodes = [f.nodes for f in self.followers if f.mount == mount]
        return np.unique(np.concatenate(nodes)) if nodes else np.empty(0, dtype=int)

    def targets(self, frames: Mapping[str, Frame]) -> np.ndarray:
        """Positions [m] ``(n, 3)`` that prescribed nodes take when the mounts are at ``frames``.

        Also turns the rigid bodies, so call it just before the step.
        """
        out: np.ndarray = self.rest.copy()
        places: list[np.ndarray] = []
        for follower in self.followers:
            if frames[follower.mount] is self.start[follower.mount]:
                places.append(self.rest[follower.nodes])  # it rests
                continue
            origin, rotation = frames[follower.mount]
            places.append(origin + rotation.apply(follower.local))
            out[follower.nodes] = places[-1]
        if any(not follower.axes.all() for follower in self.followers):
            for follower, there in zip(self.followers, places, strict=True):  # components may follow different mounts
                axes = follower.axes > 0.0
                out[np.ix_(follower.nodes, axes)] = there[:, axes]
        for body in self.bodies.values():
            if isinstance(body.spec, Rigid):
                _, rotation = body.spec.pose.within(frames[body.spec.mount])
                body.rotation[:] = rotation.as_matrix()
        return out

    def body_frame(self, name: str, frames: Mapping[str, Frame]) -> Frame:
        """Where the rest frame of a body is when the mounts are at ``frames``."""
        spec = self.bodies[name].spec
        return spec.pose.within(frames[self.mount_of(name)])

    def placed_on(self, node: int) -> tuple[str, np.ndarray]:
        """Mount of the rigid body that stands at a node, and its rotation in the mount's frame ``(3, 3)``."""
        spec = next(b.spec for b in self.bodies.values() if isinstance(b.spec, Rigid) and b.nodes[0] == node)
        return spec.mount, spec.pose.rotation().as_matrix()

    def mount_of(self, body: str) -> str:
        """Name of the mount in whose frame the pose of a body is given."""
        return self._carrier(self.bodies[body].spec)

    def pose_of(self, name: str, x: np.ndarray) -> Frame:
        """Where an affine body is: its centre [m] and its rotation (of the polar decomposition), by the positions of
        all nodes [m] ``(n, 3)``."""
        body = self.bodies[name]
        if not isinstance(body.spec, Affine):
            raise ConfigError(f"{name} is no affine body and has no pose.", "Follow points of it instead.")
        points = coordinates(body.local[-4:], np.vstack([np.zeros(3), np.eye(3)])) @ x[body.control]
        u, _, v = np.linalg.svd((points[1:] - points[0]).T)
        return points[0], Rotation.from_matrix(u @ v)

    def held(self, body: str) -> np.ndarray:
        """Nodes of a simulated body that follow a mount in all components, bool over its nodes."""
        return self._held[body]


def build_scene(rig: Rig, refine: int = 1) -> Scene:
    """Mesh and assemble a rig; ``refine`` multiplies the number of cells in each direction."""
    return Scene(rig, refine)
