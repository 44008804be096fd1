"""Are the gradients of rollouts right: forward, adjoint and central differences side by side."""

from sysid.gradients.check import check_gradients

__all__ = ["check_gradients"]
