"""Markers of a camera's pictures as tracks.

ros2 launch thinshell_ros track.launch.py namespace:=tactile/left
"""

from pathlib import Path

from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription
from thinshell_ros.launching import arguments, given, node

SHARE = Path(__file__).resolve().parent.parent


def generate_launch_description() -> LaunchDescription:
    """The tracker."""
    topics = {"image": "image", "image/compressed": "compressed", "marker_tracks": "tracks"}
    return LaunchDescription(
        [
            *arguments(
                namespace=("", "of the camera"),
                image=("image", "topic of sensor_msgs/Image"),
                compressed=("image/compressed", "topic of sensor_msgs/CompressedImage"),
                tracks=("marker_tracks", "topic of the tracks"),
                layout=("", "tracking.json of 'thinshell track'"),
            ),
            *node(
                SHARE,
                "marker_node",
                {"layout": given("layout")},
                remappings=[(topic, LaunchConfiguration(name)) for topic, name in topics.items()],
            ),
        ]
    )
