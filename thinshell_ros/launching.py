"""Parts of launch files: arguments, and the nodes of this package. Imports launch, which comes with ROS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

NAMES = {
    "sim_node": "thinshell_sim",
    "record_node": "recorder",
    "replay_node": "trajectory_deploy",
    "sysid_node": "tactile_sysid",
    "marker_node": "marker_tracker",
    "tf_node": "frames",
}
"""Name of each node, which its parameter file is for."""

FINISHES = ("record_node", "replay_node")
FINISH_S = "30"
"""Nodes that record get so long to finish a recording, of each signal [s]."""


def arguments(**given: tuple[str | None, str]) -> list[DeclareLaunchArgument]:
    """Arguments of a launch file: name -> default, None where there is none, and description."""
    return [
        DeclareLaunchArgument(name, default_value=value, description=words) for name, (value, words) in given.items()
    ]


def given(name: str, kind: Any = str) -> ParameterValue:
    """An argument as a parameter of a type; None: as YAML reads it."""
    return ParameterValue(LaunchConfiguration(name), value_type=kind)


def node(share: Path, executable: str, parameters: Mapping[str, Any], **more: Any) -> list[Any]:
    """A node with these parameters, and the argument that names its parameter file, such as ``sim_params``.

    ``share``: the folder that has ``config``; ``more``: of the launch action.
    """
    key, default = f"{executable.removesuffix('node')}params", share / "config" / "nodes" / f"{executable}.yaml"
    if executable in FINISHES:
        more = {"sigterm_timeout": FINISH_S, "sigkill_timeout": FINISH_S, **more}
    return [
        *arguments(**{key: (str(default), f"parameter file of {executable}")}),
        Node(
            package="thinshell_ros",
            executable=executable,
            name=NAMES[executable],
            output="screen",
            parameters=[LaunchConfiguration(key), dict(parameters)],
            **{"namespace": LaunchConfiguration("namespace"), **more},
        ),
    ]
