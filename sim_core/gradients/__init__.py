"""Derivatives of whole rollouts."""

from sim_core.gradients.adjoint import Backward, Gradient, simulate_adjoint
from sim_core.gradients.directions import Direction, directions
from sim_core.gradients.tangent import TangentSimulation, simulate_tangent
from sim_core.gradients.tape import Tape

__all__ = [
    "Backward",
    "Direction",
    "Gradient",
    "TangentSimulation",
    "Tape",
    "directions",
    "simulate_adjoint",
    "simulate_tangent",
]
