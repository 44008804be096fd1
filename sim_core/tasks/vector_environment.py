"""Many environments of one task that step at once, on threads: the vectorised counterpart of ``TaskEnv``."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from sim_core.errors import ConfigError
from sim_core.tasks.environment import TaskEnv

T = TypeVar("T")


class TaskVectorEnv(gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """``num_envs`` environments of one task, each with its own scene, on ``workers`` threads (default: one a core).

    What each does is what a ``TaskEnv`` with its seed does, to the bit, at any number of threads. One whose episode is
    over begins the next one with the step after that, or, with ``autoreset_mode`` ``SAME_STEP``, at once: then the
    ``info`` of that step has the end of the episode as ``final_obs`` and ``final_info``. ``task`` and ``options`` by
    name: as of :class:`sim_core.tasks.environment.TaskEnv`.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        workers: int | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        if autoreset_mode not in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP):
            raise ConfigError(f"autoreset_mode is {autoreset_mode}.", "Choose NEXT_STEP or SAME_STEP.")
        self.metadata = {"autoreset_mode": autoreset_mode}
        self._at_once = autoreset_mode == AutoresetMode.SAME_STEP
        self._threads = ThreadPoolExecutor(min(workers or os.cpu_count() or 1, num_envs))
        self.num_envs = num_envs
        self.envs = self._each([partial(TaskEnv, task, **options)] * num_envs)
        first = self.envs[0]
        self.single_action_space, self.single_observation_space = first.action_space, first.observation_space
        self.action_space = batch_space(first.action_space, num_envs)
        self.observation_space = batch_space(first.observation_space, num_envs)
        self._over = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """New episodes. ``seed``: of each, or of the first, the others count up from it."""
        if seed is None or isinstance(seed, int):
            seed = [None if seed is None else seed + k for k in range(self.num_envs)]
        begun = self._each(
            [partial(env.reset, seed=own, options=options) for env, own in zip(self.envs, seed, strict=True)]
        )
        self._over[:] = False
        return np.stack([observation for observation, _ in begun]), self._infos([info for _, info in begun])

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Hold the actions ``(n, k)`` for their steps."""

        def one(k: int) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
            if self._over[k]:
                observation, info = self.envs[k].reset()
                return observation, 0.0, False, False, info
            observation, gained, over, cut, info = self.envs[k].step(actions[k])
            if self._at_once and (over or cut):
                begun, at_start = self.envs[k].reset()
                return begun, gained, over, cut, {**at_start, "final_obs": observation, "final_info": info}
            return observation, gained, over, cut, info

        made = self._each([partial(one, k) for k in range(self.num_envs)])
        observations, gained, over, cut, infos = zip(*made, strict=True)
        self._over = (np.array(over) | np.array(cut)) & (not self._at_once)
        return np.stack(observations), np.array(gained), np.array(over), np.array(cut), self._infos(infos)

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads."""
        self._threads.shutdown()

    def _each(self, work: Sequence[Callable[[], T]]) -> list[T]:
        """What all of some work comes to, side by side."""
        return [future.result() for future in [self._threads.submit(own) for own in work]]

    def _infos(self, infos: Sequence[dict[str, Any]]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for k, info in enumerate(infos):
            found = self._add_info(found, info, k)
        return found
