"""The way back through a rollout on the compiled core (include/adjoint.hpp): a tape of its steps, and weights of what
they depend on."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sim_core.contact.edges import EdgeContact
from sim_core.contact.surface import SurfaceContact
from sim_core.core.curving import Curving
from sim_core.core.library import load
from sim_core.core.materials import point_laws
from sim_core.core.record import contacts_of, edges_of, record_values, surfaces_of
from sim_core.core.record_layout import filled, pointer_to
from sim_core.core.rollout import CoreRollout
from sim_core.core.slopes import NumberSlopes
from sim_core.energies.term import Internals
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.carriage import start_state
from sim_core.scene.scene import Scene
from sim_core.solve.report import NewtonSettings

WEIGHTS = ("x", "v", "rotation", "numbers", "anchor", "load", "speed")
"""Arrays of weights, in the order of ``thinshell_adjoint_weights``."""


ELEMENTS = (
    "mass", "mass_damping", "external", "stretch_stiffness", "stretch_damping", "hats", "curve_stiffness",
    "curve_damping", "operator_stiffness", "operator_damping", "operator_law", "rest_angle", "gel", "gel_gradient",
    "gel_volume", "material_row", "material_area", "sample_area", "surface_area", "edge_area", "edge_square",
    "drag_factor", "follower_local",
)  # fmt: skip
"""Arrays of weights element by element, in the order of ``thinshell_adjoint_elements``."""


class RecordedRollout(CoreRollout):
    """A rollout whose steps are noted, those of settling included. ``bound_bytes``: memory that they may take; of what
    goes beyond positions and places are kept, 24 bytes a node and step, and the way back makes the rest again."""

    def __init__(
        self,
        scene: Scene,
        poses: Mapping[str, PoseTrajectory],
        times: np.ndarray,
        settings: NewtonSettings,
        bound_bytes: int,
    ) -> None:
        super().__init__(scene, poses, times, settings)
        self.tape = self._library.thinshell_tape(self._handle, max(1, bound_bytes))

    def __del__(self) -> None:
        if getattr(self, "tape", None):
            self._library.thinshell_tape_free(self.tape)
        super().__del__()

    @property
    def bearing(self) -> np.ndarray:
        """Nodes that bear what wrench sensors read, int ``(b,)``."""
        return self._bearing

    @property
    def mounts(self) -> list[str]:
        """Mounts, in the order of ``places``."""
        return self._mounts

    @property
    def kept_bytes(self) -> int:
        """Memory of the tape [B]."""
        return int(self._library.thinshell_tape_bytes(self.tape))

    def positions(self, span: slice) -> np.ndarray:
        """Positions of the nodes and, behind them, deflections of mounts [m] at instants in a row ``(k, ., 3)``."""
        nodes = len(self.scene.rest)
        out = np.zeros((span.stop - span.start, nodes + len(self.scene.compliant), 3))
        first = span.start
        if not first and (self.given is not None or not self.scene.all_held):  # where bodies were put no step ended
            out[0, :nodes] = start_state(self.scene, self.frames(0))[0] if self.given is None else self.given.x
            first = 1
        if first < span.stop:
            to = pointer_to(out[first - span.start :])
            self._library.thinshell_tape_positions(self.tape, first, span.stop, to)
        return out


class CoreAdjoint:
    """Weights of a sum of readings of a recorded rollout: derivatives of the sum by what the rollout depends on.
    ``numbers``: along what the numbers of the mechanics are differentiated; ``curving``: and by those of each element
    (:meth:`elements`), of what bends; ``shapes``: by what is measured at rest, too."""

    def __init__(
        self,
        rollout: RecordedRollout,
        numbers: NumberSlopes,
        curving: Curving | None = None,
        shapes: bool = False,
    ) -> None:
        scene = rollout.scene
        self._rollout, self._library, self._count = rollout, load().functions, numbers.count
        lanes = int(self._library.thinshell_lanes())
        columns = -(-numbers.count // lanes) * lanes
        self.record = record_values(scene, NewtonSettings(), rollout.bearing, numbers, columns)
        """Fields of the record (include/record.hpp)."""
        self._record, self._kept = filled(dict(self.record))
        self._handle = self._library.thinshell_adjoint(ctypes.byref(self._record))
        if curving is not None:
            struct, self._curving = curving.struct()
            self._library.thinshell_adjoint_want(self._handle, ctypes.byref(struct), int(shapes))
        self._contacts, self._materials = contacts_of(scene), point_laws(scene)
        self._others: list[SurfaceContact | EdgeContact] = [*surfaces_of(scene), *edges_of(scene)]

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            self._library.thinshell_adjoint_free(self._handle)

    def begin(self) -> None:
        """Stand at the end of the rollout, all weights zero."""
        self._library.thinshell_adjoint_begin(self._handle, self._rollout.tape)

    def sweep(self, first: int, x: np.ndarray, force: np.ndarray, moment: np.ndarray, frames: np.ndarray) -> None:
        """Go back through the steps to instants from ``first`` on, with weights of positions and deflections ``(k, .,
        3)``, loads ``(k, b, 3)`` and moments ``(k, contacts, 3)`` at these. ``frames``: of motions of the mounts in
        their own frames at all instants ``(t, mounts, 6)``, added to."""
        at = (pointer_to(a) for a in (x, force, moment, frames))
        self._library.thinshell_adjoint_sweep(self._handle, self._rollout.tape, first, *at)

    def stand(
        self,
        state: Sequence[np.ndarray],
        inertia: bool,
        readings: tuple[np.ndarray, np.ndarray, np.ndarray],
        frames: np.ndarray,
    ) -> None:
        """Go back from the readings of a start at which nothing settled, where nodes are put with their velocities and
        rigid bodies turned, ``state``."""
        dt, places = self._rollout.scene.rig.solver.dt_s, self._rollout.places[0]
        given = [self._whole(state[0]), self._whole(state[1]), np.ascontiguousarray(state[2], dtype=float)]
        at, read = (pointer_to(a) for a in given), (pointer_to(a) for a in readings)
        self._library.thinshell_adjoint_stand(
            self._handle, *at, dt, pointer_to(places), int(inertia), *read, pointer_to(frames)
        )

    def _whole(self, nodal: np.ndarray) -> np.ndarray:
        """Vectors of the nodes ``(n, 3)`` with rows of deflections, which are zero."""
        return np.pad(np.asarray(nodal, dtype=float), ((0, len(self._rollout.scene.compliant)), (0, 0)))

    def nodal(self, name: str) -> np.ndarray:
        """Weights of ``x`` or ``v`` of the nodes ``(n, 3)``."""
        return np.array(self.weights(name).reshape(-1, 3)[: len(self._rollout.scene.rest)])

    def weights(self, name: str) -> np.ndarray:
        """One of :data:`WEIGHTS`, flat; it is the core's memory."""
        return self._array("weights", WEIGHTS.index(name))

    def elements(self, name: str) -> np.ndarray:
        """One of :data:`ELEMENTS`: weights of the record's array of that name (include/contact_pull.hpp), flat."""
        return np.array(self._array("elements", ELEMENTS.index(name)))

    @property
    def numbers(self) -> np.ndarray:
        """Derivatives by the parameters ``(p,)`` through the numbers of the mechanics."""
        return np.array(self.weights("numbers")[: self._count])

    def internals(self, like: Mapping[str, Internals]) -> dict[str, Internals]:
        """Weights of the internal variables by term and name, in the shapes of those of a state ``like``."""
        views, found = self._views(), {}
        for term, own in like.items():
            found[term] = {name: np.zeros(value.shape) for name, value in own.items()}
            for name, view in views.get(term, {}).items():
                if view.size:
                    found[term][name][:] = view.reshape(own[name].shape)
        return found

    def give(self, internals: Mapping[str, Internals]) -> None:
        """Let the internal variables at the end of the rollout have weights, by term and name; those of edges have
        none."""
        for term, own in self._views().items():
            for name, view in own.items():
                if view.size and name in internals.get(term, {}):
                    view[:] = internals[term][name].reshape(view.shape)

    def _views(self) -> dict[str, Internals]:
        """The core's memory of the weights of internal variables."""
        found: dict[str, Internals] = {}
        held = {name: self.weights(name) for name in ("anchor", "load", "speed")}
        at = 0
        for c, term in enumerate(self._contacts):
            own = slice(at, at + len(term.areas))
            at = own.stop
            found[term.name] = {
                "rotation": self.weights("rotation")[9 * c : 9 * c + 9],
                "anchor": held["anchor"][3 * own.start : 3 * own.stop],
                "load": held["load"][own],
                "slip_speed": held["speed"][own],
            }
        for k, other in enumerate(self._others):
            anchor, load_of, speed = (self._array("held", k, which) for which in range(3))
            found[other.name] = {"anchor": anchor, "load": load_of, "slip_speed": speed}
        for k, law in enumerate(self._materials):
            rows = self._array("material", k).reshape(len(law.measure.areas), law.layout.states, 1)
            found.setdefault(law.term, {}).update(law.internals(rows))
        return found

    def _array(self, function: str, *which: int, kind: Any = ctypes.c_double) -> np.ndarray:
        size = ctypes.c_int64()
        address = getattr(self._library, f"thinshell_adjoint_{function}")(self._handle, *which, ctypes.byref(size))
        if not size.value:
            return np.zeros(0)
        return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(kind)), (size.value,))
