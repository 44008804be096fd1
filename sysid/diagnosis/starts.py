"""Where refits of sets of effects begin: by the screening, and by simulations of the most promising there."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_core.effects import RecordingScales
from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.diagnosis.candidates import Hypothesis
from sysid.model.parameters import FitParameter, fit_parameters, rig_in, start_of
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


@dataclass(frozen=True)
class Start:
    """A set of hypotheses and where a refit begins: factors of their amplitudes, shift ``(p,)`` of the parameters of
    the model that they are added to, which has the effects of ``earlier`` already."""

    hypotheses: tuple[Hypothesis, ...]
    factors: tuple[np.ndarray, ...]
    shift: np.ndarray
    earlier: tuple[Hypothesis, ...] = ()

    @property
    def whole(self) -> tuple[Hypothesis, ...]:
        """All effects of the model."""
        return (*self.earlier, *self.hypotheses)

    @property
    def names(self) -> frozenset[str]:
        return frozenset(h.effect.name for h in self.whole)

    @property
    def origin(self) -> Hashable:
        """Points of the grids of :mod:`sysid.diagnosis.candidates` that it begins at."""
        return tuple((h.key, tuple(h.shape.items()), tuple(a.typical for a in h.amplitudes)) for h in self.hypotheses)


def amended(rig: Rig, start: Start) -> Rig:
    """The rig with the effects where a refit begins."""
    found = {h.key: h.values(list(f)) for h, f in zip(start.hypotheses, start.factors, strict=True)}
    return rig.model_copy(update={"effects": {**rig.effects, **found}})


def own_parameters(rig: Rig, hypotheses: Sequence[Hypothesis], scales: RecordingScales) -> list[FitParameter]:
    """The parameters of the effects, with priors that fit the recordings."""
    found = []
    for h in hypotheses:
        by_name = {p.name: p.fitted_to(scales) for p in h.effect.parameters}
        names = [n for n in rig.effects[h.key] if by_name[n].lower < by_name[n].upper]
        for p in fit_parameters(rig, [f"effects.{h.key}.{n}" for n in names]):
            found.append(replace(p, prior_sd=by_name[p.target.rsplit(".", 1)[1]].prior_sd))
    return found


def begun_at(begun: Fitted, start: Start, scales: RecordingScales) -> tuple[Rig, list[FitParameter], np.ndarray]:
    """Rig that the priors pull to, parameters of baseline and effects, and their scaled values where a refit begins."""
    rig = amended(begun.rig, start)
    own = own_parameters(rig, start.hypotheses, scales)
    parameters = [*begun.parameters, *own]
    scaled = np.concatenate([begun.scaled + start.shift, start_of(rig, own)])
    limits = np.array([p.scaled_bounds for p in parameters]).T
    centre = begun.centre.model_copy(update={"effects": {**begun.centre.effects, **_at_rest(rig, start)}})
    return centre, parameters, np.clip(scaled, *limits)


def best_starts(
    problem: Problem, begun: Fitted, starts: Sequence[Start], scales: RecordingScales, failed: dict[str, str]
) -> list[Start]:
    """The starts of the sets that simulations there explain best, at most ``DIAGNOSIS.refitted_sets`` sets, and
    ``DIAGNOSIS.refitted_second_starts`` more of the first of them, with another shape: near a snap the best start may
    end in a branch that no refit leaves.

    Where the baseline has taken up part of an effect, the way back to its own values is long and not straight. So what
    one more linear step of its parameters takes away of the misfit does not count, and each of these sets is simulated
    with the rig's own values of them as well.
    """
    few = len({s.names for s in starts}) <= DIAGNOSIS.refitted_sets and len(starts) <= DIAGNOSIS.refitted_sets
    lost: dict[frozenset[str], str] = {}
    found = [] if few else _simulated(problem, begun, starts, scales, lost)
    chosen = list(starts)
    if not few:
        chosen = _least_of_each(found, lambda s: s.names)[: DIAGNOSIS.refitted_sets]
        known = {s.origin for s in chosen}
        others = [s for s in _least_of_each(found, lambda s: s.origin) if s.origin not in known]
        chosen += [s for s in others if s.names == chosen[0].names][: DIAGNOSIS.refitted_second_starts]
    if not any(s.earlier for s in chosen):
        home = start_of(begun.centre, begun.parameters) - begun.scaled
        further = [*(chosen if few else ()), *(replace(s, shift=home) for s in chosen)]
        found += _simulated(problem, begun, further, scales, lost)
        origins = {s.origin for s in chosen}
        chosen = _least_of_each([pair for pair in found if pair[1].origin in origins], lambda s: s.origin)
    done = {s.names for s in chosen} | {s.names for _, s in found}
    failed.update({" and ".join(sorted(n)): why for n, why in lost.items() if n not in done})
    return chosen


def _least_of_each(found: Sequence[tuple[float, Start]], kind: Callable[[Start], Hashable]) -> list[Start]:
    """The start of each kind that leaves the least, best first."""
    best: dict[Hashable, Start] = {}
    for _, start in sorted(found, key=lambda pair: pair[0]):
        best.setdefault(kind(start), start)
    return list(best.values())


def _simulated(
    problem: Problem, begun: Fitted, starts: Sequence[Start], scales: RecordingScales, lost: dict[frozenset[str], str]
) -> list[tuple[float, Start]]:
    """The starts that can be simulated, with what each leaves (:func:`_least`); ``lost`` is told why others cannot."""
    jobs = []
    for start in starts:
        centre, parameters, at = begun_at(begun, start, scales)
        rigs = [rig_in(centre, parameters, at, run.name) for run in problem.runs]
        runs = zip(rigs, problem.runs, strict=True)
        jobs.append((start, at, [problem.engine.submit(rig, run) for rig, run in runs]))
    found: list[tuple[float, Start]] = []
    for start, at, row in jobs:
        try:
            residual = problem.assemble([job.result() for job in row], [], at).residual
        except ThinshellError as error:
            lost[start.names] = f"could not be simulated: {error}"
            continue
        found.append((_least(begun, residual), start))
    return found


def _least(begun: Fitted, residual: np.ndarray) -> float:
    """Least chi-square of a whitened residual along the derivatives of a model, within what is known of its parameters;
    its chi-square where other readings are in sight than in that model."""
    data = len(begun.residual) - begun.pulls
    if len(residual) != data or not begun.parameters:
        return float(residual @ residual)
    j = begun.jacobian[:data]
    known = np.array([p.known_sd or p.prior_sd for p in begun.parameters])
    slope = j.T @ residual
    return float(residual @ residual - slope @ np.linalg.solve(j.T @ j + np.diag(1.0 / known**2), slope))


def _at_rest(rig: Rig, start: Start) -> dict[str, dict[str, float]]:
    """Values that the priors pull to: amplitudes at nothing, if a fit can stand there."""
    found = {}
    for h in start.hypotheses:
        values = dict(rig.effects[h.key])
        for a in h.amplitudes:
            if np.isfinite(a.none) and not a.parameter.log:
                values[a.parameter.name] = a.none
        found[h.key] = values
    return found
