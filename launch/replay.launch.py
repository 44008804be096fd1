"""Replay of a trajectory under guard, and a simulated rig to rehearse it on if asked for.

ros2 launch thinshell_ros replay.launch.py trajectory:=press.json rig:=card_press simulate:=true dry_run:=false
ros2 lifecycle set /trajectory_deploy configure
ros2 lifecycle set /trajectory_deploy activate
ros2 service call /trajectory_deploy/execute std_srvs/srv/Trigger
"""

from pathlib import Path

from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription
from thinshell_ros.launching import arguments, given, node

SHARE = Path(__file__).resolve().parent.parent


def generate_launch_description() -> LaunchDescription:
    """The node that replays, which waits to be configured, and the simulator where ``simulate`` is true."""
    simulated = IfCondition(LaunchConfiguration("simulate"))
    parameters = {"rig": given("rig"), "trajectory_uri": given("trajectory"), "record_uri": given("bag")}
    # A simulation that is slow takes the replay with it.
    paced = {"speed_scale": given("speed_scale", float), "use_sim_time": given("simulate", bool)}
    return LaunchDescription(
        [
            *arguments(
                trajectory=("", "trajectory file"),
                rig=("", "rig that it must fit"),
                namespace=("", "of all topics"),
                dry_run=("true", "command nothing"),
                speed_scale=("1.0", "share of the planned speed"),
                bag=("", "new bag; empty: by date and time"),
                target_pose=("target_pose", "topic of the controller"),
                current_pose=("current_pose", "topic of the robot"),
                simulate=("false", "start sim_node with the rig"),
            ),
            *node(SHARE, "sim_node", {"rig": given("rig"), "publish_clock": True}, condition=simulated),
            *node(
                SHARE,
                "replay_node",
                {**parameters, **paced, "dry_run": given("dry_run", bool)},
                remappings=[(topic, LaunchConfiguration(topic)) for topic in ("target_pose", "current_pose")],
            ),
        ]
    )
