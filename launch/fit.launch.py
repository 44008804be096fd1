"""A fit that is started, followed and cancelled over topics and services.

ros2 launch thinshell_ros fit.launch.py rig:=strip_pull bag:=pull.bag output_dir:=fits
ros2 service call /tactile_sysid/start std_srvs/srv/Trigger
"""

from pathlib import Path

from launch import LaunchDescription
from thinshell_ros.launching import arguments, given, node

SHARE = Path(__file__).resolve().parent.parent


def generate_launch_description() -> LaunchDescription:
    """The node that fits; it waits to be asked."""
    parameters = {"rig": given("rig"), "bag_uri": given("bag"), "output_dir": given("output_dir")}
    return LaunchDescription(
        [
            *arguments(
                rig=("strip_pull", "rig: name or YAML file"),
                namespace=("", "of topics and services"),
                bag=("", "recording to fit"),
                parameters=("[strip.E]", "what to estimate, a list"),
                output_dir=("fits", "folder of the results"),
            ),
            *node(SHARE, "sysid_node", {**parameters, "fit.parameters": given("parameters", None)}),
        ]
    )
