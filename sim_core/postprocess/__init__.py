"""From a rig and a state history to what is drawn and read off: surfaces, strain, curvature, pressure, slip."""

from sim_core.postprocess.fields import QUANTITIES, Quantity, quantity
from sim_core.postprocess.layout import Layout, lay_out
from sim_core.postprocess.surfaces import Surface, surfaces, vertex_normals

__all__ = ["QUANTITIES", "Layout", "Quantity", "Surface", "lay_out", "quantity", "surfaces", "vertex_normals"]
