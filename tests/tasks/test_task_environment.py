"""Tasks as Gymnasium environments."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from small_task import TASK, small_task, touch_sensor

from sim_core.errors import ConfigError
from sim_core.tasks.environment import FAILED, TaskEnv
from sim_core.tasks.observation import FORCE_N, TORQUE_NM
from sim_core.tasks.vector_environment import TaskVectorEnv


def small_env(folder: Path, **options: object) -> TaskEnv:
    small_task(folder)
    return TaskEnv(str(folder / "small.yaml"), 3, **options)  # type: ignore[arg-type]


def episode(env: TaskEnv, seed: int) -> tuple[list[np.ndarray], list[float], dict[str, object]]:
    observation, info = env.reset(seed=seed)
    seen, gained, over = [observation], [], False
    rng = np.random.default_rng(7)
    while not over:
        observation, reward, over, _, info = env.step(rng.uniform(-1.0, 0.2, env.action_space.shape))
        seen.append(observation)
        gained.append(reward)
    return seen, gained, info


@pytest.mark.filterwarnings("ignore:.*render.*")
def test_gymnasium_finds_nothing_wrong(tmp_path: Path) -> None:
    check_env(small_env(tmp_path), skip_render_check=True)


def test_a_seed_determines_an_episode_and_its_parameters(tmp_path: Path) -> None:
    vary = {"card.E_pa": (1.5e9, 2.5e9)}
    env = small_env(tmp_path, vary=vary)
    first, gained, info = episode(env, 5)
    episode(env, 6)
    again, regained, same = episode(small_env(tmp_path, vary=vary), 5)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True)) and gained == regained
    assert info["parameters"] == same["parameters"] != episode(env, 6)[2]["parameters"]
    fixed, _ = env.reset(seed=5, options={"parameters": {"card.E_pa": 1.7e9}})
    assert env.reset(seed=6, options={"parameters": {"card.E_pa": 1.7e9}})[0].tolist() == fixed.tolist()


def test_an_episode_is_a_rollout_of_the_task(tmp_path: Path) -> None:
    """Its return is what the reward of the same action says, and its last observation is one of order one."""
    env = small_env(tmp_path)
    seen, gained, info = episode(env, 0)
    outcome = env.rollouts.outcome(env.action_so_far)
    assert outcome.reward == info["reward"] and not outcome.stopped
    env.reset(seed=0)
    start = env.rollouts.scored().reward
    assert sum(gained) == pytest.approx((outcome.reward - start) / abs(env.made.variant.success - start), rel=1e-9)
    assert seen[-1][-1] == 1.0 and 0.3 < np.abs(seen[-1][:-1]).max() < 10.0
    assert len(gained) == 3 and len(seen) == 4


def test_progress_towards_the_best_reward_counts_halved_distances_alike(tmp_path: Path) -> None:
    """A return is 1 where just a success is left to go to the best reward, and does not rise without end."""
    text = TASK.replace("success: 0.05", "success: -1.0e-6").replace("variants:", "best: 0.0\nvariants:")
    small_task(tmp_path, "forming", text)
    env = TaskEnv(str(tmp_path / "small.yaml"), 3)
    _, gained, info = episode(env, 0)
    env.reset(seed=0)
    start = env.rollouts.scored().reward
    assert start < -1.0e-6 and info["reward"] != start
    assert sum(gained) == pytest.approx(np.log(start / info["reward"]) / np.log(start / -1.0e-6), rel=1e-9)
    assert env._progress(-1.0e-6) == pytest.approx(1.0)
    assert env._progress(0.0) == env._progress(-1.0e-8) == pytest.approx(1.0 + np.log(100.0) / np.log(start / -1.0e-6))


@pytest.mark.parametrize("reach", [0.0, -0.1, 1.5, float("nan")])
def test_decisions_that_change_nothing_or_too_much_are_refused(tmp_path: Path, reach: float) -> None:
    with pytest.raises(ConfigError, match=rf"reach is {reach:g}.*above 0 and at most 1"):
        small_env(tmp_path, reach=reach)


def test_environments_on_threads_do_what_they_do_alone(tmp_path: Path) -> None:
    """To the bit, into the episodes after the first one."""
    vary = {"card.E_pa": (1.5e9, 2.5e9)}
    alone = [small_env(tmp_path, vary=vary) for _ in range(3)]
    each = gymnasium.vector.SyncVectorEnv([lambda env=env: env for env in alone])  # type: ignore[misc]
    many = TaskVectorEnv(str(tmp_path / "small.yaml"), 3, decisions=3, vary=vary, workers=2)
    assert many.action_space == each.action_space and many.observation_space == each.observation_space
    rng, found, ends = np.random.default_rng(7), [], 0
    for envs in (many, each):
        seen, info = envs.reset(seed=3)
        found.append([seen.copy(), info["parameters"]["card.E_pa"]])
    for _ in range(6):
        actions = rng.uniform(-1.0, 0.2, each.action_space.shape)
        (seen, gained, over, cut, info), own = (envs.step(actions) for envs in (many, each))
        assert all(np.array_equal(a, b) for a, b in zip((seen, gained, over, cut), own[:4], strict=True))
        np.testing.assert_array_equal(info["reward"], own[4]["reward"])
        ends += int(over.sum())
    assert all(np.array_equal(a, b) for a, b in zip(*found, strict=True)) and len(set(found[0][1])) == 3
    assert ends == 3, "each went on into a second episode"
    many.close()


def test_an_episode_that_is_over_may_give_way_to_the_next_at_once(tmp_path: Path) -> None:
    """As libraries of reinforcement learning want it: with its end in the info."""
    small_task(tmp_path)
    name, rng = str(tmp_path / "small.yaml"), np.random.default_rng(7)
    many = TaskVectorEnv(name, 2, 1, AutoresetMode.SAME_STEP, decisions=3)
    late = TaskVectorEnv(name, 2, 1, decisions=3)
    begun, _ = many.reset(seed=3)
    late.reset(seed=3)
    for _ in range(3):
        actions = rng.uniform(-1.0, 0.2, many.action_space.shape)
        seen, gained, over, _, info = many.step(actions)
        last, own, _, _, end = late.step(actions)
    assert over.all() and np.array_equal(seen, begun) and np.array_equal(gained, own)
    assert all(np.array_equal(a, b) for a, b in zip(info["final_obs"], last, strict=True))
    np.testing.assert_array_equal(info["final_info"]["reward"], end["reward"])
    with pytest.raises(ConfigError, match="NEXT_STEP or SAME_STEP"):
        TaskVectorEnv(name, 2, 1, AutoresetMode.DISABLED)
    many.close()
    late.close()


def test_too_much_force_ends_an_episode(tmp_path: Path) -> None:
    made = small_task(tmp_path)
    path = tmp_path / "small.yaml"
    path.write_text(path.read_text() + "stop: {most_force_n: 0.012}\n")
    env = TaskEnv(str(path), 2)
    env.reset(seed=0)
    down = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    _, reward, over, truncated, info = env.step(down)
    if not over:
        _, reward, over, truncated, info = env.step(down)
    assert over and not truncated and reward == FAILED and "a finger bears" in info["stopped"]
    assert not info["success"] and made.stop.most_force_n == 10.0
    with pytest.raises(ConfigError, match=r"episode is over.*reset"):
        env.step(down)


def test_mistakes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"decisions is 9, but the hands of small act in 8 steps.*1 to 8"):
        small_task(tmp_path)
        TaskEnv(str(tmp_path / "small.yaml"), 9)
    with pytest.raises(ConfigError, match=r"card.E_pa is drawn from 2 to 1, but may be"):
        small_env(tmp_path, vary={"card.E_pa": (2.0, 1.0)})
    with pytest.raises(ConfigError, match=r"card.nu is drawn from 0.2 to 1.5, but may be"):
        small_env(tmp_path, vary={"card.nu": (0.2, 1.5)})
    with pytest.raises(ConfigError, match=r"around has the shape \(12,\), but .* with 3 decisions has 18 numbers"):
        small_env(tmp_path, around=np.zeros(12))


def test_decisions_are_executed_within_the_limits_of_the_hands(tmp_path: Path) -> None:
    """Each is taken as a whole where it can be; what asks for too much is scaled down before it is done."""
    env = small_env(tmp_path)
    env.reset(seed=0)
    env.step(np.full(6, 0.01))
    assert env.action_so_far.reshape(3, 6)[0].tolist() == [0.01] * 6
    before = env.rollouts.space.poses(env.action_so_far)["finger"].positions[: env.rollouts.episode.at + 1]
    env.step(np.array([0.0, 0.0, 1.0, 1.0, -1.0, 1.0]))
    env.step(np.array([0.0, 0.0, -1.0, -1.0, 1.0, -1.0]))
    done = env.action_so_far.reshape(3, 6)
    assert 0.0 < done[1, 3] < 1.0 and done[1, 3] == -done[1, 4]
    np.testing.assert_array_equal(env.rollouts.space.executable(env.action_so_far), env.action_so_far)
    after = env.rollouts.space.poses(env.action_so_far)["finger"].positions[: len(before)]
    np.testing.assert_array_equal(after, before)


def test_a_decision_reaches_as_far_about_a_motion_as_is_said(tmp_path: Path) -> None:
    env = small_env(tmp_path, around=np.full(18, 0.01), reach=0.5)
    env.reset(seed=0)
    env.step(np.full(6, 0.02))
    np.testing.assert_allclose(env.action_so_far.reshape(3, 6)[0], 0.01 + 0.5 * 0.02)


def test_a_motion_about_which_nothing_is_decided_is_that_motion(tmp_path: Path) -> None:
    motion = 0.003 * np.arange(18.0)
    env = small_env(tmp_path, around=motion, reach=0.5)
    env.reset(seed=0)
    for _ in range(3):
        _, _, over, _, info = env.step(np.zeros(6))
    np.testing.assert_allclose(env.action_so_far, env.rollouts.space.executable(motion))
    assert over and info["reward"] == env.rollouts.outcome(env.action_so_far).reward


def test_a_robot_sees_what_its_sensors_read_with_their_noise(tmp_path: Path) -> None:
    small_task(tmp_path)
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig.read_text() + touch_sensor(0.05, 1e-5))
    env = TaskEnv(str(tmp_path / "small.yaml"), 3, observe="sensors")
    first, _ = env.reset(seed=1)
    again, _ = env.reset(seed=1)
    other, _ = env.reset(seed=2)
    assert len(first) == 3 + 3 + 6 + 1 and np.array_equal(first, again)
    force = env.rollouts.episode.readings[-1]["touch"]
    noise = np.array([seen[6:9] for seen in (first, other)]) * FORCE_N - force[:3]
    assert (noise != 0.0).all() and 0.005 < noise.std() < 0.2
    assert np.abs(first[9:12] * TORQUE_NM - force[3:]).max() < 1e-4
    env.step(np.array([0.0, 0.0, -0.3, 0.0, 0.0, 0.0]))
    assert abs(env.rollouts.episode.readings[-1]["touch"][2]) > abs(force[2]), "pressed harder"


def test_all_tasks_are_known_to_gymnasium() -> None:
    names = set(gymnasium.registry)
    assert {"thinshell/lifting-v0", "thinshell/lifting-paper-v0", "thinshell/folding_l-v0"} <= names
    entry = gymnasium.registry["thinshell/lifting-paper-v0"].vector_entry_point
    assert gymnasium.envs.registration.load_env_creator(entry) is TaskVectorEnv
