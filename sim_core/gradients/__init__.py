"""Derivatives of whole rollouts."""

from sim_core.gradients.adjoint import Backward, simulate_adjoint
from sim_core.gradients.directions import Direction, directions
from sim_core.gradients.gradient import Gradient
from sim_core.gradients.smoothed import Smoothed, rollout_loss, smoothed_gradient
from sim_core.gradients.tangent import simulate_tangent
from sim_core.gradients.tape import Tape

__all__ = [
    "Backward",
    "Direction",
    "Gradient",
    "Smoothed",
    "Tape",
    "directions",
    "rollout_loss",
    "simulate_adjoint",
    "simulate_tangent",
    "smoothed_gradient",
]
