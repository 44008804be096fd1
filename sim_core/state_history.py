"""What a rollout did, step by step: node positions, frames of the mounts, forces of contacts and slip."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.contact.rigid import RigidContact
from sim_core.contact.surface import SurfaceContact
from sim_core.scene.scene import Frame, Scene
from sim_core.scene.touching import bearing_surfaces
from sim_core.solve.step import State


@dataclass(frozen=True)
class StateHistory:
    """States at the instants of a trace, n of them, of N nodes in the order of :class:`sim_core.scene.Scene`.

    ``positions`` [m] ``(n, N, 3)``. ``origins`` [m] ``(n, 3)`` and ``quaternions`` x y z w ``(n, 4)`` of each mount,
    with what a compliant one has given way. ``pair_forces`` [N] ``(n, N, 3)``: by the name of each declared contact,
    the force that it exerts on the nodes, friction included. ``pressures`` [Pa] ``(n, N)``: contact pressure at nodes
    that are tested for contact and bear (of a sheet on a gel the gel's alone); ``slip_speeds`` [m/s] ``(n, N)``: at
    which they slide on what they touch, 0 where they stick or touch nothing.
    """

    positions: np.ndarray
    origins: dict[str, np.ndarray]
    quaternions: dict[str, np.ndarray]
    pair_forces: dict[str, np.ndarray]
    pressures: np.ndarray
    slip_speeds: np.ndarray

    def contact_forces_at(self, step: int) -> np.ndarray:
        """Force of all contacts together on each node at one instant [N], ``(N, 3)``."""
        forces = (f[step] for f in self.pair_forces.values())
        return np.asarray(sum(forces, np.zeros_like(self.positions[step])))

    def at(self, steps: np.ndarray) -> StateHistory:
        """The states at some of the instants, by index."""

        def of(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
            return {name: v[steps] for name, v in values.items()}

        return StateHistory(
            self.positions[steps],
            of(self.origins),
            of(self.quaternions),
            of(self.pair_forces),
            self.pressures[steps],
            self.slip_speeds[steps],
        )


class StateRecorder:
    """Collects the states of a rollout of a scene, one a call of :meth:`take`."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._positions: list[np.ndarray] = []
        self._frames: list[dict[str, tuple[np.ndarray, np.ndarray]]] = []
        self._forces: list[dict[str, np.ndarray]] = []
        self._surface: list[tuple[np.ndarray, np.ndarray]] = []

    def take(self, state: State, frames: Mapping[str, Frame], forces: dict[str, np.ndarray]) -> None:
        """Keep a state; ``frames``: of the mounts, with what compliant ones have given way; ``forces``: of each
        declared contact on the nodes [N] ``(N, 3)``."""
        self._positions.append(np.array(state.x))
        self._frames.append({m: (np.array(o), np.asarray(r.as_quat())) for m, (o, r) in frames.items()})
        self._forces.append(forces)
        self._surface.append(_pressures_and_slip(self._scene, state))

    def history(self) -> StateHistory:
        """All states taken so far."""
        mounts, pairs = self._frames[0], self._forces[0]
        return StateHistory(
            np.stack(self._positions),
            {m: np.stack([f[m][0] for f in self._frames]) for m in mounts},
            {m: np.stack([f[m][1] for f in self._frames]) for m in mounts},
            {p: np.stack([f[p] for f in self._forces]) for p in pairs},
            np.stack([p for p, _ in self._surface]),
            np.stack([s for _, s in self._surface]),
        )


def _pressures_and_slip(scene: Scene, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Contact pressure [Pa] and slip speed [m/s] of every node that is a contact sample of its own, ``(N,)`` each: the
    pressures of its contacts added, the largest of their slip speeds."""
    pressure, slip = np.zeros((2, len(state.x)))
    for contact in scene.rig.contacts:
        terms = scene.contacts[contact.name]
        shared = bearing_surfaces(contact, terms)
        for term in terms:
            if not isinstance(term, RigidContact | SurfaceContact):
                continue
            samples, memory = term.samples, state.internals[term.name]
            alone = np.count_nonzero(samples.weights, axis=1) == 1
            nodes = samples.nodes[np.arange(len(alone)), np.argmax(samples.weights, axis=1)][alone]
            np.maximum.at(slip, nodes, memory["slip_speed"][alone])
            if isinstance(term, RigidContact) or term.bearing == 1.0:
                np.add.at(pressure, nodes, shared * memory["load"][alone] / samples.areas[alone])
    return pressure, slip
