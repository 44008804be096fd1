"""``marker_node`` on the pictures that ``sim_node`` renders, both as processes of their own, and its figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_live import REST_HEIGHT_M, RIG, START_S, Client, NodeProcess

from thinshell_ros.seeing import WINDOW, Seeing

PLACE = "/seen"


def tracks(message: Any) -> dict[int, np.ndarray]:
    """Pixels and confidence of each marker of a cloud of tracks, by its number."""
    from thinshell_ros.clouds import TRACK_POINT

    points = np.frombuffer(bytes(message.data), dtype=TRACK_POINT)
    return {int(p["id"]): np.array([p["u"], p["v"], p["confidence"]]) for p in points}


def stamp(message: Any) -> int:
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


@pytest.mark.ros
def test_tracks_of_rendered_pictures_are_those_of_the_simulator(ros: None, tmp_path: Path) -> None:
    """A press that moves markers by half a pixel: the same instants, the same pixels, under numbers that stay."""
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PoseStamped
    from sensor_msgs.msg import PointCloud2
    from std_srvs.srv import Trigger

    plant = NodeProcess("sim_node", tmp_path / "plant", PLACE, rig=RIG, pictures="true", noise="false")
    remaps = {"image/compressed": "side/image/compressed", "marker_tracks": "side/found"}
    node = NodeProcess("marker_node", tmp_path / "output", PLACE, remaps=remaps, rest_images=3)
    client = Client("viewer", PLACE)
    try:
        client.listen(PoseStamped, "current_pose")
        true, found = client.listen(PointCloud2, "side/marker_tracks"), client.listen(PointCloud2, "side/found")
        client.listen(DiagnosticArray, "/diagnostics")
        client.wait(lambda: found, f"no tracks: {plant.output} {node.output}", START_S)
        client.go(REST_HEIGHT_M, REST_HEIGHT_M - 0.0011, 1.0)
        moved = stamp(true[-1])
        client.wait(lambda: stamp(found[-1]) > moved, f"no tracks of what moved: {node.output}", START_S)
        by_stamp = {stamp(m): tracks(m) for m in true}
        pairs = [(by_stamp[stamp(m)], tracks(m)) for m in found if stamp(m) in by_stamp]
        rest_true, rest = pairs[0]
        number = {k: min(rest_true, key=lambda j: float(np.linalg.norm(rest_true[j][:2] - rest[k][:2]))) for k in rest}
        assert sorted(number.values()) == sorted(rest_true) and len(rest) == 10
        for places, measured in pairs:
            assert measured.keys() == rest.keys(), "none is lost"
            assert max(np.abs(measured[k][:2] - places[number[k]][:2]).max() for k in rest) < 0.1
            assert min(values[2] for values in measured.values()) > 0.5
        last = pairs[-1][1]
        assert max(float(np.linalg.norm(last[k][:2] - rest[k][:2])) for k in rest) > 0.5
        said = client.diagnosis("marker_tracker: markers", lambda s: "10 of 10 markers are seen" in s.message)
        values = {pair.key: pair.value for pair in said.values}
        assert float(values["rate_hz"]) == pytest.approx(25.0, rel=0.05) or float(values["missed_share"]) > 0.0
        assert 0.0 < float(values["work_p50_s"]) <= float(values["latency_p99_s"])
        assert client.call(Trigger, "marker_tracker/zero", Trigger.Request()).success
        client.wait(lambda: "Following 10 markers" in node.output.partition("Following")[2], "not anew", START_S)
        assert node.stop() == 0, node.output
        assert plant.stop() == 0, plant.output
        assert "Traceback" not in node.output + plant.output
    finally:
        node.kill()
        plant.kill()
        client.node.destroy_node()


@pytest.mark.ros
def test_pictures_that_cannot_be_read_and_a_layout_that_is_none_are_said(ros: None, tmp_path: Path) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import Image

    (tmp_path / "none.json").write_text('{"reference_uv_px": [[1, 2]]}')
    bad = NodeProcess("marker_node", tmp_path / "bad", "/bad", layout=tmp_path / "none.json")
    assert bad.process.wait(START_S) == 2
    assert "holds no layout of markers: reference_uv_px has the shape (1, 2)" in bad.output
    node = NodeProcess("marker_node", tmp_path / "output", "/unread")
    client = Client("driver", "/unread")
    try:
        client.listen(DiagnosticArray, "/diagnostics")
        publisher = client.node.create_publisher(Image, "image", 1)

        def described() -> bool:
            publisher.publish(Image(encoding="bayer_rggb8", height=4, width=4, step=4, data=bytes(16)))
            return "A picture has the encoding 'bayer_rggb8': it is left out." in node.output

        client.wait(described, f"nothing is said: {node.output}", START_S)
        said = client.diagnosis("marker_tracker: markers", lambda s: "encoding 'bayer_rggb8'" in s.message)
        assert {pair.key: pair.value for pair in said.values}["unreadable"] != "0"
        assert node.stop() == 0, node.output
    finally:
        node.kill()
        client.node.destroy_node()


@pytest.mark.parametrize("rate_hz", [30.0, 60.0])
def test_rate_latency_and_missed_pictures_are_figures(rate_hz: float) -> None:
    """One picture in ten does not come; work takes 4 ms, and 20 ms of each twenty-fifth."""
    seeing = Seeing()
    assert "no picture has come" in seeing.report(3.0).message
    for k in range(2 * WINDOW):
        if k % 10 != 9:
            at = 100.0 + k / rate_hz
            work = 0.02 if k % 25 == 12 else 0.004
            seeing.take(at, at + 0.003, at + 0.003 + work, 63 if k else 30, 63, "")
    figures = seeing.figures()
    assert figures["missed_share"] == pytest.approx(0.1, abs=0.01)
    assert figures["rate_hz"] == pytest.approx(0.9 * rate_hz, rel=0.01)
    assert figures["work_p50_s"] == pytest.approx(0.004) and figures["latency_p50_s"] == pytest.approx(0.007)
    assert figures["work_p99_s"] > 0.01
    assert seeing.report(0.01).level == "ok"
    seeing.take(200.0, 200.0, 200.01, 0, 63, "in doubt")
    report = seeing.report(0.01)
    assert report.level == "warn" and report.values["given_up"] == "1"


@pytest.mark.ros
def test_a_site_may_change_the_quality_of_service_of_one_topic_and_of_no_other(ros: None, tmp_path: Path) -> None:
    from rclpy.qos import ReliabilityPolicy

    place, best = "/qualities", ReliabilityPolicy.BEST_EFFORT
    given = {
        f"qos_overrides.{place}/marker_tracks.publisher.reliability": "best_effort",
        f"qos_overrides.{place}/image.subscription.reliability": "reliable",
        f"qos_overrides.{place}/image.subscription.depth": 7,
    }
    node, client = NodeProcess("marker_node", tmp_path / "output", place, **given), Client("asker", place)
    try:
        offers = client.node.get_publishers_info_by_topic
        client.wait(lambda: offers(f"{place}/marker_tracks"), f"no tracks: {node.output}", START_S)
        assert [o.qos_profile.reliability for o in offers(f"{place}/marker_tracks")] == [best]
        asks, heard = client.node.get_subscriptions_info_by_topic, [f"{place}/image", f"{place}/image/compressed"]
        client.wait(lambda: all(asks(topic) for topic in heard), f"it does not listen: {node.output}", START_S)
        found = {t: [a.qos_profile.reliability for a in asks(f"{place}/{t}")] for t in ("image", "image/compressed")}
        assert found == {"image": [ReliabilityPolicy.RELIABLE], "image/compressed": [best]}
        assert node.stop() == 0, node.output
    finally:
        node.kill()
        client.node.destroy_node()
