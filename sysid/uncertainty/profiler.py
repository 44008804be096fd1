"""Profile likelihood: how far each parameter can go while all others follow it.

The quadratic interval takes chi-square for a parabola. The profile deviance of parameter k is

    D(x) = [min over the others of chi2(theta | theta_k = x) - min chi2] / c,    c = sd_k^2 / (J^T J)^-1_kk.

Chi2, and J with it, has the prior weighed up as the search does (:mod:`sysid.solve.gauss_newton`), so that its minimum
is the fit; sd_k is that of the quadratic interval (:mod:`sysid.solve.covariance`). The two therefore agree where
chi-square is a parabola (vertical scaling, Chandler & Bate 2007). The 95 % interval is where D is at most
3.84 = chi2_1(0.95) (Venzon & Moolgavkar 1988). Where D stays below that as far as a value is plausible, the data give a
limit on one side only.

From each point the others follow along their linear prediction; Gauss-Newton steps within bounds go on from there
until they promise less than ``UNCERTAINTY.worth_evaluating`` of deviance. The discretisation error is that measured at
the optimum.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import lsq_linear

from sim_core.errors import ThinshellError
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.settings.solve import SOLVE
from sysid.settings.uncertainty import UNCERTAINTY
from sysid.solve.covariance import inverse_information, overdispersion, uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem
from sysid.uncertainty.profile_likelihood import End, Profile, in_words

Job = TypeVar("Job")
Found = TypeVar("Found")


@dataclass(frozen=True)
class _Point:
    """A point of a profile. ``scaled``: where it was evaluated; ``least``: least chi-square of the others there."""

    scaled: np.ndarray
    least: float
    residual: np.ndarray
    jacobian: np.ndarray


class Profiler:
    """Profiles of a fit, both sides of all parameters side by side where the engine has workers. ``given_up``:
    chi-square by which the fit is known to be worse than another, which is no better fit then."""

    def __init__(
        self, problem: Problem, fitted: Fitted, say: Callable[[str], None] | None = None, given_up: float = 0.0
    ) -> None:
        self._problem, self._fitted = problem, fitted
        self._parameters = fitted.parameters
        self._low, self._high = np.array([p.scaled_bounds for p in self._parameters]).T
        self._prior = np.array([p.prior_sd for p in self._parameters])
        by_chance = overdispersion(fitted)
        self._weight = float(np.sqrt(by_chance)) if fitted.has_prior else 1.0
        known = uncertainty(fitted)
        self._sd = known.sd
        misfit = max(1.0, known.reduced_chi2)
        # A fall of chi-square that is neither misfit nor chance, nor what a search leaves that ends at its tolerance.
        self._gain = UNCERTAINTY.deviance_root**2 * max(misfit, by_chance) + given_up
        self._say = say
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._evaluations = 0
        self._expected = 1.0
        self._best = self._point(fitted, None)
        self._lowest = self._best
        self._calibration = self._sd**2 / np.diag(inverse_information(self._best.jacobian, self._prior))

    def check(self) -> list[str]:
        """A sentence for each quadratic interval that does not hold, by an evaluation at each of its ends;
        where a better fit is met there, a sentence about that alone."""
        jobs = [(k, side) for k in self._asked() for side in (-1, 1)]
        roots = self._run(lambda job: self._root_at_end(*job), jobs, 1.0)
        better = self.lower()
        if better:
            return [better]
        said = []
        for k, pair in zip(self._asked(), zip(roots[::2], roots[1::2], strict=True), strict=True):
            p = self._parameters[k]
            off = [
                r
                for r in pair
                if r is not None
                and np.isfinite(r)
                and not UNCERTAINTY.accepted_roots[0] <= r <= UNCERTAINTY.accepted_roots[1]
            ]
            if off:
                way = "too narrow" if min(off) < UNCERTAINTY.accepted_roots[0] else "too wide"
                if min(off) < UNCERTAINTY.accepted_roots[0] and max(off) > UNCERTAINTY.accepted_roots[1]:
                    way = "too narrow on one side and too wide on the other"
                said.append(
                    f"The interval of {p.name} takes the misfit for a parabola, which it is not: it is {way}. "
                    "'--profile' finds the interval that the recordings give."
                )
            failed = [
                f"{p.name} = {p.physical(self._end(k, side)):.3g} {p.unit}".rstrip(" -")
                for side, root in zip((-1, 1), pair, strict=True)
                if root == np.inf
            ]
            if failed:
                said.append(
                    f"The rig could not be simulated with {' or '.join(failed)}, where the interval ends: whether the "
                    "interval holds there was not checked."
                )
        return said

    def profiles(self) -> list[Profile]:
        """The profile of every parameter that was asked for. Ctrl-C ends with what was found so far."""
        jobs = [(k, side) for k in self._asked() for side in (-1, 1)]
        sides = self._run(lambda job: self._side(*job), jobs, UNCERTAINTY.typical_evaluations)
        found = []
        for n, k in enumerate(self._asked()):
            low, high = sides[2 * n], sides[2 * n + 1]
            if low is not None and high is not None:
                found.append(self._profile(k, low, high))
        return found

    @property
    def interrupted(self) -> bool:
        """Ctrl-C has cut off what was asked for."""
        return self._stop.is_set()

    @property
    def better(self) -> np.ndarray | None:
        """Scaled values ``(p,)`` of a better fit that was met on the way."""
        return self._lowest.scaled if self._gained() >= self._gain else None

    def _gained(self) -> float:
        return _square(self._best.residual) - _square(self._lowest.residual)

    def lower(self) -> str:
        """A sentence if a better fit was met on the way, else empty."""
        gain = self._gained()
        if gain < self._gain:
            return ""
        values = ", ".join(
            f"{p.name} = {p.physical(s):.5g}"
            for p, s in zip(self._parameters, self._lowest.scaled, strict=True)
            if not p.nuisance
        )
        return (
            f"The search had ended too early: chi-square is lower by {gain:.3g} at {values}. Write these values into "
            "the rig and fit again."
        )

    def _asked(self) -> list[int]:
        return [k for k, p in enumerate(self._parameters) if not p.nuisance]

    def _run(self, do: Callable[[Job], Found], jobs: Sequence[Job], each: float) -> list[Found | None]:
        """All jobs, as many at once as the engine has workers; None for those that Ctrl-C cut off."""
        self._expected = each * len(jobs)
        workers = (os.cpu_count() or 1) if isinstance(self._problem.engine, ParallelPredictor) else 1
        with ThreadPoolExecutor(min(workers, max(1, len(jobs)))) as threads:
            futures: list[Future[Found]] = []
            try:
                for job in jobs:
                    futures.append(threads.submit(do, job))
                return [f.result() for f in futures]
            except KeyboardInterrupt:
                self._stop.set()
                for f in futures:
                    f.cancel()
        found = [f.result() if f.done() and not f.cancelled() else None for f in futures]
        return found + [None] * (len(jobs) - len(found))

    def _evaluate(self, scaled: np.ndarray) -> Fitted | None:
        """The problem at these values, None where they cannot be simulated."""
        found: Fitted | None
        try:
            found = self._problem.evaluate(self._fitted.centre, self._parameters, scaled)
        except ThinshellError:
            found = None
        with self._lock:
            self._evaluations += 1
            if self._say is not None:
                expected = max(self._expected, self._evaluations)
                self._say(f"ends of intervals, evaluation {self._evaluations} of about {expected:.0f}")
        return found

    def _point(self, fitted: Fitted, k: int | None) -> _Point:
        """A point with parameter ``k`` (None: none) fixed. Only what the fit has in sight counts, and what is out of
        sight at the point as the fit misses it: nothing is gained or lost by hiding a reading."""
        r, j = fitted.residual.copy(), fitted.jacobian.copy()
        if fitted.sight is not None:
            r = np.where(fitted.sight, r, self._fitted.residual)
        if self._fitted.sight is not None:
            r, j = r * self._fitted.sight, j * self._fitted.sight[:, None]
        if fitted.pulls:
            r[-fitted.pulls :] *= self._weight
            j[-fitted.pulls :] *= self._weight
        least = self._follow(fitted.scaled, r, j, k, 0.0)[1]
        return _Point(fitted.scaled, least, r, j)

    def _follow(
        self, scaled: np.ndarray, residual: np.ndarray, jacobian: np.ndarray, k: int | None, move: float
    ) -> tuple[np.ndarray, float]:
        """Where the other parameters go, by one linear step within bounds, when parameter ``k`` moves by ``move``, and
        the least chi-square that the step promises."""
        others = [i for i in range(len(scaled)) if i != k]
        to = scaled.copy()
        if k is not None:
            residual = residual + jacobian[:, k] * move
            to[k] += move
        if not others:
            return to, float(residual @ residual)
        # A direction that the data do not see stays where it is.
        ridge = np.diag(1.0 / (SOLVE.widest_sd * self._prior[others]))
        upper: np.ndarray = np.linalg.qr(np.column_stack([jacobian[:, others], residual]))[1]
        matrix = np.vstack([upper[:, :-1], ridge])
        target = -np.concatenate([upper[:, -1], np.zeros(len(others))])
        reach = self._prior[others]
        low = np.minimum(np.maximum(self._low[others] - scaled[others], -reach), -1e-12)
        high = np.maximum(np.minimum(self._high[others] - scaled[others], reach), 1e-12)
        step = lsq_linear(matrix, target, bounds=(low, high)).x
        left = residual + jacobian[:, others] @ step
        to[others] = np.clip(scaled[others] + step, self._low[others], self._high[others])
        return to, float(left @ left)

    def _at(self, k: int, x: float, near: _Point, most: int = UNCERTAINTY.most_steps) -> _Point | None:
        """The point of the profile of parameter ``k`` at ``x``, starting from ``near``; None: not simulated."""
        guess, _ = self._follow(near.scaled, near.residual, near.jacobian, k, x - near.scaled[k])
        best: _Point | None = None
        for _ in range(most):
            here = self._evaluate(guess)
            if here is None:
                return best
            point = self._point(here, k)
            if best is None or _square(point.residual) < _square(best.residual):
                best = point
                with self._lock:
                    self._lowest = min(self._lowest, point, key=lambda q: _square(q.residual))
                promised = (_square(point.residual) - point.least) / self._calibration[k]
                if promised < UNCERTAINTY.worth_evaluating or self._stop.is_set():
                    break
                guess, _ = self._follow(point.scaled, point.residual, point.jacobian, k, 0.0)
            else:
                guess = 0.5 * (guess + best.scaled)
        return best

    def _root(self, k: int, point: _Point | None) -> float:
        """Root of the deviance of a point of the profile of parameter ``k``."""
        if point is None:
            return np.inf
        return float(np.sqrt(max(0.0, (point.least - self._best.least) / self._calibration[k])))

    def _plausible(self, k: int, side: int) -> float:
        """As far as parameter ``k`` is taken on one side."""
        far = self._fitted.scaled[k] + side * UNCERTAINTY.farthest_ranges * self._prior[k]
        return float(max(far, self._low[k]) if side < 0 else min(far, self._high[k]))

    def _end(self, k: int, side: int) -> float:
        """One end of the quadratic interval."""
        return float(self._fitted.scaled[k] + side * UNCERTAINTY.deviance_root * self._sd[k])

    def _root_at_end(self, k: int, side: int) -> float | None:
        """Root of the deviance at one end of the quadratic interval, infinite where that cannot be simulated; None
        where it is at a bound or out of reach. Then a better fit is looked for a plausible range away."""
        end, at = self._end(k, side), float(self._fitted.scaled[k])
        inside = self._low[k] < end < self._high[k] and abs(end - at) <= UNCERTAINTY.farthest_ranges * self._prior[k]
        if not inside:
            end = float(np.clip(at + side * self._prior[k], self._low[k], self._high[k]))
            if abs(end - at) < 1e-9 * self._prior[k]:
                return None
        point = self._at(k, end, self._best, 1)
        if point is not None and point.least < _square(self._best.residual) - self._gain:
            # A better fit is in sight: whether it is there takes more than one evaluation.
            point = self._at(k, end, point) or point
        if not inside:
            return None
        root = self._root(k, point)
        if point is not None and not UNCERTAINTY.accepted_roots[0] <= root <= UNCERTAINTY.accepted_roots[1]:
            # The other parameters may not have followed all the way yet.
            further = self._at(k, end, point) or point
            root = self._root(k, min(point, further, key=lambda q: q.least))
        return root

    def _side(self, k: int, side: int) -> tuple[list[tuple[float, float]], End]:
        """Points (value, root of the deviance) on one side, in the order of the value's distance, and the end."""
        start, far = float(self._fitted.scaled[k]), self._plausible(k, side)
        found = [(start, self._root(k, self._best))]
        if abs(far - start) < 1e-9 * self._prior[k]:
            return found, End(start, "open")
        inside, point = found[0], self._best
        beyond: tuple[float, float] | None = None
        step = min(self._sd[k], self._prior[k])
        x = start + side * step
        for _ in range(UNCERTAINTY.most_points):
            x = min(x, far) if side > 0 else max(x, far)
            there = self._at(k, x, point)
            root = self._root(k, there)
            found.append((x, root))
            if self._stop.is_set():
                break
            if root >= UNCERTAINTY.deviance_root:
                beyond = (x, root)
            else:
                assert there is not None
                step = self._longer(inside, (x, root))
                inside, point = (x, root), there
                if x == far:
                    return sorted(found, key=lambda f: side * f[0]), End(far, "open")
            if beyond is None:
                x = inside[0] + side * step
            elif self._known(start, inside, beyond):
                break
            else:
                x = _between(inside, beyond)
        found.sort(key=lambda f: side * f[0])
        if beyond is None:
            return found, End(inside[0], "interrupted" if self._stop.is_set() else "unfinished")
        if not np.isfinite(beyond[1]):
            return found, End(inside[0], "failed")
        return found, End(_crossing(found, inside, beyond), "found")

    @staticmethod
    def _longer(before: tuple[float, float], now: tuple[float, float]) -> float:
        """Next step outwards: to just beyond the limit by the slope so far, at most twice the last one."""
        last, rise = abs(now[0] - before[0]), now[1] - before[1]
        wanted = last * (UNCERTAINTY.beyond_root - now[1]) / rise if rise > 0.0 else np.inf
        return float(np.clip(wanted, 0.3 * last, 2.0 * last))

    @staticmethod
    def _known(start: float, inside: tuple[float, float], beyond: tuple[float, float]) -> bool:
        """The limit is between two points that are near enough to interpolate."""
        if abs(beyond[0] - inside[0]) < UNCERTAINTY.bracket_share * abs(beyond[0] - start):
            return True
        return inside[1] > 0.4 * UNCERTAINTY.deviance_root and beyond[1] < 1.5 * UNCERTAINTY.deviance_root

    def _profile(
        self, k: int, low: tuple[list[tuple[float, float]], End], high: tuple[list[tuple[float, float]], End]
    ) -> Profile:
        p = self._parameters[k]
        points = [*reversed(low[0][1:]), *high[0]]
        known = [(x, root) for x, root in points if np.isfinite(root)]
        ends, at = (low[1], high[1]), float(self._fitted.scaled[k])
        ci95 = (p.physical(low[1].at), p.physical(high[1].at))
        quadratic = (p.physical(self._end(k, -1)), p.physical(self._end(k, 1)))
        return Profile(
            p.name, p.unit, p.log, p.physical(at), tuple(p.physical(x) for x, _ in known),
            tuple(root**2 for _, root in known), ci95, (ends[0].kind, ends[1].kind), quadratic,
            in_words(p, ci95, (ends[0].kind, ends[1].kind), quadratic),
        )  # fmt: skip


def _square(rows: np.ndarray) -> float:
    return float(rows @ rows)


def _between(inside: tuple[float, float], beyond: tuple[float, float]) -> float:
    """A value between two points that are on either side of the limit: nearer to where it is, but not at an end."""
    share = (UNCERTAINTY.deviance_root - inside[1]) / (beyond[1] - inside[1]) if np.isfinite(beyond[1]) else 0.5
    return inside[0] + (beyond[0] - inside[0]) * float(np.clip(share, 0.3, 0.7))


def _crossing(found: Sequence[tuple[float, float]], inside: tuple[float, float], beyond: tuple[float, float]) -> float:
    """Where the root of the deviance passes its limit, by monotone interpolation; of points that are as good the
    farthest counts, so that the limit lies between ``inside`` and ``beyond``."""
    kept: list[tuple[float, float]] = []
    for x, root in found:
        if np.isfinite(root):
            while kept and kept[-1][1] >= root:
                kept.pop()
            kept.append((x, root))
    xs, roots = np.array(kept).T
    if roots[-1] >= UNCERTAINTY.deviance_root and len(kept) > 2:
        return float(PchipInterpolator(roots, xs)(UNCERTAINTY.deviance_root))
    return float(np.interp(UNCERTAINTY.deviance_root, [inside[1], beyond[1]], [inside[0], beyond[0]]))
