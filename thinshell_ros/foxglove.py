"""A layout of Foxglove, or of Lichtblick, that shows a rig: what its topics carry decides what is drawn. No ROS.

    python -m thinshell_ros.foxglove RIG [NAMESPACE] > rig.json

In Foxglove: *Layouts*, *Import from file*; the data come from ``foxglove_bridge`` or from a bag.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from typing import Any

from sim_core.errors import ConfigError
from sim_core.rigs import Rig, load_rig
from thinshell_ros.command import command
from thinshell_ros.frames import base_of
from thinshell_ros.streams import EVENT_TOPIC, channels_of

FRAME_S = 0.05
"""Size of the axes of frames [m]."""

MESH_RATE_HZ = 10.0
"""Any rate: meshes are drawn where ``sim_node`` publishes them (``mesh_rate_hz``)."""

NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+/?|/")
"""Absolute, as nodes have it: topics of a layout are found by their full names."""

REPLAY = "trajectory_deploy"
"""Name of the node that replays."""


def layout(rig: Rig, namespace: str = "") -> dict[str, Any]:
    """The layout of a rig whose topics are in a namespace: the scene with markers, meshes, poses and the planned path;
    a plot of each wrench and of the commanded and measured positions; pictures of cameras; diagnostics and events."""

    def full(topic: str) -> str:
        return topic if topic.startswith("/") else f"{namespace.rstrip('/')}/{topic}"

    channels = channels_of(rig, 100.0, contact_forces=True, mesh_rate_hz=MESH_RATE_HZ)
    look: dict[str, Any]
    drawn: dict[str, dict[str, Any]] = {full(f"{REPLAY}/path"): {"visible": True, "type": "line"}}
    for channel in channels.values():
        if channel.kind == "markers":
            look = {"visible": True, "colorField": "dz", "colorMode": "colormap", "pointSize": 6}
        elif channel.kind in ("pose", "mesh"):
            look = {"visible": True}
        else:
            continue
        drawn[full(channel.topic)] = look
    panels: dict[str, dict[str, Any]] = {
        "3D!scene": {
            "followTf": base_of(rig),
            "topics": drawn,
            "layers": {"urdf": {"layerId": "foxglove.Urdf", "sourceType": "topic", "topic": full("robot_description")}},
            "scene": {"transforms": {"axisScale": FRAME_S}},
        },
        "DiagnosticSummary!diagnostics": {"topicToRender": "/diagnostics", "pinnedIds": []},
        "RawMessages!events": {"topicPath": full(EVENT_TOPIC)},
    }
    for name, channel in channels.items():
        if channel.kind in ("wrench", "contact"):
            parts = [f"{full(channel.topic)}.wrench.force.{axis}" for axis in "xyz"]
            panels[f"Plot!{name}"] = plot(f"{name}: force [N]", parts)
    for name, effector in rig.end_effectors.items():
        poses = [full(topic) for topic in (effector.topics.target_pose, effector.topics.current_pose)]
        parts = [f"{topic}.pose.position.{axis}" for topic in poses for axis in "xyz"]
        panels[f"Plot!{name}"] = plot(f"{name}: position [m]", parts)
    for name, camera in rig.cameras.items():
        topics = {"imageTopic": full(camera.topics.image), "calibrationTopic": full(camera.topics.camera_info)}
        panels[f"Image!{name}"] = {"imageMode": topics}
    plots = [name for name in panels if name.startswith(("Plot", "Image"))]
    low = {"direction": "row", "first": "DiagnosticSummary!diagnostics", "second": "RawMessages!events"}
    left = {"direction": "column", "first": "3D!scene", "second": low, "splitPercentage": 75}
    shown = {"direction": "row", "first": left, "second": stacked(plots), "splitPercentage": 60} if plots else left
    return {
        "configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}, "layout": shown,
    }  # fmt: skip


def plot(title: str, paths: Sequence[str]) -> dict[str, Any]:
    """A plot of message paths over the time of their headers."""
    series = [{"value": path, "enabled": True, "timestampMethod": "headerStamp"} for path in paths]
    return {"title": title, "paths": series, "xAxisVal": "timestamp", "showLegend": True, "isSynced": True}


def stacked(names: Sequence[str]) -> Any:
    """Panels below each other, each as high."""
    if len(names) == 1:
        return names[0]
    share = 100.0 / len(names)
    return {"direction": "column", "first": names[0], "second": stacked(names[1:]), "splitPercentage": share}


@command
def main(arguments: Sequence[str]) -> None:
    """Print the layout of a rig."""
    if not 1 <= len(arguments) <= 2 or arguments[0].startswith("-"):
        raise ConfigError(
            f"A rig is needed, and a namespace may follow; {len(arguments)} are given: {' '.join(arguments)!r}.",
            "Call it as: python -m thinshell_ros.foxglove RIG [NAMESPACE]",
        )
    for namespace in arguments[1:]:
        if not NAMESPACE.fullmatch(namespace):
            raise ConfigError(
                f"{namespace!r} is no namespace of ROS.",
                "Write it with a slash before each name, names of letters, digits and _, as /left.",
            )
    print(json.dumps(layout(load_rig(arguments[0]), *arguments[1:]), indent=1))


if __name__ == "__main__":
    sys.exit(main())
