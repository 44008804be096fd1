"""Nodes over loopback: ``simulator`` is one running ``sim_node`` for all tests, ``client`` talks to it, and
``record_press`` records a press of its rig.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from ros_live import REST_HEIGHT_M, RIG, START_S, Client, NodeProcess, is_alive, listen_to_rig

_ENVIRONMENT = {
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    "ROS_DOMAIN_ID": str(1 + os.getpid() % 101),
    "ROS_PYTHON_CHECK_FIELDS": "1",
}


@pytest.fixture(scope="session")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """ROS over loopback for this test session; skips where there is none."""
    pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")
    import rclpy

    with pytest.MonkeyPatch.context() as patch:
        for key, value in _ENVIRONMENT.items():
            patch.setenv(key, value)
        patch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("ros_log")))
        patch.delenv("RMW_IMPLEMENTATION", raising=False)
        rclpy.init()
        yield
        rclpy.try_shutdown()


@pytest.fixture(scope="session")
def simulator(ros: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeProcess]:
    """A ``sim_node`` that is ready; it must end with code 0 when it is interrupted."""
    node = NodeProcess("sim_node", tmp_path_factory.mktemp("sim") / "output", rig=RIG)
    try:
        end = time.monotonic() + START_S
        while "Simulating" not in node.output:
            assert node.process.poll() is None, node.output
            assert time.monotonic() < end, node.output
            time.sleep(0.1)
        yield node
        physics = node.spawned()
        assert node.stop() == 0, node.output
        assert not is_alive(physics), "the physics process is left over"
    finally:
        node.kill()


@pytest.fixture
def client(simulator: NodeProcess) -> Iterator[Client]:
    """A client that hears the simulator, which is back at its start; between tests that stands still."""
    from std_srvs.srv import SetBool, Trigger

    client = Client("client")
    listen_to_rig(client)
    client.call(SetBool, "thinshell_sim/pause", SetBool.Request(data=False))
    assert client.call(Trigger, "thinshell_sim/reset", Trigger.Request()).success
    for topic in client.heard:
        client.wait(lambda topic=topic: client.heard[topic], f"nothing on {topic}")  # type: ignore[misc]
    yield client
    client.call(SetBool, "thinshell_sim/pause", SetBool.Request(data=True))
    client.node.destroy_node()


@pytest.fixture
def record_press(client: Client, tmp_path: Path) -> Callable[[Path], dict[str, int]]:
    """Function that records a press of 0.6 mm and its release into a bag.

    It returns how many messages of each topic the client heard between the first recorded target and the
    end of the motion; the bag holds at least as many. Rig: ``RIG``.
    """

    def record(bag: Path) -> dict[str, int]:
        recorder = NodeProcess("record_node", tmp_path / "recorder", rig=RIG, uri=bag)
        try:
            topics = ["target_pose", *(t for t in client.heard if not t.startswith("/"))]
            client.aim(REST_HEIGHT_M)

            def all_recorded() -> bool:
                client.aim(REST_HEIGHT_M)
                return all(f"Recording /{topic} " in recorder.output for topic in topics)

            client.wait(all_recorded, f"the recorder did not find all topics: {recorder.output}")
            reports = client.heard["/diagnostics"]
            seen = len(reports)

            def flowing() -> bool:
                client.aim(REST_HEIGHT_M)
                statuses = [s for m in reports[seen:] for s in m.status if s.name.endswith("recorder: recording")]
                return any("no message yet" not in s.message for s in statuses)

            client.wait(flowing, f"not all topics are recorded: {recorder.output}")
            before = {topic: len(messages) for topic, messages in client.heard.items()}
            client.go(REST_HEIGHT_M, REST_HEIGHT_M - 0.0011, 1.0)
            client.simulate(0.3)
            client.go(REST_HEIGHT_M - 0.0011, REST_HEIGHT_M, 1.0)
            after = {topic: len(messages) for topic, messages in client.heard.items()}
            assert recorder.stop() == 0, recorder.output
            return {topic: after[topic] - before[topic] for topic in before}
        finally:
            recorder.kill()

    return record
