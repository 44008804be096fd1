"""How a motion fares over what a fit leaves open: how many of so many rigs, drawn from it, it does its task on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from sim_core.optimise.evaluators import Parameters
from sim_core.tasks.check import judged
from sim_core.tasks.load import MadeTask
from sim_core.tasks.rollout import TaskRollouts


@dataclass(frozen=True)
class Robustness:
    """``rewards`` ``(n,)`` of one motion on n rigs, NaN where a rollout ended early; ``failures``: why it is no success
    on each, in words, with the cells and steps of the rig (:func:`sim_core.tasks.check.judged`)."""

    rewards: np.ndarray
    failures: tuple[tuple[str, ...], ...]

    @property
    def successes(self) -> int:
        """On how many rigs it is one."""
        return sum(not words for words in self.failures)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the share of rigs on which it is one (Clopper & Pearson, Biometrika 26, 1934)."""
        found = binomtest(self.successes, len(self.failures)).proportion_ci(0.95, method="exact")
        return float(found.low), float(found.high)

    @property
    def common_failure(self) -> str:
        """The failure that is met most often, without its numbers' digits counting; empty where there is none."""
        first = [words[0] for words in self.failures if words]
        kinds = ["".join(c for c in words if not c.isdigit()) for words in first]
        return first[kinds.index(max(kinds, key=kinds.count))] if first else ""


def robustness(
    made: MadeTask, action: np.ndarray, draws: Sequence[Parameters], on_draw: Callable[[int], None] = lambda _: None
) -> Robustness:
    """The motion of an action ``(size,)`` on a rig for each set of parameters. ``on_draw`` is called after each."""
    rollouts, rewards, failures = TaskRollouts(made), [], []
    for number, draw in enumerate(draws):
        rollouts.use(draw)
        words, reward = judged(rollouts, action)
        rewards.append(reward)
        failures.append(tuple(words))
        on_draw(number + 1)
    return Robustness(np.array(rewards), tuple(failures))
