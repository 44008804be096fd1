"""The outcome of one minimisation."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sim_core.rigs import Rig
from sysid.model.parameters import FitParameter
from sysid.model.predictor import Prediction
from sysid.noise.autocorrelation import Part, Samples
from sysid.solve.discretisation_basis import Sizes


@dataclass
class Fitted:
    """Outcome of one minimisation. ``scaled``: best values; ``residual`` and ``jacobian``: whitened, ``(n,)`` and ``(n,
    p)``, nuisance sizes eliminated; ``labels``: run, channel and times of the residuals; ``predictions``: by run;
    ``centre``: the rig to whose values priors pull; ``sizes``: most probable coefficients of the discretisation error
    by run and channel (:mod:`sysid.solve.discretisation_basis`); ``limited``: the evaluations allowed for all searches
    together are used up; ``compared``: samples of each channel that are compared (:mod:`sysid.noise.autocorrelation`);
    ``sight``: which rows are no reading that is predicted out of sight, whose residual is 0 ``(n,)``, None if there is
    none; ``began``: chi-square where the search began, infinite without one; ``elsewhere``: the discretisation error
    that it was found with is that of another place, and is to be measured again before anything is made of the
    misfit; ``still``: the jacobian with a discretisation error that would not change with the parameters, None where
    it does not; ``interrupted``: by Ctrl-C; ``named``: most probable sizes of named errors ``(k,)``
    (:mod:`sysid.solve.named_errors`)."""

    parameters: list[FitParameter]
    scaled: np.ndarray
    rig: Rig
    residual: np.ndarray
    jacobian: np.ndarray
    labels: list[tuple[int, str, np.ndarray]]
    predictions: list[Prediction]
    centre: Rig
    evaluations: int
    converged: bool
    message: str
    sizes: dict[tuple[int, str], Sizes] = field(default_factory=dict)
    limited: bool = False
    compared: dict[tuple[int, str], Samples] = field(default_factory=dict)
    sight: np.ndarray | None = None
    began: float = np.inf
    elsewhere: bool = False
    still: np.ndarray | None = None
    interrupted: bool = False
    named: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def interrupt(self) -> None:
        """Ctrl-C was pressed: the search ends here."""
        self.interrupted, self.converged = True, False
        self.message = "interrupted; the best values so far are kept"

    @property
    def cut_short(self) -> bool:
        """Nothing is to be searched any more, from elsewhere or with another error."""
        return self.interrupted or self.limited

    @property
    def has_prior(self) -> bool:
        """The last rows of the residual, one a parameter that is pulled, are those of the prior."""
        return bool(self.labels) and self.labels[-1][0] < 0

    @property
    def pulls(self) -> int:
        """Number of rows of the prior."""
        return len(self.labels[-1][2]) if self.has_prior else 0

    @property
    def chi2(self) -> float:
        return float(self.residual @ self.residual)

    @property
    def samples(self) -> int:
        """Number of measured values compared, those that are predicted in sight (the residual also has a row for each
        nuisance size and prior)."""
        hidden = 0 if self.sight is None else int(np.count_nonzero(~self.sight))
        return len(self.residual) - hidden - sum(c.number for c in self.sizes.values()) - self.pulls

    def common_chi2(self, other: Fitted) -> tuple[float, float]:
        """Chi-square of this and of another outcome of the same problem, over what both have in sight."""
        both = np.ones(len(self.residual), dtype=bool)
        for there in (self.sight, other.sight):
            both &= True if there is None else there
        mine, others = self.residual[both], other.residual[both]
        return float(mine @ mine), float(others @ others)

    @property
    def misfit(self) -> float:
        """Mean squared whitened residual: 1 for a model that is right, less where the error of mesh and time step that
        is allowed for is not there."""
        return self.chi2 / max(self.samples, 1)

    @property
    def parts(self) -> list[list[Part]]:
        """Residuals and derivatives, quantity by quantity over all runs."""
        found: dict[tuple[str, int], list[Part]] = {}
        at = 0
        for index, channel, times in self.labels:
            samples = self.compared.get((index, channel))
            if samples is not None:
                # The rows of a channel are its samples, then the sizes of the discretisation error.
                rows = slice(at, at + int(samples.there.sum()))
                sight = None if self.sight is None else self.sight[rows]
                for k, part in enumerate(samples.of_rows(self.residual[rows], self.jacobian[rows], sight)):
                    found.setdefault((channel, k), []).append(part)
            at += len(times)
        return list(found.values())

    @property
    def values(self) -> dict[str, float]:
        """Physical values by name."""
        return {p.name: p.physical(s) for p, s in zip(self.parameters, self.scaled, strict=True)}
