"""Derivatives of whole rollouts."""

from sim_core.gradients.tangent import TangentSimulation, simulate_tangent

__all__ = ["TangentSimulation", "simulate_tangent"]
