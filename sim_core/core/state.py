"""The state of a rollout in the core's memory: its arrays, and what contacts and materials remember."""

from __future__ import annotations

import ctypes
import functools
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from sim_core.contact.edges import EdgeContact
from sim_core.contact.surface import SurfaceContact
from sim_core.core.covers import covers
from sim_core.core.layout import layout_of
from sim_core.core.library import load
from sim_core.core.materials import point_laws
from sim_core.core.mechanics import Mechanics
from sim_core.core.record import ContactTerm, contacts_of, edges_of, record_values, surfaces_of
from sim_core.core.record_layout import filled, pointer_to
from sim_core.core.slopes import NumberSlopes
from sim_core.energies.term import Internals
from sim_core.errors import ConfigError
from sim_core.permanent_state import PermanentState
from sim_core.solve.integrator import Past
from sim_core.solve.report import NewtonSettings
from sim_core.solve.state import State

STATE = ("x", "v", "x_past", "v_past", "anchor", "load", "speed", "rotation", "bonded", "d_x", "d_v", "d_rotation",
         "x_end", "gradient", "time", "pair_force")  # fmt: skip
"""Arrays of a state, in the order of ``thinshell_state``."""

NODAL, ALONG = ("x", "v", "x_past", "v_past", "x_end", "gradient"), ("d_x", "d_v")
"""Those of nodes, and those with columns."""


WIDE = 160
"""Width of the factor's rows [entries] from which on the flops of the envelope, which grow with its square, rule a step
(docs/design/compiled_core.md)."""


class CoreState:
    """The record of a scene, and a state in the core. ``numbers``: derivatives of the numbers of the mechanics by p
    parameters; ``bearing``: nodes of which derivatives of the loads are wanted."""

    def __init__(self, scene: Mechanics, settings: NewtonSettings, numbers: NumberSlopes, bearing: np.ndarray) -> None:
        self.scene, loaded = scene, load()
        self._library, lack = loaded.functions, covers(scene)
        if lack is not None:
            raise ConfigError(lack, "Use terms that the core has elements for.")
        if not loaded.supernodes and layout_of(scene).width > WIDE:
            _warn_of_width(layout_of(scene).width)
        lanes = int(self._library.thinshell_lanes())
        self._count, self._columns = numbers.count, -(-numbers.count // lanes) * lanes
        self._made_of = settings, bearing, numbers
        self._make()
        self.contacts = contacts_of(scene)
        self._materials = point_laws(scene)
        self._surfaces, self._edges = surfaces_of(scene), edges_of(scene)

    def _make(self) -> None:
        settings, bearing, numbers = self._made_of
        self._record, self._arrays = filled(record_values(self.scene, settings, bearing, numbers, self._columns))
        self._handle = self._library.thinshell_make(ctypes.byref(self._record))
        self._led: list[CoreState] = []

    def renew(self) -> None:
        """Have the numbers that the scene has now, from the present state on; derivatives begin anew."""
        kept, handle = KeptState(self), self._handle
        self._make()
        kept.put_back()
        self._library.thinshell_free(handle)

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            self._library.thinshell_free(self._handle)

    def _whole(self, name: str) -> np.ndarray:
        """One of the arrays of the state, flat; it is the core's memory, until the next step."""
        size = ctypes.c_int64()
        address = self._library.thinshell_state(self._handle, STATE.index(name), ctypes.byref(size))
        if not size.value:
            return np.zeros(0)
        return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_double)), (size.value,))

    def _array(self, name: str) -> np.ndarray:
        """The same without the deflections of mounts, which stand behind the nodes."""
        whole = self._whole(name)
        rows = self.scene.system.nodes.size * (self._columns if name in ALONG else 1)
        return whole[:rows] if name in (*NODAL, *ALONG) else whole

    @property
    def deflections(self) -> np.ndarray:
        """How far mounts have given way [m] ``(k, 3)``."""
        return self._whole("x")[self.scene.system.nodes.size :].reshape(-1, 3)

    def table(self, name: str, *shape: int, columns: bool = True) -> np.ndarray:
        """One of the arrays of the state, in a shape, with a last axis of columns or without."""
        return self._array(name).reshape(*shape, self._columns) if columns else self._array(name).reshape(shape)

    def lead(self, other: CoreState, column: int | None) -> None:
        """Lead another of the same nodes along the path of this one; a column responds to its laws, None: none does."""
        self._library.thinshell_amend(self._handle, other._handle, -1 if column is None else column)
        self._led.append(other)

    def give_way(self, mount: int, nodes: np.ndarray, compliance: np.ndarray, column: int) -> None:
        """Let a mount, which carries ``nodes``, give way in a column by its ``compliance`` [m/N] ``(3,)`` along the
        axes of the world, times the load."""
        nodes, compliance = nodes.astype(np.int32), np.array(compliance, dtype=float)
        at = (pointer_to(compliance), len(nodes), pointer_to(nodes))
        self._library.thinshell_yield(self._handle, column, mount, *at)

    def keep_forces(self) -> None:
        """Keep the forces of contacts at the ends of steps."""
        self._library.thinshell_keep_forces(self._handle)

    def pair_forces(self) -> dict[str, np.ndarray]:
        """Of each declared contact on the nodes at the end of the last step [N] ``(n, 3)``; they are to be kept."""
        terms: list[ContactTerm] = [*self.contacts, *self._surfaces, *self._edges]
        none = np.zeros(self.scene.system.nodes.shape)
        forces = self._array("pair_force").reshape(-1, *none.shape)
        found = {term.name: own for term, own in zip(terms, forces, strict=True)}
        return {pair: sum((found[t.name] for t in own), none) for pair, own in self.scene.contacts.items()}

    def _held(self, term: int, which: int, kind: Any = ctypes.c_double, copy: bool = True) -> np.ndarray:
        """What the points of a contact of surfaces or edges remember (``thinshell_held``), flat, a copy or the core's
        memory."""
        size = ctypes.c_int64()
        address = self._library.thinshell_held(self._handle, term, which, ctypes.byref(size))
        if not size.value:
            return np.zeros(0, dtype=kind)
        held = np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(kind)), (size.value,))
        return np.array(held) if copy else held

    def _remembered(self, law: int, derivatives: bool = False) -> np.ndarray:
        """What a material law remembers (``thinshell_material``) ``(n, states, 1)``, or the derivatives of that, one a
        column; it is the core's memory."""
        size = ctypes.c_int64()
        address = self._library.thinshell_material(self._handle, law, int(derivatives), ctypes.byref(size))
        own = self._materials[law]
        shape = len(own.measure.areas), own.layout.states, self._columns if derivatives else 1
        if not size.value:
            return np.zeros(shape)
        return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_double)), shape)

    def put_internals(self, internals: Mapping[str, Internals]) -> None:
        """Let material laws have these internal variables, by term; others stay."""
        for k, law in enumerate(self._materials):
            for name, value in law.internals(self._remembered(k)).items():
                if name in internals.get(law.term, {}):
                    value[:] = internals[law.term][name].reshape(value.shape)

    def _restore(self, left: PermanentState) -> None:
        """Let bodies remember what an earlier rollout has left."""
        self.put_internals(left.internals)
        for k, law in enumerate(self._materials):
            by = law.internals(self._remembered(k, derivatives=True)) if self._count else {}
            for name, value in by.items():
                if left.by_internals is not None and name in left.by_internals.get(law.term, {}):
                    value[..., : self._count] = left.by_internals[law.term][name].reshape(*value.shape[:2], self._count)

    def put(self, state: State) -> None:
        """Be in a state, as the terms have it; mounts have given way as they have now."""
        size, past = self.scene.system.nodes.size, state.past
        self._whole("x")[:size], self._whole("v")[:size] = state.x.ravel(), state.v.ravel()
        if past is not None:
            self._whole("x_past")[:size], self._whole("v_past")[:size] = past.x.ravel(), past.v.ravel()
        self._array("time")[:] = state.t
        held = [state.internals[term.name] for term in self.contacts]
        names = {"anchor": "anchor", "load": "load", "speed": "slip_speed", "rotation": "rotation"}
        for name, key in names.items():
            self._array(name)[:] = np.concatenate([np.zeros(0), *(h[key].ravel() for h in held)])
        bonded = [h.get("bonded", np.zeros_like(h["load"])) for h in held]
        self._array("bonded")[:] = np.concatenate([np.zeros(0), *bonded])
        others: list[SurfaceContact | EdgeContact] = [*self._surfaces, *self._edges]
        for k, other in enumerate(others):
            own = state.internals[other.name]
            if k >= len(self._surfaces):
                self._library.thinshell_hold_pairs(self._handle, k, len(own["pair"]))
                self._held(k, 3, ctypes.c_int64, copy=False)[:] = own["pair"]
            for which, kept in enumerate((own["anchor"], own["load"], own["slip_speed"])):
                self._held(k, which, copy=False)[:] = kept.ravel()
        for k, law in enumerate(self._materials):
            for name, value in law.internals(self._remembered(k)).items():
                value[:] = state.internals[law.term][name].reshape(value.shape)
        self._library.thinshell_resume(self._handle, 0.0 if past is None else past.dt)

    def state_now(self, t: float) -> State:
        """The state as the terms have it, at a time [s]."""
        state, shape = {name: self._array(name).copy() for name in STATE[:9]}, self.scene.system.nodes.shape
        x, v, x_past, v_past = (state[n].reshape(shape) for n in STATE[:4])
        internals, at = self.scene.system.initial_internals(), 0
        for c, term in enumerate(self.contacts):
            own = slice(at, at + len(term.areas))
            at = own.stop
            internals[term.name] = {
                "rotation": state["rotation"].reshape(-1, 3, 3)[c],
                "anchor": state["anchor"].reshape(-1, 3)[own],
                "load": state["load"][own],
                "slip_speed": state["speed"][own],
                **({"bonded": state["bonded"][own]} if term.laws.bonds else {}),
            }
        others: list[SurfaceContact | EdgeContact] = [*self._surfaces, *self._edges]
        for k, other in enumerate(others):
            anchor, load, speed = (self._held(k, which) for which in range(3))
            held = {"anchor": anchor.reshape(-1, 3), "load": load, "slip_speed": speed}
            if k >= len(self._surfaces):
                held["pair"] = self._held(k, 3, ctypes.c_int64).astype(float)
            internals[other.name] = held
        for k, law in enumerate(self._materials):
            for name, value in law.internals(self._remembered(k)).items():
                internals[law.term][name] = value.reshape(internals[law.term][name].shape).copy()
        since = float(self._library.thinshell_past(self._handle))
        return State(t, x, v, internals, Past(x_past, v_past, since) if since else None)

    def put_state(self, state: State) -> None:
        """Be in a state that :meth:`state_now` gave, with other positions, velocities and internal variables."""
        self._array("x")[:], self._array("v")[:] = state.x.ravel(), state.v.ravel()
        at = 0
        for term in self.contacts:
            own, held = slice(at, at + len(term.areas)), state.internals[term.name]
            at = own.stop
            self._array("anchor").reshape(-1, 3)[own] = held["anchor"]
            self._array("load")[own], self._array("speed")[own] = held["load"], held["slip_speed"]
        others: list[SurfaceContact | EdgeContact] = [*self._surfaces, *self._edges]
        for k, other in enumerate(others):
            held = state.internals[other.name]
            for which, name in enumerate(("anchor", "load", "slip_speed")):
                self._held(k, which, copy=False)[:] = held[name].ravel()
        self.put_internals(state.internals)


@functools.cache
def _warn_of_width(width: float) -> None:
    warnings.warn(
        f"Rows of the factor have {width:.0f} entries, and without MKL there is none by supernodes: steps of so wide a "
        "mesh are several times slower. Install the package mkl.",
        stacklevel=5,
    )


class KeptState:
    """A state of a rollout without derivatives that can be put back."""

    def __init__(self, of: CoreState) -> None:
        self._of = of
        self._kept = of._library.thinshell_keep(of._handle)

    def put_back(self) -> None:
        """Let the rollout be in this state again."""
        self._of._library.thinshell_put_back(self._of._handle, self._kept)

    def __del__(self) -> None:
        if getattr(self, "_kept", None):
            self._of._library.thinshell_drop(self._kept)
