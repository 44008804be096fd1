"""The result of a fit as data: what is written to JSON and shown in the report."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.fit.marker_field import MarkerField
from sysid.noise.estimate import declared_noise, quantities
from sysid.observations.observations import UNITS, Measured, Run
from sysid.settings.noise import NOISE
from sysid.solve.covariance import Finding, interval, uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.outliers import Outliers
from sysid.solve.residuals import Problem
from sysid.uncertainty.goodness_of_fit import no_success
from sysid.uncertainty.nuisance_estimates import Nuisance
from sysid.uncertainty.profile_likelihood import Profile

NOISE_USED = (
    "noise: what the fit used, estimated from the recordings; declared: what the rig says, which is used where it is "
    f"more than {NOISE.declared_noise_ratio:g} times the estimate."
)
"""Which of the two is used, in words."""

LOOK_FIRST = (
    "What is said of clocks, cameras, biases and end effectors can also make up for a parameter that is fixed at a "
    "wrong value, or for physics that the rig lacks: check it on the robot before it goes into the rig."
)
"""Next to what a fit says to write into a rig."""


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter. ``sd``: in the fitted scale; ``log``: that scale is logarithmic; ``bag``: the recording
    that has this value for itself."""

    name: str
    unit: str
    start: float
    value: float
    ci95: tuple[float, float]
    sd: float
    log: bool
    at_bound: bool
    bag: str = ""


@dataclass(frozen=True)
class ChannelError:
    """Root-mean-square error of one channel of one run in its own unit (wrench: forces; torques apart). ``noise``: what
    the fit used; ``declared``: what the rig says; ``own``: error of mesh and time step, as far as one refinement of the
    recordings that were fitted shows it; ``before_over_noise``, ``after_over_noise``: the errors as multiples of the
    noise, None where one of the two is not known."""

    run: str
    channel: str
    quantity: str
    unit: str
    before: float
    after: float
    noise: float
    held_out: bool
    declared: float | None = None
    own: float = 0.0
    before_over_noise: float | None = field(init=False, default=None)
    after_over_noise: float | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        for name, error in (("before_over_noise", self.before), ("after_over_noise", self.after)):
            known = error is not None and np.isfinite(error) and np.isfinite(self.noise) and self.noise > 0.0
            object.__setattr__(self, name, float(error / self.noise) if known else None)


@dataclass(frozen=True)
class Series:
    """One column of a channel for plotting: measured (None where missing), predicted before and after the
    fit (NaN where out of sight); ``outliers``: times and readings that were left out."""

    run: str
    channel: str
    label: str
    unit: str
    held_out: bool
    t: list[float]
    measured: list[float | None]
    before: list[float]
    after: list[float]
    outliers: list[tuple[float, float]] = field(default_factory=list)


def not_converged(message: str) -> str:
    """What is said, before anything else, of a fit that did not converge; ``message``: how its search ended."""
    why = message.rstrip(".") or "the search did not say why"
    return f"The fit did not converge: {why}. Take its values as a start, not as a result."


@dataclass
class FitResult:
    """Everything that a fit found. ``misfit``: mean squared whitened residual
    (:attr:`sysid.solve.optimum.Fitted.misfit`); ``reduced_chi2``: the same sum over degrees of freedom;
    ``evaluations``: of all searches; ``nuisances``: what was estimated with what was asked for; ``profiles``:
    deviance against each parameter, where that was asked for (:mod:`sysid.uncertainty.profiler`); ``outliers``:
    readings that were left out (:mod:`sysid.solve.outliers`); ``unexplained``: in which quantities more than noise is
    left, in words (:mod:`sysid.uncertainty.goodness_of_fit`); ``contradicted``: what was known before and the
    recordings contradict (:mod:`sysid.uncertainty.prior_data_conflict`); ``cautions``: where values and intervals rest
    on the error of mesh and time step, in words; ``undetermined``: names of the parameters that the data do not
    determine, or of which they only give a limit; ``noise_multiples``: root mean square of what is left over
    the noise, by quantity (:func:`sysid.uncertainty.goodness_of_fit.noise_multiples`); ``tried``: mistakes of set-up
    that were tried before the fit, in words (:mod:`sysid.setup_check`)."""

    rig: str
    estimates: list[Estimate]
    correlation: list[list[float]]
    identifiability: list[str]
    errors: list[ChannelError]
    misfit: float
    reduced_chi2: float
    converged: bool
    message: str
    evaluations: int
    seconds: float
    noise: dict[str, dict[str, Any]]
    notes: list[str]
    provenance: dict[str, Any]
    series: list[Series] = field(default_factory=list)
    marker_fields: list[MarkerField] = field(default_factory=list)
    nuisances: list[Nuisance] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    profiles: list[Profile] = field(default_factory=list)
    outliers: list[Outliers] = field(default_factory=list)
    unexplained: list[str] = field(default_factory=list)
    contradicted: list[str] = field(default_factory=list)
    cautions: list[str] = field(default_factory=list)
    undetermined: set[str] = field(default_factory=set)
    noise_multiples: dict[str, float] = field(default_factory=dict)
    tried: list[str] = field(default_factory=list)

    @property
    def no_success(self) -> str:
        """What is said first where the fitted rig misses the recordings by far more than their noise; else empty."""
        return no_success(self.noise_multiples, self.tried)

    def to_json(self) -> dict[str, Any]:
        """Plain data without the series and the fields of markers, which are for the report."""
        data = asdict(replace(self, series=[], marker_fields=[]))
        del data["series"], data["marker_fields"]
        return {**data, "undetermined": sorted(self.undetermined), "no_success": self.no_success}

    def write(self, path: Path) -> None:
        """Write ``fit.json``."""
        path.write_text(json.dumps(self.to_json(), indent=2, allow_nan=False, default=float) + "\n")

    def table(self) -> str:
        """Parameters and errors as text, below whether they are to be trusted."""
        lines = [] if self.converged else [not_converged(self.message), ""]
        lines += [self.no_success, ""] if self.no_success else []
        for sentence in [*self.contradicted, *self.unexplained, *self.cautions]:
            lines += [sentence, ""]
        undetermined = self.undetermined
        lines += [f"{'parameter':<34}{'value':>13}  {'95 % interval':<27}unit"]
        for e in self.estimates:
            low, high = e.ci95
            marks = [*["not determined"] * (e.name in undetermined), *["at its bound"] * e.at_bound]
            mark = f"  ({', '.join(marks)})" if marks else ""
            lines.append(f"{e.name:<34}{e.value:>13.5g}  {f'{low:.5g} .. {high:.5g}':<27}{e.unit}{mark}")
        lines += ["", *self._profile_table(), *self._nuisance_table()]
        runs = [c.run + (" (held out)" if c.held_out else "") for c in self.errors]
        wide = max(24, *map(len, runs)) + 2 if runs else 26
        lines.append(f"{'run':<{wide}}{'channel':<22}{'before':>11}{'after':>11}{'noise':>11}{'declared':>11}  unit")
        for run, c in zip(runs, self.errors, strict=True):
            declared = "" if c.declared is None else f"{c.declared:.4g}"
            lines.append(
                f"{run:<{wide}}{c.channel + ' ' + c.quantity:<22}{c.before:>11.4g}{c.after:>11.4g}"
                f"{c.noise:>11.4g}{declared:>11}  {c.unit}"
            )
        if self.errors:
            lines.append(NOISE_USED)
        first = [LOOK_FIRST] if self.remarks else []
        lines += ["", *self.identifiability, *self.remarks, *first, *(f"Note: {note}" for note in self.notes)]
        return "\n".join(lines)

    def _profile_table(self) -> list[str]:
        """Intervals from the profile likelihood, as text."""
        if not self.profiles:
            return []
        lines = [f"{'by profile likelihood':<34}{'value':>13}  {'95 % interval':<27}unit"]
        lines += [f"{p.name:<34}{p.value:>13.5g}  {p.text():<26} {p.unit}" for p in self.profiles]
        return [*lines, ""]

    def _nuisance_table(self) -> list[str]:
        """What the data tell of nuisances, as text."""
        informed = [n for n in self.nuisances if n.informed]
        known = {n.name for n in informed}
        vague = [n for n in self.nuisances if not n.informed and not n.bias]
        rest = list(dict.fromkeys(n.name + (f" in {n.run}" if n.name in known else "") for n in vague))
        lines = [f"{'estimated with them':<34}{'value':>13}  {'95 % interval':<30}unit"] if informed else []
        for n in informed:
            low, high = n.ci95
            run = f"  {n.run}" if n.run else ""
            lines.append(f"{n.name:<34}{n.value:>13.6g}  {f'{low:.6g} .. {high:.6g}':<30}{n.unit}{run}")
        if rest:
            lines.append(f"The data do not tell {', '.join(rest)}, known no better than before.")
        return [*lines, ""] if lines else []


def estimates_of(fitted: Fitted, start: np.ndarray) -> tuple[list[Estimate], list[list[float]], list[Finding], float]:
    """Estimates of what was asked for with intervals, correlation, what is not determined, reduced chi-square."""
    known = uncertainty(fitted)
    out = []
    asked = [k for k, p in enumerate(fitted.parameters) if not p.nuisance]
    for k in asked:
        p = fitted.parameters[k]
        out.append(
            Estimate(
                p.name,
                p.unit,
                p.physical(start[k]),
                p.physical(fitted.scaled[k]),
                interval(p, fitted.scaled[k], known.sd[k]),
                float(known.sd[k]),
                p.log,
                p.at_bound(float(fitted.scaled[k]), float(known.sd[k])),
                p.bag,
            )
        )
    return out, known.correlation[np.ix_(asked, asked)].tolist(), list(known.findings), known.reduced_chi2


def rms_errors(
    problem: Problem, before: Fitted, after: Fitted, held_out: bool, own: Mapping[tuple[str, str], float]
) -> list[ChannelError]:
    """Root-mean-square errors by run, channel and quantity, over the samples that both models have in sight. ``own``:
    of mesh and time step, by channel and quantity (:func:`sysid.discretisation.refinement.error_sizes`).

    A bias is of the recording, not of the rig: either model has the best one where the problem allows it.

    A quantity without such a sample is left out (:func:`out_of_sight` says so).
    """
    out = []
    for i, run in enumerate(problem.runs):
        for m in run.measured:
            for (quantity, columns, unit), (whole, _) in zip(_quantities(m), quantities(m), strict=True):
                misses = _misses(problem, m, columns, i, before, after)
                if misses is None:
                    continue
                out.append(
                    ChannelError(
                        run.name,
                        m.channel,
                        quantity,
                        UNITS[m.kind][unit],
                        _rms(misses[0]),
                        _rms(misses[1]),
                        _rms(problem.noise[m.channel].sigma[columns]),
                        held_out,
                        _rms(np.broadcast_to(declared_noise(after.rig, m.channel), m.values.shape[1])[columns]),
                        own.get((m.channel, whole), 0.0),
                    )
                )
    return out


def out_of_sight(problem: Problem, before: Fitted, after: Fitted) -> list[str]:
    """A note for each channel that is measured but nowhere in sight of both models, or not all in sight of the last."""
    notes = []
    for i, run in enumerate(problem.runs):
        for m in run.measured:
            there = np.isfinite(m.values)
            if not there.any():
                continue
            if any(
                there[:, columns].any() and _misses(problem, m, columns, i, before, after) is None
                for _, columns, _ in _quantities(m)
            ):
                notes.append(
                    f"{run.name}: {m.channel}: the simulated points are out of sight where they are measured, so no "
                    "error is given. Check the pose and the intrinsics of the camera."
                )
                continue
            hidden = np.mean(np.isnan(after.predictions[i].values[m.channel][there]))
            if hidden:
                why = (
                    "of points that the fitted rig has out of sight, and are not compared. Check the pose and the "
                    "intrinsics of the camera."
                    if m.kind == "tracks"
                    else "of instants before or after the poses that were recorded, by the latency that was fitted, "
                    "and are not compared."
                )
                notes.append(f"{run.name}: {m.channel}: {100 * hidden:.2g} % of the readings are {why}")
    return notes


def _quantities(measured: Measured) -> list[tuple[str, slice, int]]:
    """Name, columns and number of the unit of what shares a unit."""
    if measured.kind == "wrench":
        return [("force", slice(0, 3), 0), ("torque", slice(3, 6), 1)]
    return [("", slice(None), 0)]


def _misses(
    problem: Problem, measured: Measured, columns: slice, index: int, before: Fitted, after: Fitted
) -> tuple[np.ndarray, np.ndarray] | None:
    """Measured minus predicted where both models predict something; None where they nowhere do."""
    was, now = (
        measured.values[:, columns] - problem.tared(fitted, index, measured)[:, columns] for fitted in (before, after)
    )
    both = np.isfinite(was) & np.isfinite(now)
    return (was[both], now[both]) if both.any() else None


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def plot_series(
    problem: Problem, before: Fitted, after: Fitted, held_out: bool, raw: Sequence[Run] = (), most: int = 6
) -> list[Series]:
    """The columns of each channel that move most, thinned for plotting; ``raw``: the runs with what was left out."""
    out = []
    for i, run in enumerate(problem.runs):
        for number, m in enumerate(run.measured):
            whole = raw[i].measured[number].values if raw else m.values
            finite = [column[np.isfinite(column)] for column in m.values.T]
            spread = np.array([np.std(column) if len(column) else -1.0 for column in finite])
            chosen = np.sort(np.argsort(-spread, kind="stable")[: min(most, int(np.sum(spread >= 0.0)))])
            step = max(1, len(m.t) // 600)
            was, now = (problem.tared(fitted, i, m) for fitted in (before, after))
            for k in chosen:
                unit = UNITS[m.kind][1 if m.kind == "wrench" and k >= 3 else 0]
                values = m.values[::step, k]
                gone = np.isnan(m.values[:, k]) & np.isfinite(whole[:, k])
                out.append(
                    Series(
                        run.name,
                        m.channel,
                        m.labels[k],
                        unit,
                        held_out,
                        m.t[::step].tolist(),
                        [float(v) if np.isfinite(v) else None for v in values],
                        was[::step, k].tolist(),
                        now[::step, k].tolist(),
                        [(float(t), float(v)) for t, v in zip(m.t[gone], whole[gone, k], strict=True)],
                    )
                )
    return out
