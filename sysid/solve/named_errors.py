"""Errors of named approximations, integrated out of a least-squares problem.

Readings y are what a model f predicts, with named errors of known shapes E_k and with noise of covariance C,

    y = f(theta) + E b + e,    b ~ N(m, S),    e ~ N(0, C).

Whitened by the noise, r = C^(-1/2) (y - f), W = C^(-1/2) E, the errors are integrated out with the covariance
I + W S W^T (Kennedy & O'Hagan, J. R. Stat. Soc. B 63, 2001). With the singular values W S^(1/2) = V diag(s) U^T,

    (I + W S W^T)^(-1/2) = I + V diag((1 + s^2)^(-1/2) - 1) V^T,
    E[b | r] = m + S^(1/2) U diag(s / (1 + s^2)) V^T (r - W m).

Errors that each instant has for itself are part of C, like noise that all markers of a picture have in common
(:mod:`sysid.noise.common_mode`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.solve.discretisation_basis import ErrorShape


@dataclass(frozen=True)
class NamedError:
    """``owner``: what is approximated; ``name``: of the direction; ``mean``, ``sd``: of its size, in units of the
    extrapolated error, or of what the noise of poses makes of it."""

    owner: str
    name: str
    mean: float
    sd: float


@dataclass(frozen=True)
class NamedErrors:
    """Directions that all recordings of a problem have in common. ``shapes``: of each recording by channel
    ``(n, m, k)``, measured units; ``refined``: the errors of mesh and time step among them, as they were measured;
    ``instant``: of each recording by channel, what errors of unit variance that each instant has for itself add to its
    readings ``(n, r, m)``, measured units, alike at neighbouring instants."""

    columns: tuple[NamedError, ...]
    shapes: tuple[dict[str, np.ndarray], ...]
    refined: tuple[ErrorShape, ...] = ()
    instant: tuple[dict[str, np.ndarray], ...] = ()

    @property
    def instant_alone(self) -> NamedErrors:
        """Those that each instant has for itself."""
        none = tuple({c: s[..., :0] for c, s in shapes.items()} for shapes in self.shapes)
        return NamedErrors((), none, instant=self.instant)

    def with_refined(self, refined: Sequence[ErrorShape]) -> NamedErrors:
        """The same with the errors of mesh and time step as they are measured elsewhere, by their labels."""
        found = [dict(shapes) for shapes in self.shapes]
        names = [c.name for c in self.columns]
        for error in refined:
            k = names.index(error.label)
            for shapes, own in zip(found, error.shapes, strict=True):
                for channel, shape in own.items():
                    whole = shapes[channel].copy()
                    whole[..., k] = shape
                    shapes[channel] = whole
        return replace(self, shapes=tuple(found), refined=tuple(refined))

    @property
    def mean(self) -> np.ndarray:
        """Of the sizes ``(k,)``."""
        return np.array([c.mean for c in self.columns])

    @property
    def sd(self) -> np.ndarray:
        """Of the sizes ``(k,)``."""
        return np.array([c.sd for c in self.columns])


class Marginal:
    """The map of whitened rows to such that have the errors integrated out. ``white`` ``(n, k)``: whitened shapes."""

    def __init__(self, white: np.ndarray, errors: NamedErrors) -> None:
        self._mean, self._sd, self._shift = errors.mean, errors.sd, white @ errors.mean
        q, r = np.linalg.qr(white * self._sd)
        u, s, vt = np.linalg.svd(r, full_matrices=False)
        self._directions, self._strengths, self._own = q @ u, s, vt.T

    def __call__(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows ``(n, q)``, of which the first column is the residual, with the errors integrated out; most probable
        sizes ``(k,)``."""
        out = rows.copy()
        out[:, 0] -= self._shift
        seen = self._directions.T @ out
        s = self._strengths
        sizes = self._mean + self._sd * (self._own @ (s / (1.0 + s**2) * seen[:, 0]))
        out += self._directions @ ((1.0 / np.sqrt(1.0 + s**2) - 1.0)[:, None] * seen)
        return out, sizes
