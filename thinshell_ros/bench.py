"""How long a command takes to the markers that it moves, over loopback, and what is lost and kept meanwhile.

    python -m thinshell_ros.bench --seconds 60 --slow 10

Starts ``sim_node`` with a ball on a gel pad of 400 markers, commands it at 100 Hz, and lets the depth change every
0.1 s. The latency is from publishing a command of another depth to receiving the first markers that have moved half of
the way. ``--slow`` stops the physics process for so many seconds in the middle.
"""

from __future__ import annotations

import argparse
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.errors import ThinshellError, WorkerError
from thinshell_ros.command import report_error

RIG = """
name: bench
solver: {dt_s: 0.01, inertia: false}
gravity_m_s2: [0.0, 0.0, 0.0]
bodies:
  pad:
    type: gel
    shape: {type: block, size_m: [0.012, 0.012, 0.004], cells: [3, 3, 1]}
    pose: {position_m: [0.0, 0.0, 0.002]}
    material: {E_pa: 2.0e5, nu: 0.4, density_kg_m3: 1000.0}
    bonded: bottom
    mount: world
  ball: {type: rigid, shape: {type: sphere, radius_m: 0.006}, mount: probe}
end_effectors:
  probe:
    base_frame: base_link
    start: {position_m: [0.0, 0.0, 0.0105]}
    topics: {target_pose: target_pose, current_pose: current_pose}
contacts:
  - {between: [pad, ball], friction: 0.3, stiffness_pa_per_m: 1.0e9}
sensors:
  pad_markers:
    type: markers
    body: pad
    points: {face: top, grid: [20, 20]}
    frame_id: gel
    rate_hz: 100.0
    topic: markers
"""
DEPTHS_M = (0.0097, 0.0094)
COMMAND_S, CHANGE_S, START_S = 0.01, 0.1, 300.0
SETTLED_S, STILL_M, MOVED_M = 0.5, 5e-6, 1e-4
"""Markers that moved less than STILL_M for SETTLED_S have settled; a change of depth moves them by MOVED_M at least."""
SAMPLE_S = 5.0
"""Time [s] between two looks at the memory."""

TAIL_S = 3.0
"""Time [s] at the end over which the age of stamps is taken."""


@dataclass
class Heard:
    """What came. ``latencies``: of changes of depth [s]; ``ages``: wall time and age of stamps [s]."""

    latencies: list[float] = field(default_factory=list)
    ages: list[tuple[float, float]] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    level: float = float("nan")
    wanted: tuple[float, float] | None = None

    def take(self, message: Any, information: dict[str, Any]) -> None:
        """Take a cloud of markers: layout of the bag contract, dz is the sixth of ten numbers."""
        now = time.monotonic()
        self.numbers.append(information["publication_sequence_number"])
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self.ages.append((now, time.time() - stamp))
        self.level = float(np.frombuffer(message.data, dtype="<f4").reshape(-1, 10)[:, 5].min())
        if self.wanted is not None:
            since, threshold = self.wanted
            if (self.level - threshold) * np.sign(threshold - self.start) > 0.0:
                self.latencies.append(now - since)
                self.wanted = None

    def change(self, level: float) -> None:
        """A command of another depth was published, at which the markers come to ``level`` [m]."""
        self.start = self.level
        self.wanted = (time.monotonic(), 0.5 * (self.level + level))


def main() -> int:
    """Run the bench and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the run")
    parser.add_argument("--slow", type=float, default=0.0, help="stop the physics for so long in the middle [s]")
    given = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with tempfile.TemporaryDirectory() as folder:
        rig = Path(folder) / "bench.yaml"
        rig.write_text(RIG)
        command = [sys.executable, "-m", "thinshell_ros.sim_node", "--ros-args", "-p", f"rig:={rig}"]
        node = subprocess.Popen([*command, "-r", "__ns:=/bench"])
        try:
            _measure(node.pid, given.seconds, given.slow)
        except ThinshellError as error:
            return report_error(error)
        finally:
            node.send_signal(signal.SIGINT)
            node.wait()
    return 0


def _measure(pid: int, seconds: float, slow_s: float) -> None:
    import rclpy
    from geometry_msgs.msg import PoseStamped
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import PointCloud2

    rclpy.init()
    node, heard = rclpy.create_node("bench", namespace="/bench"), Heard()

    take: Any = heard.take  # rclpy looks how many arguments it has, its types know of one
    node.create_subscription(PointCloud2, "markers", take, QoSProfile(depth=100))
    publisher = node.create_publisher(PoseStamped, "target_pose", 1)

    def spin(until: float) -> None:
        while (left := until - time.monotonic()) > 0.0:
            rclpy.spin_once(node, timeout_sec=left)

    def command(height: float) -> None:
        message = PoseStamped()
        message.header.frame_id = "base_link"
        message.header.stamp = node.get_clock().now().to_msg()
        message.pose.position.z = height
        publisher.publish(message)

    begin = time.monotonic()
    while not heard.ages and time.monotonic() - begin < START_S:
        spin(time.monotonic() + 0.1)
    if not heard.ages:
        raise WorkerError(
            f"No markers came in {START_S:g} s.",
            "See what the simulator says above, and whether ROS runs over loopback.",
        )

    def settle(height: float) -> float:
        """The level [m] that the markers come to: they have moved from where they were, and then stood still."""
        before = heard.level
        begin = still = time.monotonic()
        last = before
        while time.monotonic() - still < SETTLED_S or abs(heard.level - before) < MOVED_M:
            if time.monotonic() - begin > START_S:
                raise WorkerError(
                    f"The markers did not follow a command to a height of {height:g} m in {START_S:g} s.",
                    "See what the simulator says above: the machine may be too busy.",
                )
            command(height)
            spin(time.monotonic() + COMMAND_S)
            if abs(heard.level - last) > STILL_M:
                last, still = heard.level, time.monotonic()
        return heard.level

    levels = [settle(height) for height in DEPTHS_M]
    physics = _physics(pid)
    heard.latencies, heard.ages, heard.numbers = [], [], []
    memory = [_rss_mb(pid) + _rss_mb(physics)]
    worked = _worked_s(pid), _worked_s(physics)
    begin, due, changed, deep, stopped = time.monotonic(), time.monotonic(), 0.0, 1, None
    sampled = begin
    while (now := time.monotonic()) - begin < seconds or not heard.latencies:
        if now - begin > seconds + START_S:
            raise WorkerError(
                f"No command of another depth was followed by the markers in {seconds + START_S:.0f} s.",
                "See what the simulator says above: the machine may be too busy.",
            )
        if slow_s and stopped is None and now - begin > 0.5 * (seconds - slow_s):
            os.kill(physics, signal.SIGSTOP)
            stopped, heard.wanted = now, None
        if stopped and now - stopped > slow_s:
            os.kill(physics, signal.SIGCONT)
            stopped, slow_s = 0.0, 0.0
        if now - changed > CHANGE_S and not stopped and heard.wanted is None:
            deep, changed = 1 - deep, now
            command(DEPTHS_M[deep])
            heard.change(levels[deep])
        else:
            command(DEPTHS_M[deep])
        due = max(due + COMMAND_S, now)
        spin(due)
        if now - sampled > SAMPLE_S:
            sampled = now
            memory.append(_rss_mb(pid) + _rss_mb(physics))
    taken = time.monotonic() - begin
    node_s, physics_s = _worked_s(pid) - worked[0], _worked_s(physics) - worked[1]
    lost = int(np.diff(heard.numbers).sum()) - (len(heard.numbers) - 1)
    tail = [age for at, age in heard.ages if at > time.monotonic() - TAIL_S]
    memory.append(_rss_mb(pid) + _rss_mb(physics))
    p50, p99 = np.percentile(heard.latencies, [50, 99]) * 1e3
    print(f"command to markers: p50 {p50:.1f} ms, p99 {p99:.1f} ms of {len(heard.latencies)} changes")
    print(f"markers: {len(heard.numbers)} received in {taken:.1f} s, {lost} lost")
    aged = f"median {1e3 * np.median(tail):.1f} ms" if tail else "no markers came"
    print(f"age of stamps in the last {TAIL_S:g} s: {aged}")
    half = np.mean(memory[len(memory) // 2 :])
    print(
        f"memory of node and physics: {memory[0]:.1f} MB at the start, {half:.1f} MB in the second half on average, "
        f"{memory[-1]:.1f} MB at the end"
    )
    each = 1e3 / len(heard.numbers)
    print(
        f"processor time for each cloud of markers: {each * node_s:.2f} ms of the node, {each * physics_s:.2f} ms of "
        "the physics"
    )
    print(f"machine: {machine()}")
    node.destroy_node()
    rclpy.try_shutdown()


def machine() -> str:
    """The processor, its cores, and how many processes want to run."""
    names = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    model = names[0].partition(":")[2].strip() if names else platform.machine()
    return f"{model}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"


def _physics(pid: int) -> int:
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return next(int(p) for p in children if "spawn_main" in Path(f"/proc/{p}/cmdline").read_text())


def _worked_s(pid: int) -> float:
    """Processor time of a process up to now [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _rss_mb(pid: int) -> float:
    fields = Path(f"/proc/{pid}/statm").read_text().split()
    return int(fields[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    sys.exit(main())
