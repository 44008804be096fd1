"""Force and torque of each declared contact, from the forces that it exerts on nodes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.rigs import Rigid
from sim_core.scene.scene import Scene


def contact_wrenches(
    scene: Scene, positions: np.ndarray, pair_forces: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Force [N] and torque [N m] ``(..., 6)``, friction included, that each declared contact exerts on the first body
    that its name names, in the world and about its origin; the second bears the opposite.

    ``positions`` [m] ``(..., N, 3)`` of all nodes and ``pair_forces`` [N] ``(..., N, 3)`` by contact: as
    :meth:`sim_core.simulate.Simulation.contact_forces` or :class:`sim_core.state_history.StateHistory` give them. A
    contact of a body with itself has no resultant and is left out.
    """
    found = {}
    for contact in scene.rig.contacts:
        first, second = contact.between
        if first == second:
            continue
        # The forces of a contact with a rigid body are where they act on the nodes of the other one.
        other = isinstance(scene.bodies[first].spec, Rigid)
        nodes = scene.bodies[second if other else first].nodes
        forces, arms = pair_forces[contact.name][..., nodes, :], positions[..., nodes, :]
        wrench = np.concatenate([forces.sum(axis=-2), np.cross(arms, forces).sum(axis=-2)], axis=-1)
        found[contact.name] = -wrench if other else wrench
    return found


def contact_topic(name: str) -> str:
    """Topic of the wrench of a contact, by its name."""
    return "contacts/" + name.replace("-", "/")
