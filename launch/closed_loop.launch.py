"""The circle of optimisation, replay, watch, diagnosis and amendment, on a simulated robot that conceals something.

ros2 launch thinshell_ros closed_loop.launch.py task:=lifting robot:=$PWD/robot.yaml out:=$PWD/loop
"""

import sys
from pathlib import Path

from launch.actions import ExecuteProcess, RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription
from thinshell_ros.launching import arguments, given, node

SHARE = Path(__file__).resolve().parent.parent


def generate_launch_description() -> LaunchDescription:
    """The robot, and the circle; all ends with it."""
    task, out, rounds, budget, robot = map(LaunchConfiguration, ("task", "out", "rounds", "budget", "robot"))
    words = [sys.executable, "-m", "thinshell_ros.closed_loop", task, "--out", out, "--rounds", rounds]
    words += ["--budget", budget, "--namespace", "/robot", "--simulated", robot]
    circle = ExecuteProcess(cmd=words, output="screen", sigterm_timeout="60", sigkill_timeout="60")
    return LaunchDescription(
        [
            *arguments(
                task=(None, "task: a name, NAME:VARIANT or a file"),
                robot=(None, "rig of the robot, with what it conceals"),
                out=("closed_loop", "new folder"),
                rounds=("3", "most rounds"),
                budget=("50", "rollouts of each optimisation"),
            ),
            *node(SHARE, "sim_node", {"rig": given("robot"), "publish_clock": True}, namespace="robot"),
            circle,
            RegisterEventHandler(OnProcessExit(target_action=circle, on_exit=[Shutdown()])),
        ]
    )
