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

FINISH_S = "30"
"""Time [s] that a recording gets to be finished, of each signal."""

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
            DeclareLaunchArgument(
                "sim_params", default_value=str(NODES / "sim_node.yaml"), description="parameter file of sim_node"
            ),
            DeclareLaunchArgument(
                "record_params",
                default_value=str(NODES / "record_node.yaml"),
                description="parameter file of record_node",
            ),
            Node(
                package="thinshell_ros",
                executable="sim_node",
                name="thinshell_sim",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                parameters=[
                    LaunchConfiguration("sim_params"),
                    {
                        "rig": ParameterValue(LaunchConfiguration("rig"), value_type=str),
                        "publish_clock": LaunchConfiguration("publish_clock"),
                    },
                ],
            ),
            Node(
                package="thinshell_ros",
                executable="record_node",
                sigterm_timeout=FINISH_S,
                sigkill_timeout=FINISH_S,
                name="recorder",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                condition=IfCondition(LaunchConfiguration("record")),
                parameters=[
                    LaunchConfiguration("record_params"),
                    {
                        "rig": ParameterValue(LaunchConfiguration("rig"), value_type=str),
                        "uri": ParameterValue(LaunchConfiguration("bag"), value_type=str),
                    },
                ],
            ),
        ]
    )
