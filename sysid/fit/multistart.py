"""From where a fit is searched for: from the rig's values, from others if that is asked for, and again from near the
best while it is not good.

Where contacts stick and slide the misfit has several minima. Starts other than the rig's own are chosen once by the
data: the parameters that are asked for are drawn on a Latin hypercube over their plausible range, and those that fit
best are searched from. Restarts are for
kinks, on which a search can end although the misfit falls on the other side; they stand close to the best so far.
There are a few in all, and none any more once one of them has brought nothing.

What the discretisation error is where a fit begins says little of what it is where it ends: a slack sheet buckles in
one place and not in another. While another search near it brings chi-square down by more than half there is nothing to
be made of what it leaves. It ends when it comes on slowly, and goes on when the error has been measured where it
stands.

Where an end effector really is decides whether a sheet between two of them hangs or is taut, and which way it buckles.
A fit that leaves more than noise in any quantity is therefore tried again from other offsets of the end effectors, if
those are unknown: drawn from what was known of them before, and searched from where they fit best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm, qmc

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.fit.options import FitOptions
from sysid.model.nuisance_parameters import kind_of
from sysid.model.parameters import FitParameter
from sysid.settings.fit import FIT
from sysid.settings.uncertainty import UNCERTAINTY
from sysid.solve.covariance import overdispersion, uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem
from sysid.uncertainty.goodness_of_fit import worst


@dataclass(frozen=True)
class Step:
    """What a fit knows while it runs. ``evaluations``: all until now; ``misfit``: mean squared whitened residual of
    the best ``values`` (of the parameters that are asked for) of the search that is on."""

    evaluations: int
    misfit: float
    values: dict[str, float]


class Evaluations:
    """Counts the evaluations of a fit, at most those that the options allow, and tells of each. ``say``: takes what is
    being done, in words."""

    def __init__(
        self,
        options: FitOptions,
        say: Callable[[str], None] | None = None,
        on_step: Callable[[Step], None] | None = None,
    ) -> None:
        self._most = options.max_evaluations
        self._say = say
        self._on_step = on_step
        self.done = 0

    @property
    def left(self) -> int:
        """Evaluations that the next search may make."""
        return FIT.search_evaluations if self._most is None else min(self._most - self.done, FIT.search_evaluations)

    def limit(self, fitted: Fitted) -> Fitted:
        """The outcome of a search, which says so if none are left."""
        if self.left <= 0 and fitted.parameters and not fitted.interrupted:
            fitted.limited, fitted.converged = True, False
            fitted.message = f"the evaluations allowed, {self._most}, are used up; the best values so far are kept"
        return fitted

    def tell(self, text: str) -> None:
        """Say what is going on."""
        if self._say is not None:
            self._say(text)

    def __call__(self, best: Fitted) -> None:
        """One more has been made, after which ``best`` is the best of its search."""
        self.done += 1
        self.tell(f"evaluation {self.done}, misfit {best.misfit:.3g} (up to 1: noise and discretisation error)")
        if self._on_step is not None:
            asked = {p.name for p in best.parameters if not p.nuisance}
            self._on_step(Step(self.done, best.misfit, {n: v for n, v in best.values.items() if n in asked}))


class Searches:
    """The searches of one fit of ``parameters`` of ``rig``, which may be several in turns, each of one problem."""

    def __init__(
        self, rig: Rig, parameters: Sequence[FitParameter], options: FitOptions, evaluations: Evaluations
    ) -> None:
        self._rig = rig
        self._parameters = list(parameters)
        self._evaluations = evaluations
        self._rng = np.random.default_rng(options.seed)
        self._elsewhere = options.starts - 1 if self._parameters else 0
        self._restarts = FIT.most_restarts if self._parameters else 0
        self._offsets = [k for k, p in enumerate(self._parameters) if kind_of(rig, p.target) == "pose"]
        self._known = np.array([p.known_sd or p.prior_sd for p in self._parameters])
        self._moved: list[str] = []
        self._found: list[Fitted] = []
        self._begun: list[np.ndarray] = []
        self._failed = 0

    def __call__(self, problem: Problem, at: np.ndarray) -> Fitted:
        """The best that is found from scaled values ``(p,)``. Raises ``ThinshellError`` if they cannot be simulated."""
        fitted = self._search(problem, at)
        if self._elsewhere and self._may_go_on(fitted):
            fitted = self._from_elsewhere(problem, at, fitted)
        self._elsewhere = 0
        if self._far(problem, fitted):
            fitted.elsewhere = True
            return self._evaluations.limit(fitted)
        if self._offsets and self._may_go_on(fitted) and worst(problem, fitted) > UNCERTAINTY.good_misfit:
            fitted = self._from_other_offsets(problem, at, fitted)
            self._offsets = []
            if self._far(problem, fitted):
                fitted.elsewhere = True
                return self._evaluations.limit(fitted)
        return self._evaluations.limit(self._again_from_near(problem, fitted))

    def _search(self, problem: Problem, at: np.ndarray) -> Fitted:
        # Searches from several starts are compared where they end.
        halt = _comes_on_slowly if problem.error_shapes and not self._elsewhere else None
        return problem.fit(
            self._rig, self._parameters, at, self._evaluations.left, on_evaluation=self._evaluations, halt=halt
        )

    def _far(self, problem: Problem, fitted: Fitted) -> bool:
        """The discretisation error is to be measured where the fit stands before it is searched on."""
        if not problem.error_shapes or not self._may_go_on(fitted):
            return False
        return fitted.elsewhere or (
            fitted.chi2 < FIT.far_start_ratio * fitted.began and worst(problem, fitted) > UNCERTAINTY.good_misfit
        )

    def _may_go_on(self, fitted: Fitted) -> bool:
        return self._evaluations.left > 0 and not fitted.interrupted

    def _tried(self, problem: Problem, at: np.ndarray, best: Fitted) -> Fitted | None:
        """A search from elsewhere; None where that cannot be simulated, which costs an evaluation all the same, and
        where Ctrl-C is pressed before it has found anything, which ``best`` then says."""
        try:
            found = self._search(problem, at)
        except KeyboardInterrupt:
            best.interrupt()
            return None
        except ThinshellError:
            self._evaluations(best)
            return None
        if found.interrupted:
            best.interrupt()
        return found

    def _from_elsewhere(self, problem: Problem, at: np.ndarray, first: Fitted) -> Fitted:
        """The best of searches from the starts that were asked for in addition to the rig's, which is kept unless
        another has ended where the fit is better by more than chance."""
        self._found, self._begun, best = [first], [at], first
        for start in self._drawn(problem, at, first):
            if not self._may_go_on(best):
                break
            other = self._tried(problem, start, best)
            if other is None:
                self._failed += not best.interrupted
                continue
            self._found.append(other)
            self._begun.append(start)
            mine, others = best.common_chi2(other)
            if mine - others > FIT.same_chi2 * overdispersion(best):
                best = other
        return best

    @property
    def ends(self) -> list[str]:
        """In words, where searches from several starts have ended, if there were several."""
        return [*(_said(self._begun, self._found, self._failed) if self._found else []), *self._moved]

    def _drawn(self, problem: Problem, at: np.ndarray, best: Fitted) -> list[np.ndarray]:
        """Starts: those that fit best of a Latin hypercube in the parameters that are asked for."""
        asked = [k for k, p in enumerate(self._parameters) if not p.nuisance]
        return self._glanced(problem, at, asked, FIT.start_width, FIT.draws_per_start * self._elsewhere, best)[
            : self._elsewhere
        ]

    def _glanced(
        self, problem: Problem, about: np.ndarray, which: Sequence[int], width: float, count: int, best: Fitted
    ) -> list[np.ndarray]:
        """Draws of a Latin hypercube in some of the parameters ``about`` scaled values, ``width`` times as wide as
        what was known of them, those that fit best first. None where Ctrl-C is pressed, which ``best`` then says."""
        share = qmc.LatinHypercube(len(which), rng=self._rng).random(count)
        drawn = np.tile(about, (count, 1))
        drawn[:, which] += width * self._known[which] * norm.ppf(share)
        low, high = np.array([p.scaled_bounds for p in self._parameters]).T
        points = list(np.clip(drawn, low, high))
        self._evaluations.tell(f"comparing {count} other starts")
        try:
            misfits = problem.glance(self._rig, self._parameters, points)
        except KeyboardInterrupt:
            best.interrupt()
            return []
        return [points[k] for k in np.argsort(misfits, kind="stable")]

    def _from_other_offsets(self, problem: Problem, at: np.ndarray, fitted: Fitted) -> Fitted:
        """The best of searches from other offsets of the end effectors, while they bring anything: in all readings
        together, or where most is left."""
        before, first = worst(problem, fitted), fitted
        for start in self._glanced(problem, at, self._offsets, 1.0, FIT.offset_draws, fitted)[: FIT.offset_searches]:
            if not self._may_go_on(fitted):
                break
            again = self._tried(problem, start, fitted)
            if again is None:
                break
            known, new = fitted.common_chi2(again)
            if new >= known:
                break
            left, now = worst(problem, fitted), worst(problem, again)
            better = new < FIT.better_chi2_ratio * known or now < FIT.better_chi2_ratio * left
            fitted = again
            if not better:
                break
        if fitted is not first:
            self._moved = [
                f"A search left up to {before:.4g} times the noise's misfit in one quantity, and searches from other "
                f"offsets of the end effectors {worst(problem, fitted):.4g}."
            ]
        return fitted

    def _again_from_near(self, problem: Problem, fitted: Fitted) -> Fitted:
        """The best of restarts, while they bring anything and the misfit stays above noise."""
        width = np.array([p.unit_step for p in self._parameters])
        while self._restarts and self._may_go_on(fitted) and fitted.misfit >= UNCERTAINTY.good_misfit:
            near = fitted.scaled + FIT.restart_width * width * self._rng.standard_normal(len(width))
            again = self._tried(problem, near, fitted)
            known, new = (1.0, np.inf) if again is None else fitted.common_chi2(again)
            self._restarts = self._restarts - 1 if again is None or new < FIT.better_chi2_ratio * known else 0
            fitted = again if again is not None and new < known else fitted
        return fitted


def _comes_on_slowly(course: Sequence[float]) -> bool:
    """Far from where the search began, and no better for some time. ``course``: chi-square after each evaluation.

    Noise alone is no reason to stay: an error that was measured where it is larger takes what the parameters leave.
    """
    return (
        len(course) > FIT.patience_evaluations
        and course[-1] < FIT.far_start_ratio * course[0]
        and course[-1] > FIT.slow_chi2_ratio * course[-1 - FIT.patience_evaluations]
    )


def _said(begun: Sequence[np.ndarray], found: Sequence[Fitted], failed: int) -> list[str]:
    """Compares searches among themselves: what is taken for error of the simulator changes afterwards."""
    best = found[0]
    for other in found[1:]:
        mine, others = best.common_chi2(other)
        best = other if others < mine else best
    asked = np.array([not p.nuisance for p in best.parameters])
    sd = np.where(asked, uncertainty(best).sd, np.inf)
    beyond = [np.subtract(*f.common_chi2(best)) for f in found]
    as_good = [f for f, more in zip(found, beyond, strict=True) if more <= FIT.same_chi2 * overdispersion(best)]
    apart = [f for f in as_good if np.any(np.abs(f.scaled - best.scaled) > FIT.same_place_sd * sd)]
    sentences = [f"Of searches from {len(found) + failed} starts {len(as_good)} ended equally well."]
    if failed:
        sentences.append(f"{failed} could not be simulated where they start.")
    if apart:
        sentences.append(
            f"They ended in different places, so the data do not determine one set of values: {_place(best)}; "
            f"{_place(apart[0])}."
        )
    ways = [
        f"Search {k} began at {_place(f, at)} and ended at {_place(f)} with {f.misfit:.4g} times the noise's misfit."
        for k, (at, f) in enumerate(zip(begun, found, strict=True), 1)
    ]
    return [" ".join(sentences), *ways]


def _place(fitted: Fitted, scaled: np.ndarray | None = None) -> str:
    """Values of what is asked for, of the fit or at scaled values."""
    at = fitted.scaled if scaled is None else scaled
    named = [(p, p.physical(s)) for p, s in zip(fitted.parameters, at, strict=True) if not p.nuisance]
    return ", ".join(f"{p.name} {value:.4g}{f' {p.unit}' if p.unit else ''}" for p, value in named)
