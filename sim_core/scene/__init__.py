"""A rig made runnable: bodies meshed, terms assembled, sensors placed."""

from sim_core.scene.scene import Scene, Values, build_scene

__all__ = ["Scene", "Values", "build_scene"]
