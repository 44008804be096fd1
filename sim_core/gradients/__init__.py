"""Derivatives of whole rollouts."""

from sim_core.gradients.directions import Direction, directions
from sim_core.gradients.tangent import TangentSimulation, simulate_tangent

__all__ = ["Direction", "TangentSimulation", "directions", "simulate_tangent"]
