"""Colours of bodies, quantities and words, the same in pictures and on the page."""

from __future__ import annotations

from functools import cache

import numpy as np

from sim_core.postprocess import Surface

BODY_COLOURS = {
    "sheet": ("#e8b04a", "#d9774f", "#c9a27e", "#b8c46a"),
    "gel": ("#5aa9e6", "#7f8ff4", "#4cc3b5", "#a58be0"),
    "affine": ("#b48ead", "#d08a8a", "#8fae7e", "#c2a45f"),
    "rigid": ("#9aa5b1", "#b7b0a5", "#8d99a6", "#a6a6b8"),
    "plane": ("#d3d8de",),
}
"""Of bodies of each kind, in the order of the rig."""

GEL_ALPHA = 0.62
"""Opacity of a gel in its own colour: what is in and behind it shows through."""

MARKER, MEASURED, CLAMP, BOND = "#15304f", "#d6336c", "#c2410c", "#0f766e"
SOUGHT = "#0a8f3c"
"""Of where points are to be at the end."""

AXES = ("#d62839", "#2b9348", "#1d4ed8")
CAMERA, WRENCH, INK, MUTED, BAD = "#6d28d9", "#0f766e", "#17202b", "#5b6673", "#b3261e"
PAPER_TOP, PAPER_BOTTOM = "#ffffff", "#e9edf2"
COLOUR_MAP, DARKEST = "YlOrRd", 0.94


def rgb(colour: str) -> np.ndarray:
    """RGB from 0 to 1 of a colour as ``#rrggbb``."""
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0


def body_colours(skins: tuple[Surface, ...]) -> dict[str, str]:
    """A colour for each body, by its kind."""
    seen: dict[str, int] = {}
    found = {}
    for skin in skins:
        k = seen.get(skin.kind, 0)
        palette = BODY_COLOURS[skin.kind]
        found[skin.body] = palette[k % len(palette)]
        seen[skin.kind] = k + 1
    return found


@cache
def colour_table() -> np.ndarray:
    """The map of values, RGB from 0 to 1 ``(256, 3)``."""
    from matplotlib import colormaps

    return np.asarray(colormaps[COLOUR_MAP](np.linspace(0.0, DARKEST, 256)))[:, :3]


def by_value(values: np.ndarray, top: float) -> np.ndarray:
    """Colours of values between 0 and ``top``, RGB ``(n, 3)``; grey where NaN."""
    share = np.clip(np.nan_to_num(values) / (top or 1.0), 0.0, 1.0)
    out = colour_table()[(255.0 * share).round().astype(int)].copy()
    out[np.isnan(values)] = rgb("#b8c0c9")
    return np.asarray(out)


def round_up(value: float) -> float:
    """The next of 1, 1.5, 2, 3, 5, 7 times a power of ten."""
    if not value > 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(s * power for s in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0) if s * power >= value * (1.0 - 1e-9)))


def round_length(length: float) -> float:
    """1, 2 or 5 times a power of ten, at most ``length``."""
    power = 10.0 ** np.floor(np.log10(max(length, 1e-9)))
    return float(max(s * power for s in (1.0, 2.0, 5.0) if s * power <= length))
