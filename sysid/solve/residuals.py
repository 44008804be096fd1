"""Whitened residuals of runs against a rig, and their least-squares minimum."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sim_core.errors import ConvergenceError, ThinshellError
from sim_core.rigs import Rig
from sysid.model.nuisance_parameters import bias_sd, kind_of
from sysid.model.parameters import FitParameter, rig_at, rig_in, start_of
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.noise.autocorrelation import Samples
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.common_mode import CommonWhitening
from sysid.noise.estimate import column_groups
from sysid.noise.whitening import whiten
from sysid.observations.observations import Measured, Run
from sysid.settings.solve import SOLVE
from sysid.solve.discretisation_basis import Basis, ErrorShape, Sizes, basis_of, credible_error
from sysid.solve.gauss_newton import Search
from sysid.solve.named_errors import Marginal, NamedErrors
from sysid.solve.optimum import Fitted
from sysid.solve.variable_projection import Elimination


def _check_numbers(run: Run, measured: Measured, prediction: Prediction, names: Sequence[str]) -> None:
    """Raise ``ConvergenceError`` where what is compared with a reading is neither a number nor out of sight."""
    values = prediction.values[measured.channel]
    compared = np.isfinite(measured.values) & ~np.isnan(values)
    broken = [f"of {measured.channel}"] if np.isinf(values[compared]).any() else []
    if names:
        slopes = prediction.derivatives[measured.channel][compared]
        lost = ~np.isfinite(slopes).all(axis=0)
        broken += [
            f"of the derivative of {measured.channel} by {name}" for name, k in zip(names, lost, strict=True) if k
        ]
    if broken:
        raise ConvergenceError(
            f"{run.name}: predictions {' and '.join(broken)} are not numbers.",
            "Start the fit from other values, or with a shorter time step (solver.dt_s).",
        )


class Assembled(NamedTuple):
    """Whitened ``residual`` ``(n,)`` and ``jacobian`` ``(n, p)``, ``labels`` (run, channel, times of the samples), most
    probable ``sizes`` of error shapes, which rows are no reading that is predicted out of ``sight`` ``(n,)``, the
    jacobian with a discretisation error that would be ``still`` ``(n, p)``, None where it is, and most probable sizes
    of ``named`` errors ``(k,)``."""

    residual: np.ndarray
    jacobian: np.ndarray
    labels: list[tuple[int, str, np.ndarray]]
    sizes: dict[tuple[int, str], Sizes]
    sight: np.ndarray
    still: np.ndarray | None
    named: np.ndarray


class Problem:
    """Runs, their noise, and the known error shapes that are eliminated from the residuals.

    ``prior``: pull every parameter to the value of the rig with the width of its plausible range, not only
    nuisances; ``bias``: every wrench reading has a constant of its own in each run, which is eliminated as well;
    ``on_channel``: called with each channel of a run that has been assembled; ``named``: errors of named
    approximations, which are integrated out of all residuals together.
    """

    def __init__(
        self,
        runs: Sequence[Run],
        noise: dict[str, ChannelNoise],
        engine: AnyEngine,
        error_shapes: Sequence[ErrorShape] = (),
        prior: bool = False,
        bias: bool = False,
        on_channel: Callable[[Measured], None] | None = None,
        named: NamedErrors | None = None,
    ) -> None:
        self.runs = list(runs)
        self.noise = noise
        self._own = {channel: found.own for channel, found in noise.items()}
        self._places: dict[tuple[int, str], np.ndarray] = {}
        self.engine = engine
        self.error_shapes = list(error_shapes)
        self.prior = prior
        self.bias = bias
        self.on_channel = on_channel
        self._weights: dict[tuple[int, str], np.ndarray] = {}
        self._doubtful: dict[tuple[int, str], np.ndarray] = {}
        self._eliminations: dict[tuple[int, str], Elimination] = {}
        self._known: Fitted | None = None
        self.named = named
        self._marginal: tuple[bytes, Marginal] | None = None
        self._compared = {
            (i, m.channel): Samples(
                np.isfinite(m.values), m.t, tuple(column_groups(m)), tared=self.bias and bias_sd(m) is not None
            )
            for i, run in enumerate(self.runs)
            for m in run.measured
        }

    @property
    def refined(self) -> Sequence[ErrorShape]:
        """The errors of mesh and time step, as they were measured."""
        return self.error_shapes if self.named is None else self.named.refined

    @property
    def eliminates(self) -> bool:
        """Something is eliminated from the residuals."""
        return bool(self.error_shapes) or self.bias

    def with_named(self, named: NamedErrors) -> Problem:
        """The same problem with other named errors."""
        return Problem(
            self.runs, self.noise, self.engine, self.error_shapes, self.prior, self.bias, self.on_channel, named
        )

    def basis(self, index: int, measured: Measured) -> Basis:
        """The discretisation error, and the bias, in one channel of run number ``index``."""
        sd = bias_sd(measured) if self.bias else None
        return basis_of(self.error_shapes, index, self.runs[index], measured, sd)

    def bias_of(self, fitted: Fitted, index: int, measured: Measured) -> np.ndarray:
        """Most probable bias of each column of a channel, measured units ``(m,)``."""
        sd = bias_sd(measured) if self.bias else None
        if sd is None:
            return np.zeros(measured.values.shape[1])
        return np.asarray(sd * fitted.sizes[(index, measured.channel)].own[:, -1])

    def read(self, fitted: Fitted, index: int, measured: Measured) -> np.ndarray:
        """What a channel with its most probable bias would read by the prediction, measured units ``(n, m)``."""
        prediction = fitted.predictions[index].values[measured.channel]
        return np.asarray(prediction + self.bias_of(fitted, index, measured)) if self.bias else prediction

    def tared(self, fitted: Fitted, index: int, measured: Measured) -> np.ndarray:
        """As :meth:`read`, with the bias that is best where all that the rig misses is noise, measured units
        ``(n, m)``: with a discretisation error part of that passes for a bias."""
        prediction = fitted.predictions[index].values[measured.channel]
        sd = bias_sd(measured) if self.bias else None
        if sd is None:
            return prediction
        miss = measured.values - prediction
        seen = np.isfinite(miss)
        weaker = (self.noise[measured.channel].sigma / np.maximum(sd, np.finfo(float).tiny)) ** 2
        return np.asarray(prediction + np.where(seen, miss, 0.0).sum(axis=0) / (seen.sum(axis=0) + weaker))

    def _weights_of(self, index: int, measured: Measured) -> np.ndarray:
        """Weights of the samples of a channel ``(n, m)``; kept, as every evaluation needs them."""
        key = (index, measured.channel)
        if key not in self._weights:
            self._weights[key] = self.basis(index, measured).weights(self._own[measured.channel])
        return self._weights[key]

    def _elimination(self, index: int, measured: Measured, good: np.ndarray) -> Elimination:
        """Of the basis, for the samples that count; kept while these are the same."""
        key = (index, measured.channel)
        known = self._eliminations.get(key)
        if known is None or not known.suits(good):
            common = self._common(index, measured, good)
            known = Elimination(self.basis(index, measured), self._own[measured.channel], good, measured.t, common)
            self._eliminations[key] = known
        return known

    def whiten(self, index: int, measured: Measured, values: np.ndarray) -> np.ndarray:
        """Values ``(n, m, ...)`` in units of the noise, with what all markers of a picture have in common, and of what
        of the discretisation error follows no shape."""
        white = self._by_column(index, measured, values)
        good = np.isfinite(white)
        seen = np.asarray(good.reshape(*good.shape[:2], -1).all(axis=2))
        return np.where(good, self._in_common(index, measured, np.where(good, white, 0.0), seen), np.nan)

    def _common(self, index: int, measured: Measured, seen: np.ndarray) -> np.ndarray | None:
        """What noise makes all markers of a picture have in common ``(n, r, m)``, in units of whitened samples, of
        which those ``seen`` ``(n, m)`` count; None: nothing."""
        weights = self._weights_of(index, measured) if self.eliminates else 1.0
        parts = self._of_instants(index, measured, weights * seen)
        common = self.noise[measured.channel].common
        if common is not None:
            key = (index, measured.channel)
            if key not in self._places:
                first = np.argmax(np.isfinite(measured.values), axis=0)
                self._places[key] = np.take_along_axis(measured.values, first[None], axis=0)[0]
            parts = [common.deviations(self._places[key], seen, weights), *parts]
        return np.concatenate(parts, axis=1) if parts else None

    def _of_instants(self, index: int, measured: Measured, weights: np.ndarray) -> list[np.ndarray]:
        """Named errors that each instant has for itself ``(n, r, m)``, in units of whitened samples with ``weights``
        ``(n, m)``."""
        if self.named is None or not self.named.instant:
            return []
        own = self._own[measured.channel]
        factors = weights * np.sqrt(own.whitening_gain) / own.sigma
        return [self.named.instant[index][measured.channel] * factors[:, None]]

    def _in_common(self, index: int, measured: Measured, white: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Whitened values ``(n, m, ...)``, 0 where they are not ``seen`` ``(n, m)``, in units of the noise that markers
        have in common as well."""
        common = self._common(index, measured, seen)
        return white if common is None else CommonWhitening(common)(white)

    def _by_column(self, index: int, measured: Measured, values: np.ndarray) -> np.ndarray:
        """As :meth:`whiten`, each column for itself."""
        white = whiten(values, self._own[measured.channel], measured.t)
        if not self.eliminates:
            return white
        weight = self._weights_of(index, measured)
        return np.asarray(white * weight.reshape(*weight.shape, *(1,) * (white.ndim - 2)))

    def judged(self, index: int, measured: Measured, values: np.ndarray) -> np.ndarray:
        """As :meth:`whiten`, of values ``(n, m)``; NaN where what is left cannot be judged, since the discretisation
        error changes unforeseen."""
        white = self.whiten(index, measured, values)
        if not self.error_shapes:
            return white
        key = (index, measured.channel)
        if key not in self._doubtful:
            self._doubtful[key] = self.basis(index, measured).doubtful(self._own[measured.channel])
        return np.where(self._doubtful[key], np.nan, white)

    def corrected(self, fitted: Fitted, index: int, measured: Measured) -> np.ndarray:
        """Prediction of a channel with the most probable discretisation error added, measured units ``(n, m)``."""
        prediction = fitted.predictions[index].values[measured.channel]
        if self.named is not None:
            prediction = prediction + self.named.shapes[index][measured.channel] @ fitted.named
        if not self.eliminates:
            return prediction
        error = self.basis(index, measured).error(fitted.scaled, fitted.sizes[(index, measured.channel)])
        return np.asarray(prediction + error)

    def explained(self, fitted: Fitted, index: int, measured: Measured) -> np.ndarray:
        """As :meth:`corrected`, with no more discretisation error than is credible
        (:func:`sysid.solve.discretisation_basis.credible_error`): what the model accounts for, measured units
        ``(n, m)``."""
        if self.named is not None:
            return self.corrected(fitted, index, measured)
        read = self.read(fitted, index, measured)
        if not self.error_shapes:
            return read
        taken = self.corrected(fitted, index, measured) - read
        return np.asarray(read + credible_error(taken, self.basis(index, measured), measured))

    def assemble(
        self, predictions: Sequence[Prediction], names: Sequence[str], scaled: np.ndarray | None = None
    ) -> Assembled:
        """All samples of all runs in one least-squares problem.

        Noise of each column, noise that columns have in common and the discretisation error are one covariance, of
        which the error is eliminated channel by channel (:mod:`sysid.solve.variable_projection`).
        ``names``: of the parameters that the predictions have derivatives by; ``scaled``: where the predictions stand,
        for errors that change with the parameters. Raises ``ConvergenceError`` where a prediction or a derivative is
        not a number, other than out of sight (NaN in the prediction).
        """
        assembled, labels, sight = [], [], []
        sizes: dict[tuple[int, str], Sizes] = {}
        marginal = self._marginal_of(predictions)
        for i, (run, prediction) in enumerate(zip(self.runs, predictions, strict=True)):
            for m in run.measured:
                _check_numbers(run, m, prediction, names)
                # What is predicted out of sight says nothing; the size stays that of the data.
                miss = m.values - prediction.values[m.channel]
                white = self._by_column(i, m, miss)
                good, seen = np.isfinite(m.values), np.isfinite(white)
                vectors = [white]
                if names:
                    # Missing where the residual is, so that both are whitened alike.
                    slopes = np.where(np.isnan(miss)[:, :, None], np.nan, -prediction.derivatives[m.channel])
                    slopes = self._by_column(i, m, slopes)
                    vectors += [slopes[:, :, k] for k in range(len(names))]
                if marginal is None and self.named is not None:
                    shapes = np.where(np.isnan(miss)[:, :, None], np.nan, self.named.shapes[i][m.channel])
                    vectors += list(np.moveaxis(self._by_column(i, m, shapes), 2, 0))
                stacked = np.stack(vectors, axis=2)
                times = np.broadcast_to(m.t[:, None], white.shape)[good]
                if self.eliminates:
                    eliminate = self._elimination(i, m, seen)
                    stacked[:, :, 0] -= eliminate.mean_error(scaled)
                    if names and scaled is not None:
                        stacked = np.concatenate([stacked, eliminate.slopes(scaled)], axis=2)
                    left, sizes[(i, m.channel)] = eliminate(stacked)
                    times, count = np.concatenate([times, eliminate.times]), int(np.count_nonzero(seen))
                else:
                    left = self._in_common(i, m, np.where(seen[:, :, None], stacked, 0.0), seen)[seen]
                    count = len(left)
                rows = np.zeros((np.count_nonzero(good), stacked.shape[2]))
                rows[seen[good]] = left[:count]
                rows = np.concatenate([rows, left[count:]])
                assembled.append(rows)
                sight.append(np.concatenate([seen[good], np.ones(len(rows) - np.count_nonzero(good), dtype=bool)]))
                labels.append((i, m.channel, times))
                if self.on_channel is not None:
                    self.on_channel(m)
        rows, there, found = np.concatenate(assembled), np.concatenate(sight), np.zeros(0)
        if self.named is not None and self.named.columns:
            if marginal is None:
                ends = 1 + len(names) + len(self.named.columns)
                marginal = Marginal(rows[:, 1 + len(names) : ends], self.named)
                self._marginal = (self._in_sight(predictions), marginal)
                rows = np.delete(rows, np.s_[1 + len(names) : ends], axis=1)
            rows, found = marginal(rows)
        still, changes = rows[:, 1 : 1 + len(names)], rows[:, 1 + len(names) :]
        if not changes.any():
            return Assembled(rows[:, 0], still, labels, sizes, there, None, found)
        jacobian = still.copy()
        jacobian[:, : changes.shape[1]] -= changes
        return Assembled(rows[:, 0], jacobian, labels, sizes, there, still, found)

    def _in_sight(self, predictions: Sequence[Prediction]) -> bytes:
        """Which readings are compared, as a value."""
        pairs = [(m, p.values[m.channel]) for run, p in zip(self.runs, predictions, strict=True) for m in run.measured]
        return b"".join(np.packbits(np.isfinite(m.values) & np.isfinite(v)).tobytes() for m, v in pairs)

    def _marginal_of(self, predictions: Sequence[Prediction]) -> Marginal | None:
        """What integrates named errors out; kept while the same readings are compared."""
        if self._marginal is None or self._marginal[0] != self._in_sight(predictions):
            return None
        return self._marginal[1]

    def seen(self, predictions: Sequence[Prediction]) -> int:
        """How many readings are in sight in the predictions as well."""
        pairs = [(m, p.values[m.channel]) for run, p in zip(self.runs, predictions, strict=True) for m in run.measured]
        return int(sum(np.count_nonzero(np.isfinite(m.values) & np.isfinite(values)) for m, values in pairs))

    def evaluate(self, rig: Rig, parameters: Sequence[FitParameter], scaled: np.ndarray) -> Fitted:
        """Residuals and derivatives at given values, without fitting; those that are kept are no evaluation."""
        known = self._known
        if known is not None and rig is known.centre and list(parameters) == known.parameters:
            if np.array_equal(scaled, known.scaled):
                return replace(known)
        predictions = self.engine.predict_all(rig, self.runs, parameters, scaled)
        return self.compare(predictions, rig, parameters, scaled)

    def keep(self, known: Fitted) -> None:
        """An outcome of :meth:`compare` of this problem, which is not made again where it is asked for."""
        self._known = replace(known, evaluations=0)

    def glance(self, rig: Rig, parameters: Sequence[FitParameter], points: Sequence[np.ndarray]) -> list[float]:
        """Chi-square at scaled ``points``, without priors, as if all that is in sight at any were at each and missed as
        the rest is; infinite where they cannot be simulated, and where much less is in sight than at others.
        Predictions have no derivatives and are made side by side."""
        pending = [
            [self.engine.submit(rig_in(rig, parameters, at, run.name), run) for run in self.runs] for at in points
        ]
        found, seen = [], []
        try:
            for at, futures in zip(points, pending, strict=True):
                try:
                    predictions = [future.result() for future in futures]
                    residual = self.assemble(predictions, [], at).residual
                except ThinshellError:
                    found.append(np.inf)
                    seen.append(0)
                else:
                    found.append(float(residual @ residual))
                    seen.append(self.seen(predictions))
        except BaseException:
            for future in (f for futures in pending for f in futures):
                future.cancel()
            raise
        most = max(seen)
        return [
            chi2 * (most / count if count else 1.0) if count >= SOLVE.in_sight_share * most else np.inf
            for chi2, count in zip(found, seen, strict=True)
        ]

    def compare(
        self,
        predictions: list[Prediction],
        rig: Rig,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
    ) -> Fitted:
        """Residuals and derivatives of predictions at hand, which are those at ``scaled``, with the priors' rows."""
        names = [p.name for p in parameters]
        r, j, labels, sizes, sight, still, named = self.assemble(predictions, names, scaled if names else None)
        pulled = [k for k, p in enumerate(parameters) if self.prior or p.pulled]
        if pulled:
            width = np.array([parameters[k].known_sd or parameters[k].prior_sd for k in pulled])
            r = np.concatenate([r, (scaled - start_of(rig, parameters))[pulled] / width])
            pulls = np.eye(len(parameters))[pulled] / width[:, None]
            j, still = np.vstack([j, pulls]), None if still is None else np.vstack([still, pulls])
            labels = [*labels, (-1, "prior", np.zeros(len(width)))]
            sight = np.concatenate([sight, np.ones(len(width), dtype=bool)])
        return Fitted(
            list(parameters), scaled, rig_at(rig, parameters, scaled), r, j, labels, predictions, rig, 1, True,
            "evaluated", sizes, compared=self._compared, sight=sight, still=still, named=named,
        )  # fmt: skip

    def fit(
        self,
        rig: Rig,
        parameters: Sequence[FitParameter],
        start: np.ndarray | None = None,
        max_evaluations: int = 30,
        tolerance: float = 0.5,
        on_evaluation: Callable[[Fitted], None] | None = None,
        halt: Callable[[Sequence[float]], bool] | None = None,
    ) -> Fitted:
        """Minimise the whitened residuals (:class:`sysid.solve.gauss_newton.Search`).

        ``tolerance``: improvement of chi-square below which the search ends, in units of what chance makes of
        it. Ctrl-C keeps the best so far.
        """
        start = start_of(rig, parameters) if start is None else np.asarray(start, dtype=float)
        if not parameters:
            found = self.evaluate(rig, parameters, start)
            found.message, found.began = "nothing to fit", found.chi2
            if found.evaluations and on_evaluation is not None:
                on_evaluation(found)
            return found
        sensors = np.array([p.nuisance and kind_of(rig, p.target) != "pose" for p in parameters])
        search = Search(
            lambda scaled: self.evaluate(rig, parameters, scaled), parameters, on_evaluation, halt, calibrated=sensors
        )
        return search.run(start, max_evaluations, tolerance)
