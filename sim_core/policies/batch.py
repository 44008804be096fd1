"""Environments of a task for the library Stable-Baselines3 (Raffin et al. 2021), whose vectorised interface is its
own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from sim_core.policies.encoder import MOST, Encoder
from sim_core.tasks.vector_environment import TaskVectorEnv


class Batch(VecEnv):
    """``envs`` environments of a task that step at once on ``workers`` threads, with observations as they are until
    :meth:`see_by` an encoder. ``options``: of :class:`sim_core.tasks.environment.TaskEnv`."""

    def __init__(self, task: str, envs: int, workers: int, **options: Any) -> None:
        self.tasks = TaskVectorEnv(task, envs, workers, AutoresetMode.SAME_STEP, **options)
        self.render_mode = None
        self._encode: Callable[[np.ndarray], np.ndarray] = lambda observations: observations
        super().__init__(envs, self.tasks.single_observation_space, self.tasks.single_action_space)

    def see_by(self, encoder: Encoder) -> None:
        """Give what the encoder makes of observations from now on."""
        self._encode = encoder.encode
        self.observation_space = Box(-MOST, MOST, (encoder.size,), np.float32)

    def reset(self) -> np.ndarray:
        """New episodes, with the seeds that were given. Observations ``(n, m)``."""
        seeds = list(self._seeds)
        self._reset_seeds()
        observations, _ = self.tasks.reset(seed=seeds)
        return self._encode(observations)

    def step_async(self, actions: np.ndarray) -> None:
        """Take the decisions ``(n, k)`` for the next step."""
        self._decisions = np.asarray(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Carry the decisions out: observations ``(n, m)``, rewards and ends ``(n,)``, and ``infos``, which have of an
        episode that is over its ``reward``, ``success``, ``stopped``, and its last observation."""
        observations, gained, over, cut, found = self.tasks.step(self._decisions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for k in np.flatnonzero(over | cut):
            end = found["final_info"]
            infos[k] = {
                "terminal_observation": self._encode(found["final_obs"][k][None])[0],
                "TimeLimit.truncated": False,
                "reward": float(end["reward"][k]),
                "success": bool(end["success"][k]),
                "stopped": str(end["stopped"][k]),
                "parameters": {name: float(values[k]) for name, values in end["parameters"].items() if name[0] != "_"},
            }
        return self._encode(observations), gained.astype(np.float32), over | cut, infos

    def close(self) -> None:
        """End the threads."""
        self.tasks.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of each environment."""
        return [getattr(self.tasks.envs[k], attr_name) for k in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of each environment."""
        for k in self._chosen(indices):
            setattr(self.tasks.envs[k], attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """What a method of each environment gives."""
        return [getattr(self.tasks.envs[k], method_name)(*method_args, **method_kwargs) for k in self._chosen(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """None is."""
        return [False for _ in self._chosen(indices)]

    def _chosen(self, indices: Any) -> Sequence[int]:
        return list(self._get_indices(indices))
