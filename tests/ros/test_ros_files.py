"""Launch files, parameter files and the middleware profile agree with the nodes."""

import ast
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from launch_stand_ins import parts, stand_in

from sim_core.rigs import load_rig
from sysid.bench.scenes import SCENES
from thinshell_ros.streams import channels_of

ROOT = Path(__file__).resolve().parents[2]
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch.py"))
PARAMETER_FILES = sorted((ROOT / "config" / "nodes").glob("*.yaml"))
LIVE_FILES = sorted((ROOT / "config" / "nodes" / "live").glob("*.yaml"))
ENTRY_POINTS = dict(re.findall(r'"(\w+) = ([\w.]+):main"', (ROOT / "setup.py").read_text()))
OTHERS = {"robot_state_publisher", "rviz2"}
"""Packages of a ROS distribution of which launch files start nodes."""
NODES = {name: module for name, module in ENTRY_POINTS.items() if name.endswith("_node")}


def calls(tree: ast.AST, name: str) -> list[ast.Call]:
    found = (n for n in ast.walk(tree) if isinstance(n, ast.Call))
    return [n for n in found if isinstance(n.func, ast.Name) and n.func.id == name]


def source(node: str) -> str:
    return (ROOT / Path(*NODES[node].split("."))).with_suffix(".py").read_text()


def default_name(node: str) -> str:
    (name,) = re.findall(r'super\(\).__init__\("(\w+)"', source(node))
    return str(name)


def declared(node: str) -> set[str]:
    """Names of the parameters that a node declares, in its module or in one of its own for them."""
    apart = ROOT / "thinshell_ros" / f"{node.removesuffix('_node')}_parameters.py"
    text = source(node) + (apart.read_text() if apart.is_file() else "")
    names = (call.args[1] for call in calls(ast.parse(text), "declare"))
    return {str(name.value) for name in names if isinstance(name, ast.Constant)} | {"use_sim_time"}


def test_there_is_something_to_check() -> None:
    assert LAUNCH_FILES
    assert {"sim_node", "record_node", "sysid_node", "marker_node"} <= NODES.keys()


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda p: p.name)
def test_launch_files_start_nodes_that_exist_with_parameters_that_exist(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds = stand_in(monkeypatch)
    described = runpy.run_path(str(path))["generate_launch_description"]()
    monkeypatch.delitem(sys.modules, "thinshell_ros.launching")
    defaults = {a.values[0]: a.named["default_value"] for a in parts(described, kinds["DeclareLaunchArgument"])}
    nodes = [node for node in parts(described, kinds["Node"]) if node.named["package"] not in OTHERS]
    assert nodes
    for node in nodes:
        given, executable = node.named, node.named["executable"]
        assert given["package"] == "thinshell_ros"
        assert executable in NODES
        assert given["name"] == default_name(executable)
        file, parameters = given["parameters"]
        assert Path(defaults[file.values[0]]) == ROOT / "config" / "nodes" / f"{executable}.yaml", (
            "a site may replace it"
        )
        assert Path(defaults[file.values[0]]).is_file()
        assert set(parameters) <= declared(executable)
    used = {c.values[0] for c in parts(described, kinds["LaunchConfiguration"])}
    assert set(defaults) == used


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda p: p.name)
def test_launch_files_load(path: Path) -> None:
    pytest.importorskip("launch_ros", reason="launch_ros is not installed (it comes with a ROS distribution)")
    assert runpy.run_path(str(path))["generate_launch_description"]().entities


def test_rviz_shows_topics_that_nodes_publish() -> None:
    shown = yaml.safe_load((ROOT / "config" / "rviz" / "rig.rviz").read_text())["Visualization Manager"]
    topics = {display.get("Topic", {}).get("Value") for display in shown["Displays"]} - {None}
    rig = {channel.topic for channel in channels_of(load_rig("card_press"), 100.0, mesh_rate_hz=1.0).values()}
    assert topics <= rig | {"target_pose", f"{default_name('replay_node')}/path"}
    assert topics >= {"target_pose"}
    assert all(display["Class"].startswith("rviz_default_plugins/") for display in shown["Displays"])


@pytest.mark.parametrize("node", NODES)
def test_each_node_has_a_twin_that_python_runs(node: str) -> None:
    assert 'if __name__ == "__main__":\n    sys.exit(main())\n' in source(node)


@pytest.mark.parametrize("path", PARAMETER_FILES, ids=lambda p: p.name)
def test_parameter_files_name_parameters_that_exist(path: Path) -> None:
    node = path.stem
    (section,) = yaml.safe_load(path.read_text()).items()
    assert section[0] == f"/**/{default_name(node)}"
    assert set(section[1]["ros__parameters"]) <= declared(node)
    assert None not in section[1]["ros__parameters"].values()


def test_every_manipulation_scene_has_a_live_variant() -> None:
    assert {path.stem for path in LIVE_FILES} == {rig for rig, _, _ in SCENES}


@pytest.mark.parametrize("path", LIVE_FILES, ids=lambda p: p.stem)
def test_live_variants_state_their_pace(path: Path) -> None:
    ((name, section),) = yaml.safe_load(path.read_text()).items()
    given = section["ros__parameters"]
    assert name == "/**/thinshell_sim"
    assert set(given) <= declared("sim_node")
    assert given["rig"] == path.stem
    assert given["publish_clock"] is True
    assert 0.0 < given["real_time_factor"] <= 1.0
    assert all(isinstance(given[key], float) for key in ("real_time_factor", "command_timeout_s", "watchdog_s"))


def run(code: str, **environment: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**os.environ, **environment},
    )  # fmt: skip


LARGE = """
import array, sys, time
import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image
rclpy.init()
node = rclpy.create_node("{role}")
end = time.monotonic() + 200.0
if "{role}" == "sender":
    publisher = node.create_publisher(Image, "image", qos_profile_sensor_data)
    image = Image(height=480, width=640, encoding="rgb8", step=1920, data=array.array("B", bytes(921600)))
    while time.monotonic() < end:
        publisher.publish(image)
        time.sleep(0.03)
else:
    got = []
    node.create_subscription(Image, "image", got.append, qos_profile_sensor_data)
    while len(got) < 20 and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
    print("images:", len(got))
node.destroy_node()
rclpy.try_shutdown()
"""


@pytest.mark.ros
def test_the_shared_memory_profile_carries_raw_images_at_best_effort(ros: None) -> None:
    profile = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(ROOT / "config" / "fastdds_shm.xml")}
    sender = run(LARGE.replace("{role}", "sender"), **profile)
    receiver = run(LARGE.replace("{role}", "receiver"), **profile)
    try:
        output, _ = receiver.communicate(timeout=300.0)
        assert "images: 20" in output, output
        assert "rror" not in output, output
    finally:
        sender.terminate()
        receiver.kill()
        sender.communicate()
