"""Measured and simulated against time, one small panel a column, grouped by recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from sysid.report.numbers import MINUS, Scale, scale_for
from sysid.report.strips import Strip, noise_of, residual_strips
from sysid.report.svg import AFTER, BAND, BEFORE, INK, LINE, MEASURED, RC, WINDOW, inline_svg
from sysid.report.tables import level, over_noise

if TYPE_CHECKING:
    from sysid.diagnosis.result import LocatedChannel
    from sysid.fit.result import ChannelError, Series

Windows = Mapping[str, Sequence[tuple[float, float]]]

MOST_PANELS = 72
"""Panels on a page; with more columns than this, each recording shows those that fit worst."""

MOST_IN_OPEN = 18
"""Panels of a recording that is open when the page is."""

MOST_POINTS = 300
"""Measured points of one panel; the curves keep all their points."""

AROUND = 0.05
"""What is shown before and after a window, over the length of a recording."""

STEPS = [1, 2, 2.5, 5, 10]
"""Distances between ticks."""

LEVELS = ("", "good", "fair", "bad")
"""From the best to the worst; '' where it is not known."""

NEARNESS = {"good": "every channel down to the noise", "fair": "near the noise", "bad": "far above the noise"}
"""How near the worst channel of a recording comes, noise and error of mesh and time step together."""


@dataclass(frozen=True)
class Panel:
    """One column of one channel. ``channel``, ``label``: which."""

    channel: str
    label: str
    unit: str
    svg: str


@dataclass
class RunView:
    """All that the page shows of one recording. ``markers``: errors of markers as arrows; ``level``, ``words``: how
    near the last model comes to the noise."""

    name: str
    held_out: bool
    strips: list[Strip]
    windows: list[tuple[float, float]]
    end: float
    panels: list[Panel] = field(default_factory=list)
    markers: list[Panel] = field(default_factory=list)
    left_out: int = 0
    open: bool = False
    level: str = ""
    words: str = ""


def run_views(
    series: Sequence[Series],
    errors: Sequence[ChannelError],
    *,
    windows: Windows | None = None,
    both: bool = True,
    names: tuple[str, str] = ("before", "after"),
    held_out_first: bool = False,
) -> list[RunView]:
    """Panels and residual strips of every recording. ``both``: False shows ``after`` alone."""
    import matplotlib

    groups: dict[tuple[str, bool], list[Series]] = {}
    for s in series:
        if len(s.t):
            groups.setdefault((s.run, s.held_out), []).append(s)
    order = sorted(groups, key=lambda k: k[1] != held_out_first)
    quota = max(1, MOST_PANELS // max(len(order), 1)) if len(series) > MOST_PANELS else len(series)
    numbers = count()
    views: list[RunView] = []
    roles_seen: set[bool] = set()
    with matplotlib.rc_context(RC):
        for run, held_out in order:
            columns = groups[run, held_out]
            first = held_out not in roles_seen
            shown = _worst(columns, errors, max(quota, MOST_IN_OPEN) if first else quota)
            own = [e for e in errors if (e.run, e.held_out) == (run, held_out)]
            found = max((level(over_noise([e], after=True, own=True)) for e in own), key=LEVELS.index, default="")
            view = RunView(
                run,
                held_out,
                residual_strips(columns, errors, both),
                _windows_of(run, windows or {}),
                max(float(s.t[-1]) for s in columns),
                left_out=len(columns) - len(shown),
                open=first,
                level=found,
                words=NEARNESS.get(found, ""),
            )
            roles_seen.add(held_out)
            if len(views) < MOST_PANELS:
                view.panels = [
                    _panel(s, noise_of(errors, s), view.windows, both, names, f"p{next(numbers)}") for s in shown
                ]
            views.append(view)
    return views


def showcase(
    series: Sequence[Series],
    errors: Sequence[ChannelError],
    *,
    windows: Windows | None = None,
    both: bool = True,
    names: tuple[str, str] = ("before", "after"),
    place: LocatedChannel | None = None,
    parted: Windows | None = None,
) -> tuple[str, bool, Panel] | None:
    """The one panel to show first, with its run and role: where either model misses most, held-out data first.
    ``place``: look only there, if it has data. ``parted``: where recordings of replays parted from their predictions;
    if there is such a window, the panel is that of the first one."""
    import matplotlib

    able = [s for s in series if len(s.t) > 1 and np.isfinite(residual(s, s.before)).any()]
    if parted:
        windows = parted
        able = [cut for s in able for cut in _around(s, _windows_of(s.run, parted)[:1])] or able
    if place is not None:
        able = [s for s in able if s.channel == place.channel] or able
        able = [s for s in able if place.quantity and s.label.startswith(place.quantity)] or able
    able = [s for s in able if s.held_out] or able
    if not able:
        return None

    def misfit(s: Series) -> float:
        missed = [rms(residual(s, values)) for values in (s.before, s.after)]
        return float(np.nanmax(missed)) / (noise_of(errors, s) or float(np.nanstd(as_floats(s.measured))) or 1.0)

    best = max(able, key=misfit)
    with matplotlib.rc_context(RC):
        spans = _windows_of(best.run, windows or {})
        panel = _panel(best, noise_of(errors, best), spans, both, names, "first")
    return best.run, best.held_out, panel


def _around(series: Series, windows: Sequence[tuple[float, float]]) -> list[Series]:
    """The parts of a series in windows [s], each with :data:`AROUND` of its length before and after, where there is
    data."""
    t = np.asarray(series.t)
    margin = AROUND * float(t[-1] - t[0])
    cuts = []
    for begin, end in windows:
        inside = np.flatnonzero((t >= begin - margin) & (t <= end + margin))
        if len(inside) > 1:
            part = slice(inside[0], inside[-1] + 1)
            lists = {name: getattr(series, name)[part] for name in ("t", "measured", "before", "after")}
            lists["outliers"] = [(when, what) for when, what in series.outliers if t[part][0] <= when <= t[part][-1]]
            cuts.append(replace(series, **lists))
    return [s for s in cuts if np.isfinite(residual(s, s.before)).any()]


def _windows_of(run: str, windows: Windows) -> list[tuple[float, float]]:
    """Time windows of a run: by its name, or by a path that ends in it."""
    for key, value in windows.items():
        if key == run or key.rstrip("/").rsplit("/", 1)[-1] == run:
            return [(float(a), float(b)) for a, b in value]
    return []


def _worst(columns: list[Series], errors: Sequence[ChannelError], most: int) -> list[Series]:
    """The columns that fit worst, in their order."""
    if len(columns) <= most:
        return columns

    def misfit(s: Series) -> float:
        noise = noise_of(errors, s)
        error = rms(residual(s, s.after))
        scale = noise if noise else float(np.nanstd(as_floats(s.measured))) or 1.0
        return error / scale if np.isfinite(error) else 0.0

    kept = sorted(range(len(columns)), key=lambda k: -misfit(columns[k]))[:most]
    return [columns[k] for k in sorted(kept)]


def as_floats(values: Sequence[float | None]) -> np.ndarray:
    """Numbers with NaN where missing."""
    return np.array([np.nan if v is None else v for v in values], dtype=float)


def residual(series: Series, predicted: Sequence[float]) -> np.ndarray:
    """Measured minus predicted, NaN where either is missing."""
    return np.asarray(as_floats(series.measured) - as_floats(predicted))


def rms(values: np.ndarray) -> float:
    """Root mean square of what is there; NaN if nothing is."""
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _panel(
    series: Series,
    noise: float | None,
    windows: Sequence[tuple[float, float]],
    both: bool,
    names: tuple[str, str],
    key: str,
) -> Panel:
    """Overlay above, residual with the band of two noise standard deviations below."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    t = np.asarray(series.t, dtype=float)
    measured, before, after = (as_floats(v) for v in (series.measured, series.before, series.after))
    everything = np.concatenate([measured, before, after])
    finite = everything[np.isfinite(everything)]
    scale = scale_for(series.unit, float(np.max(np.abs(finite))) if len(finite) else None)
    measured, before, after = (v * scale.factor for v in (measured, before, after))

    figure = Figure(figsize=(5.0, 3.1), dpi=72)
    top = figure.add_axes((0.15, 0.40, 0.835, 0.575))
    low = figure.add_axes((0.15, 0.135, 0.835, 0.20), sharex=top)
    for a, b in windows:
        for axes in (top, low):
            axes.axvspan(a, b, color=WINDOW, alpha=0.2, linewidth=0)
    step = max(1, -(-len(t) // MOST_POINTS))
    top.plot(t[::step], measured[::step], ".", color=MEASURED, markersize=4)
    if series.outliers:
        when, what = np.array(series.outliers).T
        top.plot(when, what * scale.factor, "x", color=WINDOW, markersize=5)
    if both:
        top.plot(t, before, color=BEFORE, linewidth=1.3, dashes=(4, 2))
    top.plot(t, after, color=AFTER, linewidth=1.5)
    top.tick_params(labelbottom=False)
    top.grid(axis="y")
    _residuals(low, t, measured - before if both else None, measured - after, noise, scale)
    low.set_xlabel("time [s]", labelpad=1)
    spread = float(t[-1] - t[0]) or 1.0
    low.set_xlim(t[0] - 0.01 * spread, t[-1] + 0.01 * spread)
    for axes, most in ((top, 4), (low, 2)):
        axes.yaxis.set_major_locator(MaxNLocator(nbins=most, steps=STEPS))
        plain = ScalarFormatter(useOffset=False)
        plain.set_scientific(False)
        axes.yaxis.set_major_formatter(plain)
    low.xaxis.set_major_locator(MaxNLocator(nbins=6, steps=STEPS))
    below = f"measured {MINUS} simulated"
    low.text(0.0, 1.06, below, transform=low.transAxes, fontsize=8.5, ha="left", va="bottom")

    unit = f" [{scale.unit}]" if scale.unit else ""
    label = (
        f"{series.channel} {series.label} of {series.run}{unit} against time, {len(t)} instants from {t[0]:.3g} to "
        f"{t[-1]:.3g} s, above {below}."
    )
    svg = inline_svg(figure, key, label)
    return Panel(series.channel, series.label, scale.unit, svg)


def _residuals(
    axes: object, t: np.ndarray, before: np.ndarray | None, after: np.ndarray, noise: float | None, scale: Scale
) -> None:
    """The lower axes of a panel. The limits show the fitted model; a much worse start is cut off."""
    from matplotlib.axes import Axes

    assert isinstance(axes, Axes)
    band = 2.0 * noise * scale.factor if noise else 0.0
    if band:
        axes.axhspan(-band, band, color=BAND, linewidth=0)
    axes.axhline(0.0, color=LINE, linewidth=0.8)
    reach = [1.6 * band]
    if np.isfinite(after).any():
        reach.append(float(np.nanmax(np.abs(after))))
    if before is not None and np.isfinite(before).any():
        reach.append(min(float(np.nanmax(np.abs(before))), 1.6 * max(reach)))
        axes.plot(t, before, color=BEFORE, linewidth=0.9, dashes=(4, 2))
    axes.plot(t, after, color=AFTER, linewidth=0.9)
    limit = 1.1 * max(reach)
    if limit > 0.0:
        axes.set_ylim(-limit, limit)
    axes.spines["bottom"].set_visible(True)
    axes.tick_params(colors=INK, labelcolor=RC["ytick.labelcolor"], color=LINE)
