"""Nodes as processes of their own, and a client that talks to them."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

RIG = Path(__file__).parent / "data" / "press_gel.yaml"
REST_HEIGHT_M = 0.0105
"""Height of the ball's centre at the start; it touches the pad 0.5 mm lower."""

START_S = 240.0
"""The physics process compiles its kernels first, on a machine that may be busy."""

ASK_AGAIN_S = 4.0
"""Time after which a service that has not answered is asked again."""

WAIT_S = 120.0
"""Longest time for an answer: reached only by what fails, however slow the machine."""


def is_alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and whose parent has not noticed does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def group(leader: int) -> list[int]:
    """Numbers of the processes that run in the group of a process."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, number = (folder / "stat").read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue  # it has just ended
        if int(number) == leader and state != "Z":
            found.append(int(folder.name))
    return found


class NodeProcess:
    """A node started as a user would, with its output in a file. ``module``: of thinshell_ros, or a script.

    As a context manager: it must end with code 0 when it is interrupted at the end, and say no traceback.
    """

    def __init__(
        self,
        module: str,
        log: Path,
        namespace: str = "/",
        *,
        remaps: Mapping[str, str] | None = None,
        **parameters: Any,
    ) -> None:
        self._log = log
        program = [module] if module.endswith(".py") else ["-m", f"thinshell_ros.{module}"]
        command = [sys.executable, *program, "--ros-args", "-r", f"__ns:={namespace}"]
        for name, topic in (remaps or {}).items():
            command += ["-r", f"{name}:={topic}"]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={value}"]
        with log.open("w") as output:
            self.process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            if error is None:
                assert self.stop() == 0, self.output
                assert "Traceback" not in self.output, self.output
        finally:
            self.kill()

    @property
    def output(self) -> str:
        """What the node has printed."""
        return self._log.read_text()

    def spawned(self) -> int:
        """Number of the process that the node spawns for its work; 0 before."""
        pid = self.process.pid
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        spawned = (int(p) for p in children if "spawn_main" in Path(f"/proc/{p}/cmdline").read_text())
        return next(spawned, 0)

    def stop(self, number: int = signal.SIGINT) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.process.wait(WAIT_S)

    def kill(self) -> None:
        """End it if it still runs."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


class Client:
    """A node in this process: keeps what it hears, sends targets, calls services. Names are below ``namespace``."""

    def __init__(self, name: str, namespace: str = "/") -> None:
        import rclpy

        self.node = rclpy.create_node(name, namespace=namespace)
        self._publishers: dict[str, Any] = {}
        self.heard: dict[str, list[Any]] = {}

    def listen(self, kind: Any, topic: str, *, latched: bool = False) -> list[Any]:
        """Messages of a topic from now on."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        messages: list[Any] = []
        self.heard[topic] = messages
        quality = QoSProfile(depth=100, durability=durability)
        self.node.create_subscription(kind, topic, messages.append, quality)
        return messages

    def spin(self, seconds: float) -> None:
        """Let messages come in for some time."""
        import rclpy

        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            rclpy.spin_once(self.node, timeout_sec=left)

    def simulate(self, seconds: float) -> None:
        """Let simulated time go on, however long the machine takes: ``current_pose`` comes every 10 ms of it."""
        poses = self.heard["current_pose"]
        enough = len(poses) + round(100.0 * seconds)
        self.wait(lambda: len(poses) >= enough, "simulated time stands still", START_S)

    def wait(self, condition: Callable[[], Any], what: str, timeout_s: float = WAIT_S) -> Any:
        """Let messages come in until a condition holds; returns its value."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            if value := condition():
                return value
            self.spin(0.02)
        raise AssertionError(f"after {timeout_s:g} s: {what}")

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Response of a service.

        Asked again after a while: a server that has not discovered the client yet replies into the void. All
        services may be called twice.
        """
        client = self.node.create_client(kind, name)
        futures: list[Any] = []

        def answered() -> Any:
            if time.monotonic() > asked + ASK_AGAIN_S * len(futures):
                futures.append(client.call_async(request))
            return next((future for future in futures if future.done()), None)

        try:
            self.wait(client.service_is_ready, f"no service {name}")
            asked = time.monotonic()
            return self.wait(answered, f"no answer of {name}").result()
        finally:
            self.node.destroy_client(client)

    def diagnosis(self, name: str, condition: Callable[[Any], Any], timeout_s: float = WAIT_S) -> Any:
        """The next status whose name ends so and that fulfils a condition."""
        heard = self.heard["/diagnostics"]
        seen = len(heard)

        def wanted() -> Any:
            statuses = (s for m in heard[seen:] for s in m.status if s.name.endswith(name))
            return next((s for s in statuses if condition(s)), None)

        return self.wait(wanted, f"no such status of {name}", timeout_s)

    def aim(self, z: float, *, frame: str = "base_link", **changes: float) -> None:
        """Send one target at a height [m]; ``changes``: of x, y, qx, qy, qz, qw."""
        from geometry_msgs.msg import PoseStamped

        if "target" not in self._publishers:
            self._publishers["target"] = self.node.create_publisher(PoseStamped, "target_pose", 1)
        publisher = self._publishers["target"]
        self.wait(publisher.get_subscription_count, "nobody takes targets")
        message = PoseStamped()
        message.header.frame_id = frame
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.pose.position.z = z
        for key, value in changes.items():
            part = message.pose.orientation if key.startswith("q") else message.pose.position
            setattr(part, key.removeprefix("q"), value)
        publisher.publish(message)

    def go(self, start_m: float, end_m: float, seconds: float) -> None:
        """Send targets from one height to another at 50 Hz, until the end effector is there."""
        begin = time.monotonic()
        while (share := (time.monotonic() - begin) / seconds) < 1.0:
            self.aim(start_m + share * (end_m - start_m))
            self.spin(0.02)

        def there() -> bool:
            self.aim(end_m)
            poses = self.heard["current_pose"]
            return bool(poses) and abs(poses[-1].pose.position.z - end_m) < 1e-9

        self.wait(there, f"the end effector did not get to {end_m:g} m")


def listen_to_rig(client: Client) -> None:
    """Listen to everything that the rig of these tests publishes."""
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PoseStamped, WrenchStamped
    from sensor_msgs.msg import CameraInfo, PointCloud2

    client.listen(PoseStamped, "current_pose")
    client.listen(WrenchStamped, "tactile/left/wrench")
    client.listen(PointCloud2, "tactile/left/markers")
    client.listen(PointCloud2, "tactile/left/markers_rest", latched=True)
    client.listen(PointCloud2, "side/marker_tracks")
    client.listen(CameraInfo, "side/camera_info")
    client.listen(DiagnosticArray, "events")
    client.listen(DiagnosticArray, "/diagnostics")
