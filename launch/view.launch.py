"""Frames of a rig for others: its URDF by robot_state_publisher, its end effectors on /tf, and RViz if asked for.

ros2 launch thinshell_ros view.launch.py rig:=card_press rviz:=true
"""

import sys
from pathlib import Path

from launch.conditions import IfCondition
from launch.substitutions import Command, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from thinshell_ros.launching import arguments, given, node

SHARE = Path(__file__).resolve().parent.parent


def generate_launch_description() -> LaunchDescription:
    """The frames, and RViz where ``rviz`` is true."""
    rig, place = LaunchConfiguration("rig"), LaunchConfiguration("namespace")
    # Quoted: a command is split at the blanks of a path.
    described = Command([sys.executable, " -m thinshell_ros.frames '", rig, "'"])
    return LaunchDescription(
        [
            *arguments(
                rig=("card_press", "rig: name or YAML file"),
                namespace=("", "of the rig's topics"),
                rviz=("false", "start RViz"),
                rviz_config=(str(SHARE / "config" / "rviz" / "rig.rviz"), "what RViz shows"),
            ),
            *node(SHARE, "tf_node", {"rig": given("rig")}),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                namespace=place,
                parameters=[{"robot_description": ParameterValue(described, value_type=str)}],
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=place,
                arguments=["-d", LaunchConfiguration("rviz_config")],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )
