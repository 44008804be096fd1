"""Matplotlib figures as small inline SVG whose colours follow the page's light or dark scheme.

Figures are drawn in placeholder colours, which become CSS variables here. Fonts are the page's own.
"""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, MUTED, LINE, MEASURED, BEFORE, AFTER, BAND, WINDOW = (f"#0a0b{k:02d}" for k in range(1, 9))
"""Placeholder colours to draw with."""

_VARIABLES = {
    INK: "ink", MUTED: "muted", LINE: "line", MEASURED: "measured", BEFORE: "before", AFTER: "after",
    BAND: "band", WINDOW: "window",
}  # fmt: skip

RC: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "thinshell",
    "font.size": 9.5,
    "axes.edgecolor": LINE,
    "axes.labelcolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.facecolor": "none",
    "xtick.color": LINE,
    "ytick.color": LINE,
    "xtick.labelcolor": MUTED,
    "ytick.labelcolor": MUTED,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "grid.color": LINE,
    "grid.linewidth": 0.6,
    "text.color": MUTED,
    "path.simplify": True,
    "path.simplify_threshold": 0.25,
}
"""Settings to draw with (``matplotlib.rc_context``)."""


def inline_svg(figure: Figure, key: str, label: str) -> str:
    """The figure as an ``<svg>`` element. ``key``: unique on the page; ``label``: its text for those who
    cannot see it."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r'<style type="text/css">.*?</style>', "", text, flags=re.DOTALL)
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    view = re.search(r'viewBox="([^"]*)"', text)
    assert view is not None
    head = f'<svg class="plot" role="img" aria-label="{_escaped(label)}" viewBox="{view[1]}">'
    text = re.sub(r"<svg[^>]*>", lambda _: head, text, count=1)
    text = re.sub(r'(id="|url\(#|xlink:href="#|href="#)', lambda m: f"{m[1]}{key}-", text)
    text = text.replace("xlink:href", "href")
    text = re.sub(r'<path d="[^"]*"( clip-path="[^"]*")? style="fill: none"/>', "", text)
    text = _joined_dots(text)
    text = re.sub(r"<[^>]*>", lambda tag: re.sub(r"-?\d+\.\d{2,}", _tenths, tag[0]), text)
    for colour, name in _VARIABLES.items():
        text = text.replace(colour, f"var(--{name})")
    text = re.sub(r"font: ([\d.]+px)[^;\"]*", r"font-size: \1", text)
    text = re.sub(r"font-family: [^;\"]*;?", "", text)
    return re.sub(r"\s*\n\s*", " ", text).strip()


def _tenths(number: re.Match[str]) -> str:
    return f"{float(number[0]):.1f}".removesuffix(".0")


def _joined_dots(text: str) -> str:
    """Markers, one element each, become one path of round dots."""

    def joined(match: re.Match[str]) -> str:
        uses = re.findall(r'<use [^>]*?x="([-\d.]+)" y="([-\d.]+)"', match[1])
        if len(uses) < 12:
            return match[0]
        path = "".join(f"M{float(x):.1f} {float(y):.1f}h0" for x, y in uses)
        return f'<path class="dots" d="{path}"/>'

    return re.sub(r"((?:<use [^>]*/>\s*)+)", joined, text)


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;").replace(">", "&gt;")
