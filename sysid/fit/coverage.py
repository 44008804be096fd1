"""How often 95 % intervals hold the truth: the function behind ``thinshell coverage``.

Each case draws true values and, independently, values to start from; simulates the experiments with the true ones,
on a finer mesh with a shorter step, with the noise that the rig declares and with nuisances (offsets in time,
biases of wrenches, cameras that are off) drawn from the priors that a fit has of it; fits; and looks whether the truth
is inside the interval that the curvature at the best fit gives, without the look along the likelihood that ``thinshell
fit`` takes as well. Cases are numbered, so that any of them can be run again by itself; one process a core.

A fit learns the error of its mesh and time step by halving them (:mod:`sysid.discretisation.refinement`). A truth
of half the mesh and half the step differs from the fit's model by just what it has learnt, so the usual truth is three
times finer.

The noise of forces and torques may be coloured, as that of a sensor with a filter: n_k = rho n_{k-1} + sqrt(1 - rho^2)
w_k, with w white and rho from sample to sample; its standard deviation stays what the rig declares.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from sim_core.errors import ThinshellError
from sim_core.processes import worker_ended, worker_pool
from sim_core.rigs import Rig, WrenchSensor
from sim_core.rigs.motion import Experiment
from sysid.fit.fit import fit_runs
from sysid.fit.options import FitOptions
from sysid.model.load import load_runs
from sysid.model.nuisance_parameters import KINDS, nuisance_parameters
from sysid.model.parameters import FitParameter, fit_parameters, rig_at, start_of
from sysid.model.predictor import SerialPredictor
from sysid.observations.observations import Measured, Run
from sysid.progress.callback import Progress
from sysid.settings.fit import FIT
from sysid.settings.model import MODEL
from sysid.simulate import Noise, WhiteNoise, simulate_to_bag
from sysid.solve.interruption import reason_of


@dataclass(frozen=True)
class Outcome:
    """One parameter of one case. ``error``: fitted minus true, over true where it is ``relative``, in ``unit`` where
    the value of the rig is 0; ``score``: the difference in the fitted scale over the standard deviation;
    ``determined``: the data determine it, as the fit says."""

    case: int
    name: str
    unit: str
    truth: float
    value: float
    inside: bool
    relative: bool
    error: float
    score: float
    converged: bool
    determined: bool


@dataclass(frozen=True)
class Coverage:
    """``cases``: how many ended; ``failed``: what of them could not be run, by their number; ``stopped``: numbers of
    those that had not ended when it was interrupted or a process ended, of which ``lost`` tells, '' if none did;
    ``colour``: correlation of the noise of forces from sample to sample."""

    rig: str
    cases: int
    refine: int
    seed: int
    outcomes: tuple[Outcome, ...]
    failed: dict[int, str]
    stopped: tuple[int, ...] = ()
    colour: float = 0.0
    lost: str = ""

    def to_json(self) -> str:
        """All figures."""
        return json.dumps(asdict(self), indent=2, allow_nan=False)

    def table(self) -> str:
        """Shares of truths inside, by parameter, and which cases failed or did not converge.

        Outcomes of one case depend on each other, so the share of all parameters together has no interval.
        """
        lines = [
            f"{'parameter':<34}{'inside 95 %':>14}{'share':>8}{'  95 % of that share':<22}{'median |error|':>18}"
            f"{'mean score':>12}{'sd of scores':>14}"
        ]
        names = list(dict.fromkeys(o.name for o in self.outcomes))
        for name in names:
            some = [o for o in self.outcomes if o.name == name]
            low, high = wilson(sum(o.inside for o in some), len(some))
            size = float(np.median([abs(o.error) for o in some]))
            error = f"{100 * size:.2f} %" if some[0].relative else f"{size:.3g} {some[0].unit}".rstrip()
            lines.append(_row(name, some, f"  {100 * low:.0f} .. {100 * high:.0f} %", error))
        if len(names) > 1:
            lines.append(_row("all", self.outcomes, "", ""))
        return "\n".join([*lines, *self._remarks(names)])

    def _remarks(self, names: Sequence[str]) -> list[str]:
        """On cases that failed or did not converge, errors that are not relative, and coloured noise, in words."""
        lines = []
        astray = sorted({o.case for o in self.outcomes if not o.converged})
        if astray:
            lines.append(
                f"{len(astray)} of {self.cases} fits did not converge, and are counted: cases "
                f"{', '.join(map(str, astray))}. Without them: "
                f"{self._shares(names, [o for o in self.outcomes if o.converged], 0)}."
            )
        if self.failed:
            lines.append(
                f"{len(self.failed)} of {self.cases} cases failed, and are in no row. Counted as outside: "
                f"{self._shares(names, self.outcomes, len(self.failed)) or 'none is inside'}."
            )
        for name in names:
            vague = sum(o.name == name and not o.determined for o in self.outcomes)
            if vague:
                lines.append(
                    f"{name} is not determined in {vague} of {sum(o.name == name for o in self.outcomes)} cases: an "
                    "interval as wide as what is possible holds any truth."
                )
        absolute = [name for name in names if any(o.name == name and not o.relative for o in self.outcomes)]
        if absolute:
            lines.append(
                f"0 in the rig: {', '.join(absolute)}, drawn within the plausible width about it; errors in its unit."
            )
        if self.colour:
            lines.append(f"Noise of wrenches is correlated by {self.colour:g} from sample to sample.")
        lines += [f"Case {case} failed: {why}" for case, why in self.failed.items()]
        if self.stopped:
            numbers = ", ".join(map(str, self.stopped))
            lines.append(
                f"{'Stopped' if self.lost else 'Interrupted'}: cases {numbers} had not ended, and are in no row. "
                f"{self.lost}".rstrip()
            )
        return lines

    @staticmethod
    def _shares(names: Sequence[str], outcomes: Sequence[Outcome], missing: int) -> str:
        """How many of ``outcomes``, and of ``missing`` others that are not, are inside, by parameter."""
        inside = {name: [o.inside for o in outcomes if o.name == name] for name in names}
        return ", ".join(f"{name} {sum(hits)} of {len(hits) + missing}" for name, hits in inside.items())


def _row(name: str, outcomes: Sequence[Outcome], interval: str, error: str) -> str:
    """A row of the table."""
    hits, scores = sum(o.inside for o in outcomes), [o.score for o in outcomes]
    sd = f"{np.std(scores, ddof=1):.2f}" if len(scores) > 1 else ""
    return (
        f"{name:<34}{f'{hits} of {len(outcomes)}':>14}{100 * hits / len(outcomes):>6.0f} %{interval:<22}{error:>18}"
        f"{np.mean(scores):>12.2f}{sd:>14}"
    ).rstrip()


def wilson(hits: int, trials: int) -> tuple[float, float]:
    """95 % interval of a probability from hits in trials (Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    z = 1.959964
    share = hits / trials
    middle = (share + z**2 / (2 * trials)) / (1 + z**2 / trials)
    half = z / (1 + z**2 / trials) * np.sqrt(share * (1 - share) / trials + z**2 / (4 * trials**2))
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def as_they_end(
    pending: Collection[Future[list[Outcome]]], meanwhile: Callable[[], None]
) -> Iterator[Future[list[Outcome]]]:
    """Cases as they end; ``meanwhile`` is called at the beginning, and whenever none has ended for a while."""
    left = set(pending)
    meanwhile()
    while left:
        ended, left = wait(left, timeout=FIT.coverage_progress_s, return_when=FIRST_COMPLETED)
        if not ended:
            meanwhile()
        yield from ended


def measure_coverage(
    rig: Rig,
    experiments: Sequence[Experiment],
    names: Sequence[str],
    *,
    cases: Sequence[int],
    spread: float = 1.5,
    refine: int = FIT.coverage_refinement,
    seed: int = 0,
    colour: float = 0.0,
    on_progress: Progress | None = None,
) -> Coverage:
    """Run the numbered ``cases``. ``spread``: factor either way within which values are drawn about the rig's
    (:func:`draw`); ``refine``: how much finer the truth is simulated; ``colour``: correlation rho of the noise of
    forces from sample to sample. Ctrl-C, a worker process that ends and a case that fails keep the cases that have
    ended. Where none has an outcome the error is raised, unless it is one of input, data or numerics."""
    parameters = fit_parameters(rig, names)
    outcomes: list[Outcome] = []
    failed: dict[int, str] = {}
    left, lost = set(cases), ""
    defect: Exception | None = None
    workers = min(os.cpu_count() or 1, max(1, len(cases)))

    def tell() -> None:
        if on_progress is not None:
            ended, inside = len(cases) - len(left), sum(o.inside for o in outcomes)
            words = f"{ended} of {len(cases)} cases have ended, {inside} of {len(outcomes)} inside"
            on_progress(ended / len(cases), words if ended else f"no case of {len(cases)} has ended yet")

    try:
        with worker_pool(workers) as pool:
            pending = {}
            for case in cases:
                rng = np.random.default_rng([seed, case])
                truth, start = (draw(rig, parameters, spread, rng) for _ in range(2))
                drawn = (truth, start, refine, int(rng.integers(2**31)), colour)
                pending[pool.submit(_case, rig, experiments, parameters, case, *drawn)] = case
            for future in as_they_end(pending, tell):
                case = pending[future]
                try:
                    outcomes += future.result()
                except BrokenProcessPool as error:  # all that had not ended say so
                    defect, lost = error, str(worker_ended())
                    continue
                except Exception as error:
                    failed[case] = reason_of(error)
                    defect = defect if isinstance(error, ThinshellError) else error
                left.remove(case)
                tell()
            if defect is not None and not outcomes:
                raise defect
    except KeyboardInterrupt:
        if not outcomes:
            raise
    outcomes.sort(key=lambda o: o.case)
    ended = len(cases) - len(left)
    stopped = tuple(sorted(left))
    return Coverage(
        rig.name, ended, refine, seed, tuple(outcomes), dict(sorted(failed.items())), stopped, colour, lost
    )  # fmt: skip


def draw(rig: Rig, parameters: Sequence[FitParameter], spread: float, rng: np.random.Generator) -> np.ndarray:
    """Scaled values inside the bounds: log-uniform within a factor ``spread`` of those of the rig, and uniform within
    the plausible width of those that are 0 in the rig."""
    drawn = []
    for p, at in zip(parameters, start_of(rig, parameters), strict=True):
        value, share = p.physical(at), rng.uniform()
        ends = [value / spread, value * spread] if value else [-p.prior_sd, p.prior_sd]
        low, high = np.clip(sorted(ends), p.lower, p.upper)
        drawn.append(p.scaled(float(low * (high / low) ** share if value else low + share * (high - low))))
    return np.array(drawn)


def _with_drawn_nuisances(rig: Rig, asked: Sequence[FitParameter], rng: np.random.Generator) -> Rig:
    """The rig with offsets in time, cameras and end effectors that are off, as the priors of a fit expect them."""
    kinds = {n: "wrench" if isinstance(s, WrenchSensor) else "markers" for n, s in rig.sensors.items()}
    kinds |= dict.fromkeys(rig.cameras, "tracks")
    channels = tuple(Measured(n, kind, np.empty(0), np.empty((0, 0)), ()) for n, kind in kinds.items())
    found = nuisance_parameters(rig, [Run("", "", (), {}, channels, 0.0)], asked, KINDS)
    return rig_at(rig, found, start_of(rig, found) + [p.prior_sd for p in found] * rng.standard_normal(len(found)))


@dataclass(frozen=True)
class _Biased:
    """Noise with a constant in each component of a wrench, and there correlated by ``colour`` from sample to sample."""

    noise: Noise
    seed: int
    colour: float

    def __call__(self, channel: str, kind: str, stamps: np.ndarray, clean: np.ndarray) -> np.ndarray:
        drawn = self.noise(channel, kind, stamps, clean)
        if kind != "wrench":
            return drawn
        rng = np.random.default_rng([self.seed, *channel.encode()])
        return autocorrelated_noise(drawn, self.colour) + np.repeat(MODEL.bias_sd, 3) * rng.standard_normal(6)


def autocorrelated_noise(white: np.ndarray, rho: float) -> np.ndarray:
    """Stationary noise of the same standard deviation, of which neighbouring samples are correlated by ``rho``, from
    white noise ``(n, m)``."""
    driven = np.sqrt(1.0 - rho**2) * white
    driven[:1] = white[:1]
    return np.asarray(lfilter([1.0], [1.0, -rho], driven, axis=0))


@cache
def _engine() -> SerialPredictor:
    """Of this process, which keeps its scenes from case to case."""
    return SerialPredictor()


def _case(
    rig: Rig,
    experiments: Sequence[Experiment],
    parameters: Sequence[FitParameter],
    case: int,
    truth: np.ndarray,
    start: np.ndarray,
    refine: int,
    noise_seed: int,
    colour: float,
) -> list[Outcome]:
    rng = np.random.default_rng(noise_seed)
    true = _with_drawn_nuisances(rig_at(rig, parameters, truth), parameters, rng)
    with tempfile.TemporaryDirectory() as folder:
        bags = [Path(folder) / f"{k}" for k in range(len(experiments))]
        for k, (experiment, bag) in enumerate(zip(experiments, bags, strict=True)):
            noise = _Biased(WhiteNoise(true, noise_seed + k), noise_seed + k, colour)
            simulate_to_bag(true, experiment, bag, refine=refine, noise=noise)
        runs, _ = load_runs(rig, bags)
    names = [p.name for p in parameters]
    options = FitOptions(intervals="quadratic")
    result, _ = fit_runs(rig_at(rig, parameters, start), runs, names, options, engine=_engine())
    outcomes = []
    for p, at_rig, scaled, found in zip(parameters, start_of(rig, parameters), truth, result.estimates, strict=True):
        value, low, high = p.physical(scaled), *found.ci95
        relative = p.physical(at_rig) != 0.0
        outcomes.append(
            Outcome(
                case,
                p.name,
                p.unit,
                value,
                found.value,
                bool(low <= value <= high),
                relative,
                (found.value - value) / (value if relative else 1.0),
                float((p.scaled(found.value) - scaled) / found.sd),
                result.converged,
                p.name not in result.undetermined,
            )
        )
    return outcomes
