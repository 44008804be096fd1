"""What a fit found of the nuisances (:mod:`sysid.model.nuisance_parameters`): estimates, intervals, and what to do
about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_core.rigs import Rig, with_parameters
from sim_core.rigs.pose_offset import OFFSETS
from sysid.model.nuisance_parameters import bias_sd, kind_of
from sysid.model.parameters import FitParameter, start_of
from sysid.model.predictor import Prediction
from sysid.noise.estimate import quantities
from sysid.observations.observations import UNITS, Measured
from sysid.settings.solve import SOLVE
from sysid.settings.uncertainty import UNCERTAINTY
from sysid.solve.covariance import interval, marginal, uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

REMEDIES = {
    "time": "the time offsets were known: share one clock, and leave 'time' out of --nuisance",
    "bias": "force sensors had no bias: tare them with nothing in touch, and leave 'bias' out of --nuisance",
    "pose": "the end effectors' poses were known: calibrate how the tools are mounted, and write how well into the rig "
    "(offset_sd_m, offset_sd_deg), or leave 'pose' out of --nuisance",
    "camera": "the cameras' intrinsics were known: calibrate them, and leave 'camera' out of --nuisance",
}


@dataclass(frozen=True)
class Nuisance:
    """One nuisance. ``run``: the recording that it is of, empty for what is of all; ``start``: value of the rig;
    ``sd``, ``prior_sd``: after and before the fit, in the fitted scale, logarithmic with ``log``; ``tied``: what is
    changed in proportion."""

    name: str
    run: str
    unit: str
    start: float
    value: float
    ci95: tuple[float, float]
    sd: float
    prior_sd: float
    log: bool
    tied: tuple[str, ...]

    @property
    def informed(self) -> bool:
        """The data say more of it than was known before."""
        return self.sd < SOLVE.undetermined_share * self.prior_sd

    @property
    def bias(self) -> bool:
        """It is the bias of a sensor in a recording."""
        return self.name.endswith(" bias")

    @property
    def off(self) -> float:
        """Distance from the value of the rig, in the fitted scale."""
        return float(np.log(self.value / self.start)) if self.log else self.value - self.start

    @property
    def far(self) -> bool:
        """It differs from what the rig says."""
        return self.informed and abs(self.off) > UNCERTAINTY.nuisance_far_sd * self.sd


def nuisances_of(problem: Problem, fitted: Fitted) -> list[Nuisance]:
    """All nuisances with their intervals."""
    whole = with_explicit_bias(problem, fitted)
    sd = uncertainty(whole).sd
    runs = [*(p.bag for p in fitted.parameters), *(run for run, _ in _biases(problem))]
    start = np.concatenate([start_of(fitted.centre, fitted.parameters), np.zeros(len(runs) - len(fitted.parameters))])
    return [
        Nuisance(
            p.target, run, p.unit, p.physical(first), p.physical(at), interval(p, at, spread), float(spread),
            p.prior_sd, p.log, p.tied,
        )
        for p, run, first, at, spread in zip(whole.parameters, runs, start, whole.scaled, sd, strict=True)
        if p.nuisance
    ]  # fmt: skip


def _biases(problem: Problem) -> list[tuple[str, FitParameter]]:
    """Each bias that is eliminated as a parameter, with the name of its run."""
    found = []
    for run in problem.runs:
        for m in run.measured:
            sd = bias_sd(m) if problem.bias else None
            if sd is None:
                continue
            seen = _seen(m)
            for (_, group), unit in zip(quantities(m), UNITS[m.kind], strict=True):
                for j in np.intersect1d(group, seen):
                    name = f"{m.channel} {m.labels[j]} bias"
                    found.append((run.name, FitParameter(name, unit, False, -np.inf, np.inf, float(sd[j]), "", True)))
    return found


def _seen(measured: Measured) -> np.ndarray:
    """Columns that a recording has."""
    return np.flatnonzero(np.isfinite(measured.values).any(axis=0))


def with_explicit_bias(problem: Problem, fitted: Fitted) -> Fitted:
    """The same fit with the biases of wrenches as parameters of their own, instead of eliminated."""
    biases = [p for _, p in _biases(problem)]
    if not biases:
        return fitted
    p, q = len(fitted.parameters), len(biases)
    plain = Problem(problem.runs, problem.noise, problem.engine, problem.error_shapes, problem.prior)
    predictions: list[Prediction] = []
    values: list[float] = []
    for i, (run, prediction) in enumerate(zip(problem.runs, fitted.predictions, strict=True)):
        amended, slopes = dict(prediction.values), {}
        for m in run.measured:
            extra = np.zeros((*m.values.shape, q))
            if bias_sd(m) is not None:
                columns = _seen(m)
                extra[:, columns, len(values) + np.arange(len(columns))] = 1.0
                values += list(problem.bias_of(fitted, i, m)[columns])
                amended[m.channel] = problem.read(fitted, i, m)
            slopes[m.channel] = np.concatenate([prediction.derivatives[m.channel], extra], axis=2)
        predictions.append(replace(prediction, values=amended, derivatives=slopes))
    scaled = np.concatenate([fitted.scaled, values])
    names = [b.name for b in (*fitted.parameters, *biases)]
    r, j, labels, sizes, sight, still, _ = plain.assemble(predictions, names, scaled)
    width = np.array([b.prior_sd for b in biases])
    first = len(fitted.residual) - fitted.pulls
    pulls = np.block([[fitted.jacobian[first:], np.zeros((fitted.pulls, q))], [np.zeros((q, p)), np.diag(1.0 / width)]])
    return replace(
        fitted,
        parameters=[*fitted.parameters, *biases],
        scaled=scaled,
        residual=np.concatenate([r, fitted.residual[first:], np.array(values) / width]),
        jacobian=np.vstack([j, pulls]),
        still=None if still is None else np.vstack([still, pulls]),
        labels=[*labels, (-1, "prior", np.zeros(len(pulls)))],
        sizes=sizes,
        sight=np.concatenate([sight, np.ones(len(pulls), dtype=bool)]),
    )


def remarks(rig: Rig, found: Sequence[Nuisance], trusted: bool) -> list[str]:
    """A sentence for each nuisance that is not what the rig says, and what to do about it where the fit is ``trusted``:
    next to a misfit, or parameters that are not determined, it may stand for those."""

    def remark(what: str, remedy: str) -> str:
        return f"{what}: {remedy}." if trusted else f"{what}, or that stands for something else."

    said = []
    for n in _of_all(found):
        owner, _, quantity = n.name.rpartition(".")
        if not n.far:
            continue
        low, high = n.ci95
        half = 0.5 * (high - low) / 1.96
        if quantity == "latency_s":
            stated = f", where the rig says {1e3 * n.start:.4g} ms" if n.start else ""
            what = f"The stream {_topic(rig, owner)} {_way(n)}{stated}"
            said.append(remark(what, f"write {n.name} = {n.value:.4g} into the rig"))
            continue
        if quantity in OFFSETS:
            axis = quantity.removeprefix("offset_").split("_")[0]
            if n.unit == "m":
                what = f"shifted by {_pair(1e3 * n.off, 1e3 * half)} mm along {axis}"
            else:
                what = f"turned by {_pair(n.off, half)} deg about {axis[1:]}"
            stated = f", where the rig says {n.start:.4g} {n.unit}" if n.start else ""
            calibrated = "it is" if owner in rig.cameras else "its poses are"
            remedy = f"write {n.name} = {n.value:.4g} into the rig, or correct how {calibrated} calibrated"
            whose = "camera" if owner in rig.cameras else "end effector"
            said.append(remark(f"The {whose} {owner} is {what} of its own frame{stated}", remedy))
            continue
        write = " and ".join([f"{n.name} = {n.value:.6g}", *(f"{t} in proportion" for t in n.tied)])
        if n.log:
            what = f"The scale of the camera {owner} is off by {_pair(100 * n.off, 100 * n.sd)} %"
        else:
            what = f"{n.name} is off by {_pair(n.off, half)} {n.unit}"
        said.append(remark(what, f"write {write} into the rig, or calibrate the camera"))
    for name, there in _by_name(found).items():
        if _differ(there):
            ways = "; ".join(f"{_way(n)} in {n.run}" for n in there if n.informed)
            said.append(
                f"The stream {_topic(rig, name.rpartition('.')[0])} has another offset in time in each recording: "
                f"{ways}. Let one clock stamp it and the poses. Held-out recordings are compared at the mean of these."
            )
    for run, channel in dict.fromkeys((n.run, n.name.split(" ")[0]) for n in found if n.far and n.bias):
        parts = [
            f"{n.name.removeprefix(channel + ' ').removesuffix(' bias')} {_pair(n.value, n.sd)} {n.unit}"
            for n in found
            if n.far and n.run == run and n.name.startswith(channel + " ")
        ]
        said.append(remark(f"In {run}, {channel} has a bias of {', '.join(parts)}", "tare it with nothing in touch"))
    return said


def _by_name(found: Sequence[Nuisance]) -> dict[str, list[Nuisance]]:
    """What each recording has for itself, but for biases."""
    names = dict.fromkeys(n.name for n in found if n.run and not n.bias)
    return {name: [n for n in found if n.name == name] for name in names}


def _differ(there: Sequence[Nuisance]) -> bool:
    """Whether recordings do not have the same: one is further from the mean than it may be, var(v - mean) = var(v) -
    var(mean) for a mean that has v in it with the weight 1 / var(v)."""
    there = [n for n in there if n.informed]
    if len(there) < 2:
        return False
    mean = _mean(there)
    return any(abs(n.value - mean.value) > UNCERTAINTY.nuisance_far_sd * np.sqrt(n.sd**2 - mean.sd**2) for n in there)


def _mean(there: Sequence[Nuisance]) -> Nuisance:
    """What those recordings that tell it do so together; if none does, what was known before."""
    there = [n for n in there if n.informed] or [replace(there[0], value=there[0].start)]
    weights = np.array([n.sd**-2 for n in there])
    value, sd = float(np.average([n.value for n in there], weights=weights)), float(np.sum(weights) ** -0.5)
    return replace(there[0], run="", value=value, sd=sd, ci95=(value - 1.96 * sd, value + 1.96 * sd))


def _of_all(found: Sequence[Nuisance]) -> list[Nuisance]:
    """What is of all recordings, and what is the same in each."""
    same = {name: there for name, there in _by_name(found).items() if not _differ(there)}
    return [n for n in found if not n.run] + [_mean(there) for there in same.values()]


def with_mean_nuisances(rig: Rig, found: Sequence[Nuisance]) -> Rig:
    """The rig with what each recording has for itself as it is on average, by how well each tells it."""
    return with_parameters(rig, {name: _mean(there).value for name, there in _by_name(found).items()})


def _topic(rig: Rig, owner: str) -> str:
    source = rig.sensors.get(owner)
    return source.topic if source is not None else rig.cameras[owner].topics.marker_tracks


def _way(n: Nuisance) -> str:
    """By how much a stream is late, in words."""
    low, high = n.ci95
    half = 0.5 * (high - low) / 1.96
    return f"{'lags' if n.value > 0.0 else 'leads'} by {_pair(1e3 * abs(n.value), 1e3 * half)} ms"


def _pair(value: float, sd: float) -> str:
    """A value with its standard deviation, to two digits of the latter."""
    digits = max(0, 1 - int(np.floor(np.log10(sd)))) if sd > 0.0 else 3
    return f"{value:.{digits}f} +- {sd:.{digits}f}"


def confounded_with_nuisances(problem: Problem, fitted: Fitted, kinds: Sequence[str]) -> list[str]:
    """A sentence for each parameter that the data would determine if some kind of nuisance were known."""
    if not problem.bias and not any(p.nuisance for p in fitted.parameters):
        return []
    unbiased = _without_bias(problem, fitted)
    now = _spread(fitted, fitted.jacobian, ())
    known = {k: _spread(fitted, unbiased if k == "bias" else fitted.jacobian, (k,)) for k in kinds}
    known["every nuisance"] = _spread(fitted, unbiased, kinds)
    said = []
    for name, spread in now.items():
        if spread < SOLVE.undetermined_share:
            continue
        kind = next((k for k, there in known.items() if there[name] < SOLVE.undetermined_share), None)
        if kind is not None:
            said.append(f"{name} would be determined if {REMEDIES.get(kind, 'no nuisance was allowed for')}.")
    return said


def _without_bias(problem: Problem, fitted: Fitted) -> np.ndarray:
    """The Jacobian of the same fit with the biases of wrenches known."""
    if not problem.bias:
        return fitted.jacobian
    plain = Problem(
        problem.runs, problem.noise, problem.engine, problem.error_shapes, problem.prior, on_channel=problem.on_channel
    )
    data = plain.assemble(fitted.predictions, [p.name for p in fitted.parameters], fitted.scaled)[1]
    return np.vstack([data, fitted.jacobian[len(fitted.jacobian) - fitted.pulls :]])


def _spread(fitted: Fitted, jacobian: np.ndarray, known: Sequence[str]) -> dict[str, float]:
    """Standard deviation of the parameters that were asked for, in units of what they are judged by, as the noise alone
    leaves it with the nuisances of some kinds known."""
    rig = fitted.centre
    kept = [k for k, p in enumerate(fitted.parameters) if not (p.nuisance and kind_of(rig, p.target) in known)]
    parameters, values, vectors = marginal(
        replace(
            fitted,
            parameters=[fitted.parameters[k] for k in kept],
            scaled=fitted.scaled[kept],
            jacobian=jacobian[:, kept],
        )
    )
    variance = np.sum(vectors**2 / np.maximum(values, 1e-300), axis=1)
    return {p.name: float(np.sqrt(v)) for p, v in zip(parameters, variance, strict=True)}
