"""Rigs and experiments: what stands on the table, and how it is moved."""

from sim_core.rigs.bodies import (
    WORLD,
    Affine,
    AffineMaterial,
    Gel,
    GelMaterial,
    Outline,
    Rectangle,
    Rigid,
    Sheet,
    SheetMaterial,
)
from sim_core.rigs.fields import Pose
from sim_core.rigs.gel_shapes import Block, Disc, Dome
from sim_core.rigs.limits import HandLimits, Limits
from sim_core.rigs.load import config_folder, load_rig, parse_rig, rig_to_yaml
from sim_core.rigs.mesh_shapes import GelFile, SheetFile
from sim_core.rigs.observers import (
    FisheyeCamera,
    MarkerSensor,
    OrthographicCamera,
    PinholeCamera,
    Points,
    Sight,
    WrenchSensor,
)
from sim_core.rigs.parameters import Parameter, list_parameters, resolve_name, with_parameters
from sim_core.rigs.points import marker_positions, seen_points, track_ids
from sim_core.rigs.rigid_shapes import Box, Cylinder, Plane, Sphere
from sim_core.rigs.schema import Clamp, Contact, EndEffector, Joint, Rig

__all__ = [
    "WORLD",
    "Affine",
    "AffineMaterial",
    "Block",
    "Box",
    "Clamp",
    "Contact",
    "Cylinder",
    "Disc",
    "Dome",
    "EndEffector",
    "FisheyeCamera",
    "Gel",
    "GelFile",
    "GelMaterial",
    "HandLimits",
    "Joint",
    "Limits",
    "MarkerSensor",
    "OrthographicCamera",
    "Outline",
    "Parameter",
    "PinholeCamera",
    "Plane",
    "Points",
    "Pose",
    "Rectangle",
    "Rig",
    "Rigid",
    "Sheet",
    "SheetFile",
    "SheetMaterial",
    "Sight",
    "Sphere",
    "WrenchSensor",
    "config_folder",
    "list_parameters",
    "load_rig",
    "marker_positions",
    "parse_rig",
    "resolve_name",
    "rig_to_yaml",
    "seen_points",
    "track_ids",
    "with_parameters",
]
