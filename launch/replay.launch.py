"""Replay of a trajectory under guard, and a simulated rig to rehearse it on if asked for.

ros2 launch thinshell_ros replay.launch.py trajectory:=press.json rig:=card_press simulate:=true dry_run:=false
ros2 lifecycle set /trajectory_deploy configure
ros2 lifecycle set /trajectory_deploy activate
ros2 service call /trajectory_deploy/execute std_srvs/srv/Trigger
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
    """The node that replays, which waits to be configured, and the simulator where ``simulate`` is true."""
    rig = ParameterValue(LaunchConfiguration("rig"), value_type=str)
    return LaunchDescription(
        [
            DeclareLaunchArgument("trajectory", default_value="", description="trajectory file"),
            DeclareLaunchArgument("rig", default_value="", description="rig that it must fit"),
            DeclareLaunchArgument("namespace", default_value="", description="of all topics"),
            DeclareLaunchArgument("dry_run", default_value="true", description="command nothing"),
            DeclareLaunchArgument("speed_scale", default_value="1.0", description="share of the planned speed"),
            DeclareLaunchArgument("bag", default_value="", description="new bag; empty: by date and time"),
            DeclareLaunchArgument("target_pose", default_value="target_pose", description="topic of the controller"),
            DeclareLaunchArgument("current_pose", default_value="current_pose", description="topic of the robot"),
            DeclareLaunchArgument("simulate", default_value="false", description="start sim_node with the rig"),
            DeclareLaunchArgument(
                "sim_params", default_value=str(NODES / "sim_node.yaml"), description="parameter file of sim_node"
            ),
            DeclareLaunchArgument(
                "replay_params",
                default_value=str(NODES / "replay_node.yaml"),
                description="parameter file of replay_node",
            ),
            Node(
                package="thinshell_ros",
                executable="sim_node",
                name="thinshell_sim",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                condition=IfCondition(LaunchConfiguration("simulate")),
                parameters=[LaunchConfiguration("sim_params"), {"rig": rig, "publish_clock": True}],
            ),
            Node(
                package="thinshell_ros",
                executable="replay_node",
                sigterm_timeout=FINISH_S,
                sigkill_timeout=FINISH_S,
                name="trajectory_deploy",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                remappings=[
                    ("target_pose", LaunchConfiguration("target_pose")),
                    ("current_pose", LaunchConfiguration("current_pose")),
                ],
                parameters=[
                    LaunchConfiguration("replay_params"),
                    {
                        "trajectory_uri": ParameterValue(LaunchConfiguration("trajectory"), value_type=str),
                        "rig": rig,
                        "dry_run": LaunchConfiguration("dry_run"),
                        "speed_scale": ParameterValue(LaunchConfiguration("speed_scale"), value_type=float),
                        "record_uri": ParameterValue(LaunchConfiguration("bag"), value_type=str),
                        # A simulation that is slow takes the replay with it.
                        "use_sim_time": ParameterValue(LaunchConfiguration("simulate"), value_type=bool),
                    },
                ],
            ),
        ]
    )
