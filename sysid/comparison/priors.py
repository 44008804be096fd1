"""Prior probabilities and widths of the comparison of models: all of its numbers, with where they are from.

The form error is learnt by :mod:`sysid.comparison.learning` from five empty strips of another formulation (``thinshell
prove record --stand strip --cases 5 --seed 11 --fast``). Prior weights are set by hand: learnt ones have a better
logarithmic score on other recordings, but name more effects falsely (docs/proof.md).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

NOTHING_MISSING = 0.5
"""Convention: prior probability that nothing is missing."""

AMPLITUDES = (1.0, 1.0 / 8.0, 1.0 / 64.0)
"""Convention: scales of the prior of an amplitude, equally probable; what is missing may be small against what physics
allows, and recordings show how small."""

SHARES = (0.1, 0.3, 1.0)
"""Convention: what is left of an effect in a shape that is not looked at, over what its nearest shape explains."""

TRACES = (2.0, 6.0, 20.0)
"""Convention: sizes of unknown physics that resembles no effect, in standard deviations of the noise."""


@dataclass(frozen=True)
class Priors:
    """``form``: how much careful simulators differ by each effect and closure, over the size of the named
    approximations. All others are logarithms of prior weights. ``unknown``: of unknown physics in one place over that
    of one effect; ``same_place``: of two that are missing in the same place; ``pair``, ``triple``: of two and of three
    over what independence says; ``family``: of an effect in all of its shapes at once, over one of them; ``left``: of
    an effect with what is left of it (:data:`SHARES`); ``alike``: of unknown physics that resembles an effect but for
    so much; ``free``: of such that resembles none (:data:`TRACES`); ``mixture``: of such that looks like several
    effects of its place."""

    form: float = 0.035
    unknown: float = 0.0
    same_place: float = 0.0
    pair: float = 0.0
    triple: float = 0.0
    family: float = float(np.log(0.3))
    left: tuple[float, float, float] = (float(np.log(0.3)), float(np.log(0.1)), float(np.log(0.01)))
    alike: tuple[float, float, float] = (float(np.log(0.1)), float(np.log(0.3)), float(np.log(0.3)))
    free: tuple[float, float, float] = (float(np.log(0.1)), float(np.log(0.1)), float(np.log(0.1)))
    mixture: float = 0.0

    @property
    def weights(self) -> np.ndarray:
        """The logarithms, in the order of :func:`feature_names`."""
        return np.concatenate([np.atleast_1d(getattr(self, f.name)) for f in fields(self)[1:]])

    @staticmethod
    def of_weights(weights: np.ndarray, form: float) -> Priors:
        """From logarithms in this order."""
        values, at = {}, 0
        for f in fields(Priors)[1:]:
            size = np.size(getattr(PRIORS, f.name))
            part = tuple(float(v) for v in weights[at : at + size])
            values[f.name] = part[0] if size == 1 else part
            at += size
        return Priors(form, **values)  # type: ignore[arg-type]


PRIORS = Priors()
"""What the tool has."""


def feature_names() -> tuple[str, ...]:
    """What the logarithms of prior weights count in a model."""
    named = []
    for f in fields(Priors)[1:]:
        size = np.size(getattr(PRIORS, f.name))
        named += [f.name] if size == 1 else [f"{f.name} {k}" for k in range(size)]
    return tuple(named)


PLACE = {name: k for k, name in enumerate(feature_names())}
"""Number of each of these."""
