"""Markers of a camera's pictures as tracks.

ros2 launch thinshell_ros track.launch.py namespace:=tactile/left
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

NODES = Path(__file__).resolve().parent.parent / "config" / "nodes"


def generate_launch_description() -> LaunchDescription:
    """The tracker."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="of the camera"),
            DeclareLaunchArgument("image", default_value="image", description="topic of sensor_msgs/Image"),
            DeclareLaunchArgument(
                "compressed", default_value="image/compressed", description="topic of sensor_msgs/CompressedImage"
            ),
            DeclareLaunchArgument("tracks", default_value="marker_tracks", description="topic of the tracks"),
            DeclareLaunchArgument("layout", default_value="", description="tracking.json of 'thinshell track'"),
            DeclareLaunchArgument(
                "marker_params",
                default_value=str(NODES / "marker_node.yaml"),
                description="parameter file of marker_node",
            ),
            Node(
                package="thinshell_ros",
                executable="marker_node",
                name="marker_tracker",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                remappings=[
                    ("image", LaunchConfiguration("image")),
                    ("image/compressed", LaunchConfiguration("compressed")),
                    ("marker_tracks", LaunchConfiguration("tracks")),
                ],
                parameters=[
                    LaunchConfiguration("marker_params"),
                    {"layout": ParameterValue(LaunchConfiguration("layout"), value_type=str)},
                ],
            ),
        ]
    )
