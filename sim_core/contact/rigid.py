"""Contact and friction between sampled deformable surfaces and rigid shapes.

The rigid body is a node (its origin) plus a rotation that is prescribed during a step. With the
sample position p = sum_i w_i x_i, body origin c, rotation R and the shape's signed distance phi,

    g = phi(R^T (p - c)) - offset,
    E = sum_s A_s [ psi(g_s) ] + D(u_s),   u = R e_n + T (p - c - R y_n),   y_n = R_n^T (p_n - c_n)

where y_n is the body point under the sample at the start of the step, T the projector on the tangent
plane there and e_n the elastic slip carried over from the last step, in the body frame. Laws:
:mod:`sim_core.contact.pressure_and_friction`. What lies between the samples (a box's corner under the middle of a
triangle) is left to :class:`SurfaceContact` and :class:`EdgeContact` with the shape's core
(:mod:`sim_core.contact.inner_primitives`).
"""

from collections.abc import Mapping

import numpy as np

from sim_core.contact.added_laws import AddedLaws
from sim_core.contact.measures import Measures
from sim_core.contact.pressure_and_friction import LAW_OF, OFFSET, RANGE, REACH, coefficients, set_law
from sim_core.contact.samples import Samples
from sim_core.energies.term import Internals, counted


class RigidContact:
    """Term for one pair (deformable surface, rigid shape).

    ``samples``: of the surface. ``body_node``: node index of the body's origin. ``shape``: array of
    :mod:`sim_core.contact.shapes`. ``rotation``: ``(3, 3)`` body to world at the end of the step, written by the
    driver of the body and shared with it.
    """

    def __init__(self, name: str, samples: Samples, body_node: int, shape: np.ndarray, rotation: np.ndarray) -> None:
        self.name = name
        self.body_node = body_node
        self.measures: list[Measures] = [] if samples.shared is None else [samples.shared]
        """What is measured at rest: areas of the samples."""
        self.samples = samples
        self.areas = np.ascontiguousarray(samples.areas)
        """Areas of the samples [m^2] ``(n,)``."""
        self.shape = np.ascontiguousarray(shape, dtype=float)
        """Shape of the body (:mod:`sim_core.contact.shapes`) ``(5,)``."""
        self.law = coefficients(samples.offset)
        """Numbers of the law, as :mod:`sim_core.contact.pressure_and_friction` lays them out ``(8,)``."""
        self.laws = AddedLaws()
        self._target = rotation

    @property
    def rotation_target(self) -> np.ndarray:
        """Rotation of the body at the end of the step, as its driver wrote it ``(3, 3)``."""
        return np.array(self._target)

    def law_by(self, quantity: str) -> dict[int, float]:
        """Derivatives of the numbers of :attr:`law` by one that it is given by name, by their places."""
        return {LAW_OF[quantity]: 1.0}

    @property
    def offset(self) -> float:
        """Distance [m] at which there is no gap."""
        return float(self.law[OFFSET])

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        """Take the numbers of the law, and of those that effects add."""
        set_law(self.law, parameters)
        self.laws.configure(parameters)
        self.law[REACH] = max(self.law[RANGE], self.laws.reach())

    def carried(self, internals: Internals, move: np.ndarray) -> Internals:
        """Internal variables with the springs of friction stretched by a move of all nodes [m] ``(n, 3)``."""
        past = (self.samples.positions(move) - move[self.body_node]) @ internals["rotation"]
        touching = internals["load"] > 0.0
        return {**internals, "anchor": internals["anchor"] + np.where(touching[:, None], past, 0.0)}

    def initial_internals(self) -> Internals:
        """No spring is stretched, and nothing bears."""
        count = len(self.areas)
        found = {
            "rotation": self._target.copy(),
            "anchor": np.zeros((count, 3)),
            "load": np.zeros(count),
            "slip_speed": np.zeros(count),
        }
        return {**found, "bonded": np.zeros(count)} if self.laws.bonds else found
