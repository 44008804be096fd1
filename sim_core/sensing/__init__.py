"""What sensors and cameras of a rig report for a state of the scene."""

from sim_core.sensing.observe import Observer

__all__ = ["Observer"]
