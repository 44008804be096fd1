"""Small pictures of the deviance against each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import PchipInterpolator

from sysid.report.numbers import scale_for, significant
from sysid.report.svg import AFTER, BEFORE, LINE, MEASURED, RC, inline_svg

if TYPE_CHECKING:
    from sysid.uncertainty.profile_likelihood import Profile

LIMIT = 3.841459
"""95 % quantile of chi-square with one degree of freedom."""

TALLEST = 3.0 * LIMIT
"""Deviance at which pictures are cut off."""


@dataclass(frozen=True)
class ProfilePicture:
    """One parameter. ``interval``: its 95 % interval as text, in ``unit``."""

    name: str
    interval: str
    unit: str
    svg: str


def profile_pictures(profiles: Sequence[Profile]) -> list[ProfilePicture]:
    """A picture for each parameter whose likelihood was profiled."""
    import matplotlib

    with matplotlib.rc_context(RC):
        return [_picture(p, f"profile{k}") for k, p in enumerate(profiles)]


def _picture(profile: Profile, key: str) -> ProfilePicture:
    """Root-interpolated deviance, the parabola of the quadratic interval, and the limit of 95 %."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    p = profile
    scale = scale_for(p.unit, p.value, *p.ci95)
    values, deviance = np.array(p.values), np.array(p.deviance)
    figure = Figure(figsize=(3.4, 2.1), dpi=72)
    axes = figure.add_axes((0.13, 0.2, 0.84, 0.76))
    axes.axhline(LIMIT, color=LINE, linewidth=1.0)
    for end, kind in zip(p.ci95, p.ends, strict=True):
        if kind == "found":
            axes.axvline(end * scale.factor, color=LINE, linewidth=0.8)
    inner = np.linspace(values.min(), values.max(), 120)

    def fitted_scale(x: np.ndarray) -> np.ndarray:
        return np.log(x) if p.log else np.asarray(x)

    ends = fitted_scale(np.array([p.value, *p.quadratic]))
    sd = 0.5 * (ends[2] - ends[1]) / np.sqrt(LIMIT)
    if sd > 0.0:
        parabola = ((fitted_scale(inner) - ends[0]) / sd) ** 2
        axes.plot(inner * scale.factor, parabola, color=BEFORE, linewidth=1.2, dashes=(4, 2))
    if len(values) > 2:
        # The root of the deviance, with the side as its sign, is nearly a straight line.
        signed = np.sign(values - p.value) * np.sqrt(deviance)
        axes.plot(inner * scale.factor, PchipInterpolator(values, signed)(inner) ** 2, color=AFTER, linewidth=1.5)
    axes.plot(values * scale.factor, deviance, ".", color=MEASURED, markersize=6)
    axes.set_ylim(0.0, TALLEST)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=4))
    axes.yaxis.set_major_locator(MaxNLocator(nbins=3))
    plain = ScalarFormatter(useOffset=False)
    plain.set_scientific(False)
    axes.xaxis.set_major_formatter(plain)
    low, high = (significant(v * scale.factor, 4) for v in p.ci95)
    words = [f" ({kind})" if kind != "found" else "" for kind in p.ends]
    interval = f"{low}{words[0]} to {high}{words[1]}"
    label = f"Deviance against {p.name}: 95 % interval {interval} {scale.unit}".strip() + "."
    return ProfilePicture(p.name, interval, scale.unit, inline_svg(figure, key, label))
