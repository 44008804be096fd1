"""From a task to a replay: a motion that was optimised over what a fit leaves open is replayed on ``sim_node``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_live import START_S, NodeProcess
from ros_replayer import SLOW_PLANT, Replayer, execute
from scipy.spatial.transform import Rotation
from scipy.stats import t as student
from small_task import RIG, TASK, touch_sensor

from sim_core.optimise.posterior import posterior_draws
from sim_core.rigs import load_rig, rig_to_yaml, with_parameters
from sim_core.trajectories import Trajectory, read_trajectory, rollout
from sysid.cli.app import main

pytestmark = [pytest.mark.ros, pytest.mark.slow]

PLACE = "/found"
NOISE_N = 2e-4
DRAWS = 8
SD = 0.1
"""Standard deviation of the logarithm of the card's modulus, as of a fit."""

SENSORS = touch_sensor(NOISE_N, 1.0e-7)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an optimisation of the small task, at rest in each step, over draws of a fit."""
    folder = tmp_path_factory.mktemp("optimised")
    # Little friction: what rubs depends on the length of steps, which is another one in a replay that is slow.
    rig = RIG.replace("inertia: true", "inertia: false").replace("friction: 0.4", "friction: 0.05")
    assert rig.count("inertia: false") == rig.count("friction: 0.05") == 1
    (folder / "rig.yaml").write_text(rig + SENSORS)
    task = TASK.replace("RIG", str(folder / "rig.yaml")).replace("REWARD", "folding")
    (folder / "small.yaml").write_text(task)
    fit = {"estimates": [{"name": "card.E_pa", "value": 2e9, "sd": SD, "log": True}], "correlation": [[1.0]]}
    (folder / "fit.json").write_text(json.dumps(fit))
    command = ["optimise", str(folder / "small.yaml"), "--method", "gradient", "--budget", "2", "--workers", "1"]
    posterior = ["--posterior", str(folder / "fit.json"), "--draws", str(DRAWS)]
    assert main([*command, *posterior, "--out", str(folder / "run")]) == 0
    return folder / "run"


@pytest.fixture(scope="module")
def plant(ros: None, run: Path) -> Iterator[NodeProcess]:
    """A ``sim_node`` of a rig whose card is stiffer than the fit says, by 1.2 standard deviations."""
    truth = with_parameters(load_rig(str(run / "rig.yaml")), {"card.E_pa": 2e9 * np.exp(1.2 * SD)})
    (run.parent / "plant.yaml").write_text(rig_to_yaml(truth))
    node = NodeProcess("sim_node", run.parent / "plant.log", PLACE, rig=run.parent / "plant.yaml")
    try:
        yield node
    finally:
        node.kill()


def test_the_prediction_is_the_mean_and_the_spread_of_rollouts_of_the_draws(run: Path) -> None:
    trajectory, rig = read_trajectory(run / "trajectory.json"), load_rig(str(run / "rig.yaml"))
    draws = posterior_draws(run.parent / "fit.json", rig, DRAWS, 0)
    rollouts = [rollout(with_parameters(rig, d), trajectory.poses()) for d in draws]
    forces = np.stack([t.at("touch", trajectory.times_s)[:, :3] for t in rollouts])
    predicted = trajectory.predicted.wrenches["touch"]
    assert predicted.force_sds_n is not None
    size = np.abs(forces).max()
    np.testing.assert_allclose(predicted.forces_n, forces.mean(axis=0), atol=1e-5 * size)
    np.testing.assert_allclose(predicted.force_sds_n, forces.std(axis=0, ddof=1), atol=1e-5 * size)
    assert predicted.force_sds_n.max() > 0.02 * size


def place_of(pose: Any) -> np.ndarray:
    """Position [m], and rotation vector as what it moves 10 mm away [m], of a message: ``(6,)``."""
    p, q = pose.position, pose.orientation
    return np.array([p.x, p.y, p.z, *(0.01 * Rotation.from_quat([q.x, q.y, q.z, q.w]).as_rotvec())])


def when(places: np.ndarray, trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Times of the trajectory [s] at which it is nearest to places ``(n, 6)`` in the order in which they were passed,
    and how near [m]."""
    fine = np.linspace(0.0, trajectory.times_s[-1], 4001)
    position, quaternion = trajectory.poses()["finger"].sample(fine)
    way = np.hstack([position, 0.01 * Rotation.from_quat(quaternion).as_rotvec()])
    at, found = 0, []
    for place in places:
        distance = np.linalg.norm(way[at:] - place, axis=1)
        at += int(np.flatnonzero(distance <= distance.min() + 1e-9)[0])
        found.append((fine[at], distance.min()))
    times, near = np.array(found).T
    return times, near


def test_the_plant_follows_and_reads_what_was_predicted(run: Path, plant: NodeProcess, tmp_path: Path) -> None:
    from geometry_msgs.msg import WrenchStamped
    from std_srvs.srv import Trigger

    trajectory = read_trajectory(run / "trajectory.json")
    given: dict[str, Any] = {
        "trajectory_uri": run / "trajectory.json", "rig": run / "rig.yaml", "dry_run": "false", "record": "false",
        "workspace_min_m": "[-0.05, -0.05, -0.05]", "workspace_max_m": "[0.05, 0.05, 0.05]", "speed_scale": 0.03,
        "tracking_tolerance_m": 0.002, "clock_tolerance_s": 4.0, "guard_markers": "false", **SLOW_PLANT,
    }  # fmt: skip
    process = NodeProcess("replay_node", tmp_path / "output", PLACE, **given)
    client = Replayer(process, PLACE, PLACE, PLACE)
    wrenches = client.listen(WrenchStamped, f"{PLACE}/touch/wrench")
    try:
        client.wait(lambda: client.statuses, f"no status: {process.output}", START_S)
        client.wait(lambda: client.poses, f"no pose: {plant.output}", START_S)
        start, lowest = (trajectory.end_effectors["finger"].positions_m[:, k] for k in (0, 2))
        where = {"x": float(start[0]), "y": float(trajectory.end_effectors["finger"].positions_m[0, 1])}
        for height in (lowest[0] - 0.0015, lowest[0]):  # what a contact needs is compiled before
            client.aim(height, **where)
            client.wait(lambda z=height: abs(client.poses[-1].pose.position.z - z) < 1e-9, "it stays", START_S)
        client.node.destroy_publisher(client._publishers.pop("target"))
        assert client.call(Trigger, "thinshell_sim/reset", Trigger.Request()).success
        client.spin(1.0)
        assert client.change("configure"), process.output
        assert client.change("activate"), process.output
        client.poses.clear()
        wrenches.clear()
        execute(client)
        ended = client.until("succeeded", "aborted")
        client.spin(1.0)
        assert ended["state"] == "succeeded", ended["detail"]
        assert process.stop() == 0, process.output
    finally:
        process.kill()
        client.node.destroy_node()

    def stamps(messages: list[Any]) -> np.ndarray:
        return np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in messages])

    places = np.array([place_of(m.pose) for m in client.poses])
    times, near = when(places, trajectory)
    way = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    assert near.max() < 2e-5 and way > 1e-3
    assert times[0] < 0.1 * trajectory.times_s[-1] and times[-1] == pytest.approx(trajectory.times_s[-1], rel=1e-3)

    heard = stamps(wrenches)
    within = (heard >= stamps(client.poses)[0]) & (heard <= stamps(client.poses)[-1])
    forces = np.array([[m.wrench.force.x, m.wrench.force.y, m.wrench.force.z] for m in wrenches])[within]
    at = np.interp(heard[within], stamps(client.poses), times)
    predicted = trajectory.predicted.wrenches["touch"]
    assert predicted.force_sds_n is not None

    def resampled(values: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(at, trajectory.times_s, column) for column in values.T])

    off = forces - resampled(predicted.forces_n)
    # The mean and the standard deviation are themselves of a few draws: Student's t for the next one.
    most = float(student.ppf(0.99865, DRAWS - 1)) * np.sqrt(1.0 + 1.0 / DRAWS)
    sds = resampled(predicted.force_sds_n)
    inside = np.abs(off) < np.sqrt((most * sds) ** 2 + (3.0 * NOISE_N) ** 2)
    assert len(off) > 100 and inside.mean() > 0.98
    # The plant is not the rig: it takes what the draws spread to say so.
    assert (np.abs(off) < 3.0 * NOISE_N).all(axis=1).mean() < 0.8
