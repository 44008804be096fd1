"""A simulated rig, and a recording of all its topics if asked for.

ros2 launch thinshell_ros simulate.launch.py rig:=card_press record:=true bag:=press
"""

from pathlib import Path

from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription
from thinshell_ros.launching import arguments, given, node

SHARE = Path(__file__).resolve().parent.parent


def generate_launch_description() -> LaunchDescription:
    """The simulator, and the recorder where ``record`` is true."""
    recorded = IfCondition(LaunchConfiguration("record"))
    return LaunchDescription(
        [
            *arguments(
                rig=("card_press", "rig: name or YAML file"),
                namespace=("", "of all topics"),
                publish_clock=("false", "simulated time"),
                record=("false", "record all topics"),
                bag=("", "new bag; empty: by date and time"),
            ),
            *node(SHARE, "sim_node", {"rig": given("rig"), "publish_clock": given("publish_clock", bool)}),
            *node(SHARE, "record_node", {"rig": given("rig"), "uri": given("bag")}, condition=recorded),
        ]
    )
