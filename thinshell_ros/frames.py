"""Frames of a rig as a tree, and the same as a URDF for ``robot_state_publisher``. No ROS.

    python -m thinshell_ros.frames RIG

The base frame of the end effectors is the world. An end effector is a frame with its name, which floats in the base
frame: where it is says ``tf_node`` (``robot_state_publisher`` leaves floating joints to others). Frames of sensors,
optical frames of cameras, and bodies that a mount carries are fixed in the end effector that carries them, else in the
base frame.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from sim_core.errors import ConfigError
from sim_core.rigs import WORLD, Block, Box, Cylinder, Disc, Gel, MarkerSensor, Pose, Rig, Rigid, Sphere, load_rig
from thinshell_ros.command import command

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

NEAR_M, NEAR_RAD = 1e-9, 1e-9
"""Two frames with one name have to be the same to so much."""


@dataclass(frozen=True)
class Fixed:
    """A frame ``name`` at a pose [m] ``(3,)`` in its ``parent``. ``shape``: of the body that stands there, if one
    does; ``moves``: the pose is that at the start."""

    name: str
    parent: str
    position: np.ndarray
    rotation: Rotation
    shape: Any = None
    moves: bool = False


def base_of(rig: Rig) -> str:
    """The frame that is the world."""
    return next((effector.base_frame for effector in rig.end_effectors.values()), "base_link")


def frames_of(rig: Rig) -> list[Fixed]:
    """All frames of a rig but that which is the world, each once.

    Raises:
        ConfigError: two frames have one name, and are not the same.
    """
    base, found = base_of(rig), dict[str, Fixed]()
    places: dict[str, tuple[str, Pose]] = {}

    def put(name: str, mount: str, *chain: Pose, shape: Any = None, moves: bool = False) -> None:
        at = chain[-1].position(), chain[-1].rotation()
        for outer in reversed(chain[:-1]):
            at = outer.position() + outer.rotation().apply(at[0]), outer.rotation() * at[1]
        parent = base if mount == WORLD else mount
        if name == parent and float(np.linalg.norm(at[0])) <= NEAR_M and at[1].magnitude() <= NEAR_RAD:
            return  # a sensor's frame that is that of its end effector
        frame = Fixed(name, parent, *at, shape, moves)
        other = found.setdefault(name, frame)
        turn = (other.rotation.inv() * frame.rotation).magnitude()
        apart = float(np.linalg.norm(other.position - frame.position))
        if name == base or other.parent != frame.parent or apart > NEAR_M or turn > NEAR_RAD:
            raise ConfigError(
                f"The rig {rig.name!r} has two frames {name!r}, which are not at the same place.",
                "Give one of them another frame_id.",
            )

    for name, effector in rig.end_effectors.items():
        put(name, WORLD, effector.start, moves=True)
    for name, body in rig.bodies.items():
        mount = body.mount if isinstance(body, Gel | Rigid) else None
        places[name] = mount or WORLD, body.pose
        if mount is not None:
            put(f"{name}_body", *places[name], shape=body.shape)
    places |= {clamp.name: (clamp.mount, Pose()) for clamp in rig.clamps if clamp.name is not None}
    places |= {name: (name, Pose()) for name in rig.end_effectors}
    for name, sensor in rig.sensors.items():
        mount, carrier = places[sensor.body if isinstance(sensor, MarkerSensor) else sensor.on]
        put(sensor.frame_id or name, mount, carrier, sensor.pose)
    for name, camera in rig.cameras.items():
        put(camera.frame_id or name, camera.mount, camera.pose)
    return list(found.values())


def urdf(rig: Rig) -> str:
    """The frames as a URDF; blocks and discs of gel, balls, boxes and cylinders have shapes to be drawn."""
    robot = ElementTree.Element("robot", name=rig.name)
    ElementTree.SubElement(robot, "link", name=base_of(rig))
    for frame in frames_of(rig):
        link = ElementTree.SubElement(robot, "link", name=frame.name)
        geometry = _geometry(frame.shape)
        if geometry is not None:
            ElementTree.SubElement(link, "visual").append(geometry)
        kind = "floating" if frame.moves else "fixed"
        joint = ElementTree.SubElement(robot, "joint", name=f"{frame.parent}_to_{frame.name}", type=kind)
        ElementTree.SubElement(joint, "parent", link=frame.parent)
        ElementTree.SubElement(joint, "child", link=frame.name)
        ElementTree.SubElement(joint, "origin", xyz=_words(frame.position), rpy=_words(_angles(frame.rotation)))
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode") + "\n"


def _geometry(shape: Any) -> ElementTree.Element | None:
    geometry = ElementTree.Element("geometry")
    if isinstance(shape, Box | Block):
        ElementTree.SubElement(geometry, "box", size=_words(shape.size_m))
    elif isinstance(shape, Sphere):
        ElementTree.SubElement(geometry, "sphere", radius=f"{shape.radius_m:.9g}")
    elif isinstance(shape, Cylinder | Disc):
        length = shape.length_m if isinstance(shape, Cylinder) else shape.height_m
        ElementTree.SubElement(geometry, "cylinder", radius=f"{shape.radius_m:.9g}", length=f"{length:.9g}")
    else:
        return None
    return geometry


def _angles(rotation: Rotation) -> np.ndarray:
    """Roll, pitch, yaw [rad] about the fixed axes ``(3,)``; of those that give the same where pitch is 90 degrees,
    that without yaw."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")
        return np.asarray(rotation.as_euler("xyz"))


def _words(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)


@command
def main(arguments: Sequence[str]) -> None:
    """Print the URDF of a rig."""
    if len(arguments) != 1:
        raise ConfigError("One rig is needed.", "Call it as: python -m thinshell_ros.frames RIG")
    print(urdf(load_rig(arguments[0])), end="")


if __name__ == "__main__":
    sys.exit(main())
