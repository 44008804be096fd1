"""Tasks begin at rest: the block has sunk onto the card, the ball lies in the sheet that is held."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_task import TASK, small_task

from sim_core.errors import ConfigError
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sim_core.tasks import TaskRollouts, load_task
from sim_core.tasks.episode import frames_at
from sim_core.tasks.measure import FORCE
from sim_core.tasks.rest import resting_state


@pytest.fixture(scope="module")
def lifting() -> TaskRollouts:
    return TaskRollouts(load_task("lifting"))


def test_nothing_moves_before_the_hands_do(lifting: TaskRollouts) -> None:
    """The rig puts the block above the card and the card above the fingers: both would sink by a millimetre."""
    poses = lifting.poses(np.zeros(lifting.space.size))
    put = lifting.scene.rest[lifting.scene.bodies["block"].nodes].mean(axis=0)
    lifting.begin(poses)
    start = lifting.episode.simulation.state.x.copy()
    for _ in range(3):  # hands that stay where they are
        lifting.episode.simulation.step({}, lifting.made.task.step_s)
    moved = lifting.episode.simulation.state.x - start
    assert np.abs(moved).max() < 2e-8  # at most 1 um/s
    sunk = start[lifting.scene.bodies["block"].nodes].mean(axis=0) - put
    assert sunk[2] < -5e-4


def test_what_rests_is_where_time_alone_takes_it(lifting: TaskRollouts) -> None:
    """The same by steps of 5 ms for a second, without the longer ones."""
    simulation = Simulation(lifting.scene)
    for _ in range(200):
        simulation.step({}, 0.005)
    poses = lifting.poses(np.zeros(lifting.space.size))
    lifting.begin(poses)
    assert np.abs(lifting.episode.simulation.state.x - simulation.state.x).max() < 2e-5
    # So a robot whose bench has stood for a second reads what is predicted, to a fifth of the noise of 2 mN.
    assert not lifting.advance(poses, 20)
    for k in range(1, 21):
        simulation.step(frames_at(poses, k), lifting.made.task.step_s)
        read, predicted = simulation.read(), lifting.episode.readings[k]
        for finger in lifting.fingers:
            assert np.abs(read[f"{FORCE}{finger}"][:3] - predicted[f"{FORCE}{finger}"][:3]).max() < 4e-4


def test_the_gradient_from_rest_is_that_of_central_differences(lifting: TaskRollouts) -> None:
    """The reward depends on where the block rests at the start, too."""
    rng = np.random.default_rng(4)
    action, along = 0.05 * rng.standard_normal((2, lifting.space.size))
    found = lifting.gradient(action)
    assert found.gradient is not None
    assert found.reward == pytest.approx(lifting.outcome(action).reward, rel=1e-6)
    h = 1e-3
    ends = [lifting.outcome(action + s * h * along).reward for s in (1.0, -1.0)]
    assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(float(found.gradient @ along), rel=2e-3)


def test_the_trace_begins_where_rollouts_do(lifting: TaskRollouts) -> None:
    """So the prediction of a replay has no transient that a robot at rest does not have."""
    action = np.zeros(lifting.space.size)
    trace = lifting.trace(action)
    lifting.begin(lifting.poses(action))
    assert trace.states is not None
    np.testing.assert_array_equal(trace.states.positions[0], lifting.episode.simulation.state.x)
    forces = trace.outputs["wrench_left"][:2, 2]
    assert abs(forces[0]) > 0.01 and forces[1] == pytest.approx(forces[0], rel=0.02)


def test_what_falls_is_reported(tmp_path: Path) -> None:
    made = load_task("separating")
    bodies = {**made.rig.bodies}
    del bodies["table"]
    contacts = tuple(c for c in made.rig.contacts if "table" not in c.between)
    scene = build_scene(made.rig.model_copy(update={"bodies": bodies, "contacts": contacts}))
    with pytest.raises(ConfigError, match=r"Nothing comes to rest .*(card|block) moves at .* mm/s.*begins: held"):
        resting_state(scene, {}, 0.005, [])


def test_what_is_held_begins_with_the_approach_made(tmp_path: Path) -> None:
    free, held = (small_task(tmp_path, text=TASK + more) for more in ("", "begins: held\n"))
    one, other = (TaskRollouts(made).space for made in (free, held))
    assert other.first == 0 and one.first > 0
    action = np.zeros(one.size)
    np.testing.assert_allclose(
        other.poses(action)["finger"].positions[0], one.poses(action)["finger"].positions[one.first], atol=1e-12
    )
