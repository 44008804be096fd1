"""Errors of markers as arrows, before and after, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sysid.report.panels import Panel, RunView
from sysid.report.svg import AFTER, BEFORE, INK, LINE, MUTED, RC, inline_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sysid.fit.marker_field import MarkerField

MOST_FIELDS = 6
"""Pictures on a page: those of the largest errors over noise, one of those held out among them where there are any."""

LENGTHS = (1.0, 2.0, 5.0)
"""Factors, times powers of ten, by which arrows are drawn longer than they are."""

LONGEST = 0.2
"""Length of the longest arrow, over the extent of the markers."""


def marker_pictures(
    fields: Sequence[MarkerField], names: tuple[str, str], both: bool
) -> dict[tuple[str, bool], list[Panel]]:
    """Pictures by recording and whether it is held out. ``both``: False shows ``after`` alone."""
    import matplotlib

    ranked = sorted(fields, key=lambda f: -_rms(f.before) / f.noise)
    chosen = ranked[:MOST_FIELDS]
    if chosen and not any(f.held_out for f in chosen):
        chosen = [*chosen[: MOST_FIELDS - 1], *[f for f in ranked if f.held_out][:1]]
    found: dict[tuple[str, bool], list[Panel]] = {}
    with matplotlib.rc_context(RC):
        for number, field in enumerate(chosen):
            panel = Panel(field.channel, "errors of the markers", field.unit, _draw(field, names, both, f"m{number}"))
            found.setdefault((field.run, field.held_out), []).append(panel)
    return found


def with_marker_pictures(
    views: list[RunView], fields: Sequence[MarkerField], names: tuple[str, str], both: bool
) -> list[RunView]:
    """The views of recordings with their pictures."""
    pictures = marker_pictures(fields, names, both)
    for view in views:
        view.markers = pictures.get((view.name, view.held_out), [])
    return views


def _rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def longer(errors: Sequence[np.ndarray], extent: float) -> float:
    """By how much arrows are drawn longer: the largest of :data:`LENGTHS` times a power of ten at which the longest one
    is at most :data:`LONGEST` of the extent of the markers."""
    longest = max(float(np.linalg.norm(e, axis=1).max(initial=0.0)) for e in errors)
    if longest == 0.0 or extent == 0.0:
        return 1.0
    most = LONGEST * extent / longest
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(f * power for f in LENGTHS if f * power <= most * (1.0 + 1e-12)))


def _draw(field: MarkerField, names: tuple[str, str], both: bool, key: str) -> str:
    from matplotlib.figure import Figure

    shown = [(names[0], field.before, BEFORE)] if both else []
    shown.append((names[1], field.after, AFTER))
    extent = float(np.ptp(field.places, axis=0).max())
    factor = longer([errors for _, errors, _ in shown], extent)
    figure = Figure(figsize=(3.1 * len(shown), 3.3), layout="constrained")
    axes = figure.subplots(1, len(shown), sharex=True, sharey=True, squeeze=False)[0]
    for number, (ax, (name, errors, colour)) in enumerate(zip(axes, shown, strict=True)):
        _arrows(ax, field, errors, colour, factor)
        ax.set_title(f"{name}: rms {_rms(errors) / field.noise:.2g} times the noise", color=INK, fontsize=9.5)
        ax.set_xlabel(f"{field.axes[0]} [{field.unit}]")
        if number == 0:
            ax.set_ylabel(f"{field.axes[1]} [{field.unit}]")
    figure.suptitle(
        f"at {field.t:.2f} s, arrows {factor:g} times as long; grey dots: what is within the noise",
        color=MUTED, fontsize=9.0,
    )  # fmt: skip
    label = f"Errors of the markers of {field.channel} in {field.run} at {field.t:.2f} s as arrows"
    return inline_svg(figure, key, label)


def _arrows(ax: Axes, field: MarkerField, errors: np.ndarray, colour: str, factor: float) -> None:
    """Arrows from where markers are simulated to where they are measured, where that is beyond twice the noise."""
    far = np.linalg.norm(errors, axis=1) > 2.0 * field.noise
    begin = field.places - errors
    ax.plot(*field.places[~far].T, linestyle="none", marker="o", markersize=1.4, color=LINE)
    if far.any():
        ax.quiver(
            *begin[far].T, *(factor * errors[far]).T, angles="xy", scale_units="xy", scale=1.0, color=colour,
            width=0.005, headwidth=3.0, headlength=3.5, headaxislength=3.0, minlength=0.0,
        )  # fmt: skip
    ax.set_aspect("equal")
    low, high = field.places.min(axis=0), field.places.max(axis=0)
    margin = 0.7 * LONGEST * max(float(np.max(high - low)), 1e-12)
    ax.set_xlim(low[0] - margin, high[0] + margin)
    bottom, top = low[1] - margin, high[1] + margin
    ax.set_ylim(*((top, bottom) if field.downwards else (bottom, top)))
