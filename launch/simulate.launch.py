"""A simulated rig, and a recording of all its topics if asked for.

ros2 launch thinshell_ros simulate.launch.py rig:=card_press record:=true bag:=press
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

NODES = Path(__file__).resolve().parent.parent / "config" / "nodes"


def generate_launch_description() -> LaunchDescription:
    """The simulator, and the recorder where ``record`` is true."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("rig", default_value="card_press", description="rig: name or YAML file"),
            DeclareLaunchArgument("namespace", default_value="", description="of all topics"),
            DeclareLaunchArgument("publish_clock", default_value="false", description="simulated time"),
            DeclareLaunchArgument("record", default_value="false", description="record all topics"),
            DeclareLaunchArgument("bag", default_value="", description="new bag; empty: by date and time"),
            Node(
                package="thinshell_ros",
                executable="sim_node",
                name="thinshell_sim",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                parameters=[
                    str(NODES / "sim_node.yaml"),
                    {
                        "rig": ParameterValue(LaunchConfiguration("rig"), value_type=str),
                        "publish_clock": LaunchConfiguration("publish_clock"),
                    },
                ],
            ),
            Node(
                package="thinshell_ros",
                executable="record_node",
                name="recorder",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                condition=IfCondition(LaunchConfiguration("record")),
                parameters=[
                    str(NODES / "record_node.yaml"),
                    {
                        "rig": ParameterValue(LaunchConfiguration("rig"), value_type=str),
                        "uri": ParameterValue(LaunchConfiguration("bag"), value_type=str),
                    },
                ],
            ),
        ]
    )
