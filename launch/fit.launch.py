"""A fit that is started, followed and cancelled over topics and services.

ros2 launch thinshell_ros fit.launch.py rig:=strip_pull bag:=pull.bag output_dir:=fits
ros2 service call /tactile_sysid/start std_srvs/srv/Trigger
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

NODES = Path(__file__).resolve().parent.parent / "config" / "nodes"


def generate_launch_description() -> LaunchDescription:
    """The node that fits; it waits to be asked."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("rig", default_value="strip_pull", description="rig: name or YAML file"),
            DeclareLaunchArgument("namespace", default_value="", description="of topics and services"),
            DeclareLaunchArgument("bag", default_value="", description="recording to fit"),
            DeclareLaunchArgument("parameters", default_value="[strip.E]", description="what to estimate, a list"),
            DeclareLaunchArgument("output_dir", default_value="fits", description="folder of the results"),
            DeclareLaunchArgument(
                "sysid_params", default_value=str(NODES / "sysid_node.yaml"), description="parameter file of sysid_node"
            ),
            Node(
                package="thinshell_ros",
                executable="sysid_node",
                name="tactile_sysid",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                parameters=[
                    LaunchConfiguration("sysid_params"),
                    {
                        "rig": ParameterValue(LaunchConfiguration("rig"), value_type=str),
                        "bag_uri": ParameterValue(LaunchConfiguration("bag"), value_type=str),
                        "fit.parameters": LaunchConfiguration("parameters"),
                        "output_dir": ParameterValue(LaunchConfiguration("output_dir"), value_type=str),
                    },
                ],
            ),
        ]
    )
