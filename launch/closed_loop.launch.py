"""The circle of optimisation, replay, watch, diagnosis and amendment, on a simulated robot that conceals something.

ros2 launch thinshell_ros closed_loop.launch.py task:=lifting robot:=$PWD/robot.yaml out:=$PWD/loop
"""

import sys
from pathlib import Path

from launch.actions import DeclareLaunchArgument, ExecuteProcess, RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

NODES = Path(__file__).resolve().parent.parent / "config" / "nodes"


def generate_launch_description() -> LaunchDescription:
    """The robot, and the circle; all ends with it."""
    circle = ExecuteProcess(
        cmd=[
            sys.executable, "-m", "thinshell_ros.closed_loop", LaunchConfiguration("task"),
            "--out", LaunchConfiguration("out"), "--rounds", LaunchConfiguration("rounds"),
            "--budget", LaunchConfiguration("budget"), "--namespace", "/robot",
            "--simulated", LaunchConfiguration("robot"),
        ],
        output="screen",
        sigterm_timeout="60",
        sigkill_timeout="60",
    )  # fmt: skip
    return LaunchDescription(
        [
            DeclareLaunchArgument("task", description="task: a name, NAME:VARIANT or a file"),
            DeclareLaunchArgument("robot", description="rig of the robot, with what it conceals"),
            DeclareLaunchArgument("out", default_value="closed_loop", description="new folder"),
            DeclareLaunchArgument("rounds", default_value="3", description="most rounds"),
            DeclareLaunchArgument("budget", default_value="50", description="rollouts of each optimisation"),
            DeclareLaunchArgument(
                "sim_params", default_value=str(NODES / "sim_node.yaml"), description="parameter file of sim_node"
            ),
            Node(
                package="thinshell_ros",
                executable="sim_node",
                name="thinshell_sim",
                namespace="robot",
                output="screen",
                parameters=[
                    LaunchConfiguration("sim_params"),
                    {
                        "rig": ParameterValue(LaunchConfiguration("robot"), value_type=str),
                        "publish_clock": True,
                    },
                ],
            ),
            circle,
            RegisterEventHandler(OnProcessExit(target_action=circle, on_exit=[Shutdown()])),
        ]
    )
