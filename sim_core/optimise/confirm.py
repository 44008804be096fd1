"""Checks of successes during a search, which are written down, so that a search that goes on does not make them again.

A check costs as much as ten rollouts and more. So where one has failed, the next action is checked only if its reward
is higher by what was missing with cells and steps half as large.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

import numpy as np

from sim_core.optimise.problem import Evaluation
from sim_core.tasks.check import Checker, Verdict
from sim_core.tasks.load import MadeTask

CHECKS = "checks.jsonl"


class Confirmations:
    """Checks of actions of one task. ``folder``: where they are written to, if anywhere."""

    def __init__(self, made: MadeTask, folder: Path | None) -> None:
        self._made, self._path = made, None if folder is None else folder / CHECKS
        self._checker: Checker | None = None
        self._least = -np.inf
        self._known: dict[str, Verdict] = {}
        if self._path is not None and self._path.exists():
            for line in self._path.read_text(encoding="utf-8").splitlines():
                data = json.loads(line)
                action = data.pop("action")
                self._known[action] = Verdict(**{**data, "failures": tuple(data["failures"])})

    @property
    def cpu_s(self) -> float:
        """Process time of all checks [s]."""
        return sum(verdict.cpu_s for verdict in self._known.values())

    def __call__(self, evaluation: Evaluation) -> bool:
        """Whether an evaluation is a success; False also where it is not worth a check."""
        if evaluation.fitness <= self._least:
            return False
        verdict = self.verdict(evaluation.action)
        missing = self._made.variant.success - verdict.refined_reward
        self._least = evaluation.fitness + (missing if missing > 0.0 else 0.0)
        return verdict.passed

    def verdict(self, action: np.ndarray) -> Verdict:
        """What the check of an action says."""
        key = sha256(np.ascontiguousarray(action).tobytes()).hexdigest()
        if key not in self._known:
            self._checker = self._checker or Checker(self._made)
            found = self._known[key] = self._checker.check(action)
            if self._path is not None:
                with self._path.open("a", encoding="utf-8") as stored:
                    stored.write(json.dumps({"action": key, **asdict(found)}) + "\n")
        return self._known[key]
