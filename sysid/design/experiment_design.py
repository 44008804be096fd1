"""What experiments can determine, before they are made: the function behind ``thinshell plan``.

Each experiment is simulated with the values of the rig and seen through its sensors (rates, latencies, markers out
of sight), with the noise that the rig declares and the discretisation error as a nuisance, as a fit would see it.
What a fit would then know follows from the Fisher information of the readings (:mod:`sysid.solve.covariance`),
which holds near those values.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from sim_core.errors import ConfigError
from sim_core.rigs import Rig
from sim_core.rigs.motion import Experiment
from sysid.discretisation.refinement import discretisation
from sysid.model.load import load_run
from sysid.model.nuisance_parameters import KINDS, checked_kinds, has_bias, nuisance_parameters
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import fit_parameters, start_of
from sysid.noise.estimate import as_declared, undeclared
from sysid.observations.observations import Measured, Run
from sysid.progress.callback import Progress
from sysid.settings.solve import SOLVE
from sysid.simulate import simulate_to_bag
from sysid.solve.covariance import interval, names_undetermined, uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem
from sysid.uncertainty.nuisance_estimates import confounded_with_nuisances

WORTH_NAMING = 0.05
"""Share of what is known of a parameter from which a channel is named as its source."""

PREDICTIONS = 4
"""Predictions of each experiment: with derivatives, as it is, on a finer mesh, with a shorter step."""

SIMULATED, PREDICTED = 0.1, 0.6
"""Shares of the time, about, after which the experiments are simulated and the predictions made."""


@dataclass(frozen=True)
class Expected:
    """What would be known of one parameter. ``ci95``: around the value of the rig; ``sd``: in the fitted scale,
    which is logarithmic with ``log``; ``from_channels``: share of its information by channel, most first, all other
    parameters known."""

    name: str
    unit: str
    value: float
    ci95: tuple[float, float]
    sd: float
    log: bool
    determined: bool
    from_channels: dict[str, float]

    def spread(self) -> str:
        """Standard deviation over the value, or in its unit where that is zero, in words; '' where it is not
        determined."""
        if not self.determined:
            return ""
        if not self.log and self.value == 0.0:
            return f"{self.sd:.2g} {self.unit}".rstrip()
        return f"{100.0 * (self.sd if self.log else self.sd / abs(self.value)):.2g} %"


@dataclass(frozen=True)
class Outlook:
    """What one experiment, or several together, would tell."""

    experiments: tuple[str, ...]
    parameters: tuple[Expected, ...]
    correlation: list[list[float]]
    sentences: tuple[str, ...]


@dataclass(frozen=True)
class Plan:
    """``outlooks``: of each experiment, then of all together if there are several."""

    rig: str
    outlooks: tuple[Outlook, ...]

    def to_json(self) -> str:
        """All figures."""
        return json.dumps(asdict(self), indent=2, allow_nan=False)

    def table(self) -> str:
        """Parameters and what would be known of them, as text."""
        return "\n\n".join(_table(outlook) for outlook in self.outlooks)


def plan_experiments(
    rig: Rig,
    experiments: Sequence[Experiment],
    names: Sequence[str],
    on_progress: Progress | None = None,
    nuisance: Collection[str] = KINDS,
) -> Plan:
    """What ``experiments`` on ``rig`` would tell about the parameters ``names``, one by one and together,
    with the nuisances that a fit estimates with them (:func:`sysid.model.nuisance_parameters.checked_kinds`).

    Raises ``ConfigError`` for unknown parameters and for sensors that declare no noise, ``ConvergenceError`` where an
    experiment cannot be simulated.
    """
    silent = undeclared(rig)
    if silent:
        raise ConfigError(
            f"The rig {rig.name} declares no noise for {', '.join(silent)}, without which nobody can tell what the "
            "readings will determine.",
            "Declare the standard deviation under 'noise' of each, or leave the sensor out with --without.",
        )
    say = on_progress or (lambda share, text: None)
    kinds = checked_kinds(nuisance)
    asked = fit_parameters(rig, names)
    runs: list[Run] = []
    with tempfile.TemporaryDirectory() as folder:
        for k, experiment in enumerate(experiments):
            bag = Path(folder) / f"{k}"
            before = sum(other.name == experiment.name for other in experiments[:k])
            # Each recording has offsets of its own, also of the same experiment once more.
            name = f"{experiment.name} ({before + 1})" if before else experiment.name

            def share(done: float, text: str, at: int = k, name: str = name) -> None:
                say(SIMULATED * (at + done) / len(experiments), f"{name}, {text}")

            simulate_to_bag(rig, experiment, bag, noise=_none, on_progress=share)
            runs.append(replace(load_run(rig, bag), name=name))
    noise = {m.channel: as_declared(rig, m) for run in runs for m in run.measured}
    parameters = [*asked, *nuisance_parameters(rig, runs, asked, kinds)]
    start, bias = start_of(rig, parameters), has_bias(rig, runs, asked, kinds)
    predicted = _Count(say, PREDICTIONS * len(runs))
    with ParallelPredictor(os.cpu_count(), predicted) as engine:
        pending = [engine.submit_with_derivatives(rig, run, parameters, start) for run in runs]
        error_shapes = discretisation(engine, rig, runs)
        predictions = [p.result() for p in pending]
        outlooks = []
        groups = [[k] for k in range(len(runs))] + ([list(range(len(runs)))] if len(runs) > 1 else [])
        # With a bias what is known without one is asked once more
        # (:func:`sysid.uncertainty.nuisance_estimates.confounded_with_nuisances`).
        judged = _Readings(say, (2 if bias else 1) * sum(_readings(runs[k]) for group in groups for k in group))
        for group in groups:
            judged.begin(" and ".join(runs[k].name for k in group))
            own = [replace(d, shapes=tuple(d.shapes[k] for k in group)) for d in error_shapes]
            problem = Problem([runs[k] for k in group], noise, engine, own, bias=bias, on_channel=judged)
            fitted = problem.compare([predictions[k] for k in group], rig, parameters, start)
            fitted.residual[:] = 0.0
            outlooks.append(_outlook(problem, fitted, sorted(kinds)))
        say(1.0, "")
    return Plan(rig.name, tuple(outlooks))


class _Count:
    """Tells the progress of predictions that are made side by side. Called after each."""

    def __init__(self, say: Progress, all_of_them: int) -> None:
        self._say, self._all, self._done = say, all_of_them, -1
        self()

    def __call__(self) -> None:
        self._done += 1
        share = SIMULATED + (PREDICTED - SIMULATED) * self._done / self._all
        self._say(share, f"{self._done} of {self._all} predictions: derivatives, error of mesh and time step")


class _Readings:
    """Tells the progress of what follows from predictions, by the readings that have been put into equations. Called
    with each channel."""

    def __init__(self, say: Progress, all_of_them: int) -> None:
        self._say, self._all, self._done = say, all_of_them, 0

    def begin(self, experiments: str) -> None:
        self._words = f"what {experiments} would tell"
        self._tell()

    def __call__(self, measured: Measured) -> None:
        self._done += measured.values.size
        self._tell()

    def _tell(self) -> None:
        self._say(PREDICTED + (1.0 - PREDICTED) * self._done / self._all, self._words)


def _readings(run: Run) -> int:
    return sum(m.values.size for m in run.measured)


def _none(channel: str, kind: str, stamps: np.ndarray, clean: np.ndarray) -> np.ndarray:
    del channel, kind, stamps
    return np.zeros_like(clean)


def _outlook(problem: Problem, fitted: Fitted, kinds: Sequence[str]) -> Outlook:
    known = uncertainty(fitted)
    lacking = names_undetermined(known.findings)
    sources = _sources(fitted)
    expected = [
        Expected(
            p.name,
            p.unit,
            p.physical(fitted.scaled[k]),
            interval(p, fitted.scaled[k], known.sd[k]),
            float(known.sd[k]),
            p.log,
            p.name not in lacking,
            sources[k],
        )
        for k, p in enumerate(fitted.parameters)
        if not p.nuisance
    ]
    sentences = (*known.sentences, *confounded_with_nuisances(problem, fitted, kinds), *_still(fitted))
    asked = [k for k, p in enumerate(fitted.parameters) if not p.nuisance]
    correlation = known.correlation[np.ix_(asked, asked)].tolist()
    return Outlook(tuple(run.name for run in problem.runs), tuple(expected), correlation, sentences)


def _sources(fitted: Fitted) -> list[dict[str, float]]:
    """Share of each parameter's information that each channel brings, most first."""
    found: dict[str, np.ndarray] = {}
    at = 0
    for run, channel, times in fitted.labels:
        if run < 0:
            continue
        rows = fitted.jacobian[at : at + len(times)]
        at += len(times)
        found[channel] = found.get(channel, 0.0) + np.sum(rows**2, axis=0)
    whole = np.maximum(np.sum(list(found.values()), axis=0), 1e-300)
    shares = [{c: float(v[k] / whole[k]) for c, v in found.items()} for k in range(len(whole))]
    return [dict(sorted(s.items(), key=lambda item: -item[1])) for s in shares]


def _still(fitted: Fitted) -> list[str]:
    """A sentence for each friction on which no reading depends."""
    reach = np.linalg.norm(fitted.jacobian, axis=0) * [p.prior_sd for p in fitted.parameters]
    return [
        f"Nothing slides where {p.name} acts: a recording would at most say, if there is a touch at all, that it is at "
        "least the largest ratio of tangential to normal force. Plan a motion that slides there."
        for p, r in zip(fitted.parameters, reach, strict=True)
        if p.name.endswith(".friction") and r < 1.0 / SOLVE.undetermined_share
    ]


def _table(outlook: Outlook) -> str:
    title = " and ".join(outlook.experiments) + (" together" if len(outlook.experiments) > 1 else "")
    lines = [title, f"{'parameter':<34}{'value':>13}  {'expected 95 % interval':<27}{'unit':<8}{'sd':<12}from"]
    for e in outlook.parameters:
        low, high = e.ci95
        in_words = f"{low:.5g} .. {high:.5g}" if e.determined else "not determined"
        sources = ", ".join(f"{c} {100 * s:.0f} %" for c, s in e.from_channels.items() if s > WORTH_NAMING)
        lines.append(
            f"{e.name:<34}{e.value:>13.5g}  {in_words:<27}{e.unit:<8}{e.spread():<12}"
            f"{sources if e.determined else ''}".rstrip()
        )
    return "\n".join([*lines, *outlook.sentences])
