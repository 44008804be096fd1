"""The layout for Foxglove, and meshes as markers: against what nodes really publish."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from ros_live import RIG, Client, NodeProcess

pytest.importorskip("rclpy", reason="thinshell_ros needs the ROS message packages")

from sim_core.rigs import load_rig
from sim_core.rigs.load import names_in
from thinshell_ros import foxglove
from thinshell_ros.physics import Physics
from thinshell_ros.poses import Pose
from thinshell_ros.protocol import Settings, Target
from thinshell_ros.streams import channels_of

PLACE = "/shown"
OF_OTHERS = {"robot_description", "trajectory_deploy/path", "target_pose"}
"""Topics of robot_state_publisher, of the node that replays, and of who commands."""


def paths_of(made: dict[str, Any]) -> set[str]:
    """Topics and message paths of all panels of a layout."""
    found: set[str] = set()
    for name, panel in made["configById"].items():
        if name.startswith("3D!"):
            found |= panel["topics"].keys() | {panel["layers"]["urdf"]["topic"]}
        elif name.startswith("Plot!"):
            found |= {series["value"] for series in panel["paths"]}
        elif name.startswith("Image!"):
            found |= set(panel["imageMode"].values())
        else:
            found |= {panel.get("topicPath") or panel["topicToRender"]}
    return found


def leaves(shown: Any) -> list[str]:
    """Names of the panels of a layout's tree."""
    return [shown] if isinstance(shown, str) else leaves(shown["first"]) + leaves(shown["second"])


@pytest.mark.parametrize("name", names_in("rigs"))
def test_every_rig_has_a_layout_with_every_panel_in_it(name: str) -> None:
    made = foxglove.layout(load_rig(name), "/left")
    assert sorted(leaves(made["layout"])) == sorted(made["configById"])
    kinds = {panel.partition("!")[0] for panel in made["configById"]}
    assert kinds <= {"3D", "Plot", "Image", "DiagnosticSummary", "RawMessages"}
    assert all(path.startswith(("/left/", "/diagnostics")) for path in paths_of(made))


def shares(shown: Any, height: float = 100.0) -> list[float]:
    """Heights [%] of the panels of a column."""
    if isinstance(shown, str):
        return [height]
    assert shown["direction"] == "column"
    first = height * shown["splitPercentage"] / 100.0
    return shares(shown["first"], first) + shares(shown["second"], height - first)


def test_panels_say_what_they_show_and_are_as_high() -> None:
    rig = load_rig(RIG)
    made = foxglove.layout(rig, "/left")
    assert made["configById"]["3D!scene"]["followTf"] == "base_link"
    wrench = next(name for name, channel in channels_of(rig, 100.0).items() if channel.kind == "wrench")
    plot = made["configById"][f"Plot!{wrench}"]
    assert plot["title"].endswith("force [N]")
    assert [p["value"].partition(".")[2] for p in plot["paths"]] == [f"wrench.force.{axis}" for axis in "xyz"]
    high = shares(made["layout"]["second"])
    assert len(high) > 2 and high == pytest.approx([100.0 / len(high)] * len(high))


def test_the_command_prints_a_layout_or_says_what_is_wrong(capsys: pytest.CaptureFixture[str]) -> None:
    assert foxglove.main([str(RIG), "/left"]) == 0
    assert json.loads(capsys.readouterr().out) == foxglove.layout(load_rig(RIG), "/left")
    assert foxglove.main([]) == 2
    assert "python -m thinshell_ros.foxglove RIG" in capsys.readouterr().err
    assert foxglove.main(["--help"]) == 2
    assert "python -m thinshell_ros.foxglove RIG" in capsys.readouterr().err


@pytest.mark.parametrize("namespace", ["left", "/left arm", "/2", "//left", ""])
def test_a_namespace_that_ros_does_not_have_is_refused(namespace: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert foxglove.main([str(RIG), namespace]) == 2
    captured = capsys.readouterr()
    assert not captured.out
    assert captured.err.startswith(f"error: {namespace!r} is no namespace of ROS.") and "as /left" in captured.err


@pytest.fixture(scope="module")
def shown(ros: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A client of a simulator that publishes all that it can, and runs."""
    with NodeProcess(
        "sim_node", tmp_path_factory.mktemp("shown") / "output", PLACE, rig=RIG, mesh_rate_hz="10.0",
        contact_forces="true", pictures="true", noise="false",
    ) as node:  # fmt: skip
        client = Client("viewer", PLACE)
        try:
            client.wait(lambda: "Simulating" in node.output, "the simulator does not start", 240.0)
            yield client
        finally:
            client.node.destroy_node()


@pytest.mark.ros
def test_what_a_layout_shows_is_what_the_simulator_publishes(shown: Client) -> None:
    rig = load_rig(RIG)
    foreign = {f"{PLACE}/{topic}" for topic in OF_OTHERS}

    def published() -> dict[str, str]:
        return {t: kinds[0] for t, kinds in shown.node.get_topic_names_and_types() if shown.node.count_publishers(t)}

    paths = paths_of(foxglove.layout(rig, PLACE))
    wanted = {path.partition(".")[0] for path in paths} - foreign
    shown.wait(lambda: wanted <= published().keys(), f"not published: {wanted - published().keys()}")
    types = published()
    ours = {t for t in types if t.startswith(PLACE) and not t.endswith(("_rest", "marker_tracks"))}
    assert ours == {t for t in wanted if t.startswith(PLACE)}, "all that is published is shown"
    for path in paths:
        topic, *fields = path.split(".")
        if topic not in types:
            continue
        package, _, name = types[topic].split("/")
        kind = getattr(import_module(f"{package}.msg"), name)
        for field in fields:
            inner = kind.get_fields_and_field_types()[field]
            if "/" in inner:
                package, name = inner.split("/")
                kind = getattr(import_module(f"{package}.msg"), name)


@pytest.mark.ros
def test_a_mesh_is_a_marker_of_triangles_in_the_base_frame(shown: Client) -> None:
    from visualization_msgs.msg import Marker

    heard = shown.listen(Marker, "mesh/pad")
    marker = shown.wait(lambda: heard and heard[-1], "no mesh")
    assert marker.type == Marker.TRIANGLE_LIST and marker.header.frame_id == "base_link"
    corners = np.array([[p.x, p.y, p.z] for p in marker.points])
    assert len(corners) % 3 == 0
    assert np.ptp(corners, axis=0) == pytest.approx([0.012, 0.012, 0.004], rel=0.02)
    edges = np.linalg.norm(corners[0::3] - corners[1::3], axis=1)
    assert edges.min() > 3e-4, "triangles have an extent"


def test_a_mesh_follows_its_body() -> None:
    rig = load_rig(RIG)
    channels = channels_of(rig, 50.0, mesh_rate_hz=50.0)
    assert [name for name, c in channels.items() if c.kind == "mesh"] == ["mesh/pad"], "rigid bodies are in the URDF"
    assert not [c for c in channels_of(rig, 50.0).values() if c.kind == "mesh"]
    physics = Physics(Settings(rig, channels, 1, 0.1, 1.0))
    physics.aim(Target("probe", Pose(np.array([0.0, 0.0, 0.0092]), np.array([0.0, 0.0, 0.0, 1.0]))))
    found = {r.channel: r.values for _ in range(20) for r in physics.step()[0]}
    before, after = physics.rest["mesh/pad"], found["mesh/pad"]
    lowered = (before - after)[:, 2]
    top = before[:, 2] > 0.0039
    middle = np.argmin(np.hypot(*before[:, :2].T) + ~top)
    assert lowered[middle] == lowered.max() > 5e-4, "it gives way below the ball"
    assert np.abs(after - before)[before[:, 2] < 1e-9].max() < 1e-12, "and is bonded below"
    assert physics.ids["mesh/pad"].max() < len(after)
