"""What a method of optimisation sees: fitness and gradients of actions, within a budget, all of them written down.

A search is deterministic for a seed, and every rollout is written to a log as it is made. So a search that was ended
goes on by being made again: what the log has is taken from there.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from sim_core.errors import ConfigError
from sim_core.optimise.evaluators import Evaluator, Parameters, Request
from sim_core.tasks.rollout import Outcome

OnRollout = Callable[[float, str], None]
"""Called with the share of the budget that is spent and a word on what is being done."""


@dataclass(frozen=True)
class Budget:
    """How long a search may take: so many rollouts (one with a gradient counts as one), and seconds of wall time."""

    rollouts: int
    seconds: float = float("inf")


class BudgetSpent(Exception):
    """The budget of a search is spent, or what was sought is found."""


@dataclass(frozen=True)
class Evaluation:
    """One action that was tried. ``outcomes``: one, or one for each set of parameters; ``fitness``: what is sought to
    be large; ``phase``: what the method was doing; ``wall_s``: time since the search began [s]."""

    action: np.ndarray
    fitness: float
    gradient: np.ndarray | None
    outcomes: tuple[Outcome, ...]
    phase: str
    wall_s: float

    @property
    def success(self) -> bool:
        """Whether all of its outcomes are."""
        return all(o.success for o in self.outcomes)


class Problem:
    """A task as an optimisation problem over actions in [-1, 1]. ``history``: all evaluations; ``best``: the fittest.

    ``draws``: sets of parameters over which the mean of the fitness, and with ``quantile`` q > 0 the mean of its least
    share q, is sought. ``stop_at_success``: the search ends with the first success that ``confirm`` says is one,
    which is :attr:`confirmed`. ``motions``: those that may be tried first, by kind, each ``(m, size)``
    (:meth:`sim_core.tasks.ActionSpace.generic`).
    """

    def __init__(
        self,
        evaluator: Evaluator,
        budget: Budget,
        *,
        log: Path | None = None,
        on_rollout: OnRollout | None = None,
        draws: Sequence[Parameters] = (),
        quantile: float = 0.0,
        stop_at_success: bool = False,
        confirm: Callable[[Evaluation], bool] = lambda _: True,
        motions: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        self.motions = dict(motions or {})
        self.size, self.workers = evaluator.size, evaluator.workers
        self._evaluator, self.budget, self._on_rollout = evaluator, budget, on_rollout
        self._draws: list[Parameters | None] = list(draws) or [None]
        self._quantile, self._stop_at_success, self._confirm = quantile, stop_at_success, confirm
        self.confirmed: Evaluation | None = None
        self.history: list[Evaluation] = []
        self.best: Evaluation | None = None
        self.phase = ""
        self._past = read_log(log) if log is not None else []
        self._log: TextIO | None = None
        if log is not None:
            self._log = log.open("a", encoding="utf-8")
        self._before_s = self._past[-1].wall_s if self._past else 0.0
        self._began = time.monotonic()

    @property
    def rollouts(self) -> int:
        """How many rollouts were made."""
        return sum(len(e.outcomes) for e in self.history)

    @property
    def wall_s(self) -> float:
        """Wall time since the search began [s], that of the part that was made before included."""
        return self._before_s + time.monotonic() - self._began

    def close(self) -> None:
        """Close the log."""
        if self._log is not None:
            self._log.close()

    def left(self) -> int:
        """How many actions may still be tried."""
        return max(0, (self.budget.rollouts - self.rollouts) // len(self._draws))

    def values(self, actions: Sequence[np.ndarray]) -> list[float]:
        """Fitness of actions. Raises ``BudgetSpent`` where not all of them are within the budget, when those that are
        were tried."""
        return [e.fitness for e in self._evaluations(actions, False)]

    def gradients(self, actions: Sequence[np.ndarray]) -> list[Evaluation]:
        """Evaluations of actions with gradients of their fitness (None where a rollout ended early)."""
        return self._evaluations(actions, True)

    def _evaluations(self, actions: Sequence[np.ndarray], gradient: bool) -> list[Evaluation]:
        found: list[Evaluation] = []
        for first in range(0, len(actions), max(1, self.workers)):
            part = [np.clip(np.asarray(a, dtype=float), -1.0, 1.0) for a in actions[first : first + self.workers]]
            part = part[: self.left()]
            if part and self.wall_s > self.budget.seconds and len(self.history) >= len(self._past):
                part = []
            for evaluation in self._tried(part, gradient):
                self.history.append(evaluation)
                found.append(evaluation)
                if self.best is None or evaluation.fitness > self.best.fitness:
                    self.best = evaluation
                self._tell()
                if self._stop_at_success and evaluation.success and self._confirm(evaluation):
                    self.confirmed = evaluation
                    raise BudgetSpent
            if len(part) < len(actions[first : first + self.workers]):
                raise BudgetSpent
        return found

    def _tried(self, actions: Sequence[np.ndarray], gradient: bool) -> list[Evaluation]:
        """Evaluations of actions, from the log as far as it has them."""
        at = len(self.history)
        known = self._past[at : at + len(actions)]
        for action, past in zip(actions, known, strict=False):
            if not np.array_equal(action, past.action) or (gradient and not past.outcomes[0].stopped) != (
                past.gradient is not None
            ):
                raise ConfigError(
                    f"The search does not go the way that its log has from evaluation {at} on.",
                    "Settings, versions or the machine differ from when it began: begin anew in another folder.",
                )
        rest = actions[len(known) :]
        requests = [Request(a, gradient, draw) for a in rest for draw in self._draws]
        outcomes = self._evaluator.outcomes(requests)
        made = []
        for k, action in enumerate(rest):
            own = tuple(outcomes[k * len(self._draws) : (k + 1) * len(self._draws)])
            fitness, slope = self._combined(own, gradient)
            evaluation = Evaluation(action, fitness, slope, own, self.phase, self.wall_s)
            made.append(evaluation)
            self._write(evaluation)
        return [*known, *made]

    def _combined(self, outcomes: Sequence[Outcome], gradient: bool) -> tuple[float, np.ndarray | None]:
        """Fitness over the draws and its gradient."""
        values = np.array([o.fitness for o in outcomes])
        chosen = np.arange(len(values))
        if self._quantile > 0.0:
            chosen = np.argsort(values, kind="stable")[: max(1, round(self._quantile * len(values)))]
        slopes = [outcomes[int(k)].gradient for k in chosen]
        slope = None
        if gradient and all(s is not None for s in slopes):
            slope = np.mean([s for s in slopes if s is not None], axis=0)
        return float(values[chosen].mean()), slope

    def _tell(self) -> None:
        if self._on_rollout is None or self.best is None:
            return
        share = self.rollouts / self.budget.rollouts
        if np.isfinite(self.budget.seconds):
            share = max(share, self.wall_s / self.budget.seconds)
        word = f"{self.phase}, {self.rollouts} rollouts, best {self.best.fitness:.4g}"
        self._on_rollout(min(share, 1.0), word + (" (success)" if self.best.success else ""))

    def _write(self, evaluation: Evaluation) -> None:
        if self._log is None:
            return
        data: dict[str, Any] = {
            "action": evaluation.action.tolist(),
            "fitness": evaluation.fitness,
            "gradient": None if evaluation.gradient is None else evaluation.gradient.tolist(),
            "outcomes": [{**asdict(o), "gradient": None} for o in evaluation.outcomes],
            "phase": evaluation.phase,
            "wall_s": evaluation.wall_s,
        }
        self._log.write(json.dumps(data) + "\n")
        self._log.flush()


def read_log(path: Path) -> list[Evaluation]:
    """Evaluations that a log has; a last line that was cut off is left out, and cut off the file."""
    if not path.exists():
        return []
    found, whole = [], 0
    with path.open("rb") as stored:
        for line in stored:
            try:
                data = json.loads(line)
                found.append(
                    Evaluation(
                        np.array(data["action"]),
                        data["fitness"],
                        None if data["gradient"] is None else np.array(data["gradient"]),
                        tuple(Outcome(**o) for o in data["outcomes"]),
                        data["phase"],
                        data["wall_s"],
                    )
                )
            except (ValueError, KeyError, TypeError) as error:
                if line.endswith(b"\n"):
                    raise ConfigError(f"{path} is no log of a search: {error}.", "Begin in another folder.") from None
                break
            whole += len(line)
    with path.open("r+b") as stored:
        stored.truncate(whole)
    return found
