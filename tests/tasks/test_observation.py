"""What is seen of a task: each part of an observation against the scene that it is of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from small_task import small_task, touch_sensor

from sim_core.tasks.environment import MOST, TaskEnv
from sim_core.tasks.observation import MARKER_M, SEEN_NODES

STEP_M, STEP_DEG, STEP_S, STEPS = 0.0012, 1.0, 0.01, 8
"""Of the actions of the small task."""

MARKERS = """  dots:
    type: markers
    body: gel
    points: {face: top, grid: [2, 2]}
    frame_id: dots
    rate_hz: 100.0
    noise: {position_m: 1.0e-9}
    topic: dots
"""


def test_a_state_has_what_hands_and_bodies_have_done_since_the_start(tmp_path: Path) -> None:
    small_task(tmp_path)
    env = TaskEnv(str(tmp_path / "small.yaml"), 3)
    first, _ = env.reset(seed=0)
    simulation = env.rollouts.episode.simulation
    card = env.rollouts.scene.bodies["card"].nodes
    before, (origin, turn) = simulation.state.x[card].copy(), simulation.frames["finger"]
    assert np.all(first[: 6 + 3 * SEEN_NODES] == 0.0), "nothing has moved"
    seen, *_ = env.step(np.array([0.2, 0.0, -0.4, 0.0, 0.3, 0.0]))
    simulation = env.rollouts.episode.simulation
    length, turned = 0.25 * STEPS * STEP_M, 0.25 * STEPS * np.radians(STEP_DEG)
    position, rotation = simulation.frames["finger"]
    assert abs(seen[0]) > 0.01 and abs(seen[4]) > 0.01
    np.testing.assert_allclose(seen[:3] * length, position - origin, atol=1e-9)
    np.testing.assert_allclose(seen[3:6] * turned, (rotation * turn.inv()).as_rotvec(), atol=1e-8)
    moved = seen[6 : 6 + 3 * SEEN_NODES].reshape(-1, 3) * length
    speeds = seen[6 + 3 * SEEN_NODES : 6 + 6 * SEEN_NODES].reshape(-1, 3) * STEP_M / STEP_S
    everywhere = np.hstack([simulation.state.x[card] - before, simulation.state.v[card]])
    assert np.abs(moved).max() > 1e-5 and np.abs(speeds).max() > 1e-4
    for k in range(SEEN_NODES):
        of_node = np.concatenate([moved[k], speeds[k]])
        assert np.abs(everywhere - of_node).max(axis=1).min() < 1e-6
    force = env.rollouts.episode.readings[-1]
    assert any(np.allclose(seen[-4:-1] * env.made.stop.most_force_n, v[:3], atol=1e-7) for v in force.values())


def test_nodes_that_are_seen_are_far_apart(tmp_path: Path) -> None:
    """16 of 21 nodes in a grid of 1 cm: the corners are among them, and no two are the same."""
    from sim_core.tasks.observation import _seen_nodes

    small_task(tmp_path)
    rollouts = TaskEnv(str(tmp_path / "small.yaml"), 3).rollouts
    chosen = _seen_nodes(rollouts, "card")
    x = rollouts.episode.simulation.state.x
    assert len(chosen) == SEEN_NODES and pdist(x[chosen]).min() > 0.009
    nodes = np.asarray(rollouts.scene.bodies["card"].nodes)
    away = np.abs(x[nodes, :2])
    corners = nodes[np.all(away > away.max(axis=0) - 1e-3, axis=1)]
    assert len(corners) == 4 and set(corners) <= set(chosen)


def test_markers_are_seen_from_where_they_are_nominally(tmp_path: Path) -> None:
    """On another material they are elsewhere from the start on."""
    small_task(tmp_path)
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig.read_text() + touch_sensor(0.05, 1e-5) + MARKERS)
    env = TaskEnv(str(tmp_path / "small.yaml"), 3, observe="sensors")
    nominal = env.rollouts.episode.readings[-1]["dots"].copy()
    first, _ = env.reset(seed=1)
    assert np.abs(first[12:-1]).max() < 1e-4
    softer, _ = env.reset(seed=1, options={"parameters": {"gel.E_pa": 5.0e4}})
    moved = env.rollouts.episode.readings[-1]["dots"] - nominal
    assert np.abs(moved).max() > 1e-7
    np.testing.assert_allclose(softer[12:-1] * MARKER_M, moved.ravel(), atol=1e-8)


def test_what_is_seen_is_bounded(tmp_path: Path) -> None:
    small_task(tmp_path)
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig.read_text() + touch_sensor(1000.0, 1e-5))
    env = TaskEnv(str(tmp_path / "small.yaml"), 3, observe="sensors")
    seen, _ = env.reset(seed=1)
    assert env.observation_space.contains(seen)
    assert np.abs(seen).max() == pytest.approx(MOST)
