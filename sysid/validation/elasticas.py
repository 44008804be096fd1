"""Strips that bend far: elasticas.

Heavy elastica: a strip held horizontally at one end sags under its own weight,
B theta'' = -w (L - s) cos(theta), depending on Gamma = w L^3 / B alone (w weight per length). Romero et al.,
ACM Trans. Graph. 40(4), 2021. Drop over reach tends to
Gamma/8 for small Gamma; for large Gamma all of the bend is in a length L / sqrt(2 Gamma) at the clamp, where cells
have to be small.

Tip load: B theta'' = -P cos(theta), Bisshopp & Drucker, Quart. Appl. Math. 3, 1945; Mattiasson, Int. J. Numer.
Meth. Eng. 17, 1981. The same with the data of Sze, Liu & Lo,
Finite Elem. Anal. Des. 40, 2004, example 3.1 (L = 10, b = 1, h = 0.1, E = 1.2e6, nu = 0, end shear up to 4).

End moment (Sze, Liu & Lo, example 3.2: L = 12): the strip is an arc of angle t = M L / B, a full circle at the
largest moment: tip at (sin t / t, (1 - cos t) / t) L. The moment is a couple that turns with a rigid tip
(:mod:`sim_core.energies.couple`).

Solutions: :mod:`sysid.validation.planar_elastica`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.solve.step import advance
from sysid.validation import planar_elastica
from sysid.validation.case import STATICS, Case, NotCovered, compare
from sysid.validation.specimens import DENSITY, FINE, LONG, MESHES, Strip, described, load_up, rest, strip

HEAVY = (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e3, 1e4)
"""Gamma."""

TIP = (1.0, 5.0, 10.0)
"""P L^2 / B."""

SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)
"""Of the largest end shear and the largest end moment."""

HEAVY_QUANTITIES, TIP_QUANTITIES = ("drop / length", "reach / length"), ("deflection / length", "shortening / length")
STRIP = {"E_pa": 1e9, "nu": 0.0, "thickness_m": 2e-4}
SZE_STRIP = {"E_pa": 1.2e6, "nu": 0.0, "thickness_m": 0.1}
LENGTH, WIDTH = 0.2, 0.02
TURN = 2.0 * np.pi
ROMERO = "Romero et al. 2021, boundary value problem"
CHORD = {8.004197: 41.5, 9.253808: 45.0}
"""Gamma: angle [deg] of the chord from the clamp to the tip; at 41.5 deg ASTM D1388 reads a strip's overhang, and
takes 7.5687 (Peirce) for Gamma."""

MATTIASSON = "Mattiasson 1981, boundary value problem"
SZE = "problems of Sze, Liu & Lo 2004, planar elastica"
PRINTED = "the printed solutions, those of meshes of quadrilaterals, are up to 0.5 % off the elastica"


def heavy_strip(gamma: float, pattern: str, cells: tuple[int, int]) -> tuple[float, float]:
    """Drop and reach of the tip over the length. Beyond Gamma = 100 cells shrink towards the clamp, in proportion to
    the bend there, and the strip is narrower and, so as not to stretch, thinner."""
    layer = 1.0 / np.sqrt(2.0 * gamma)
    steep = gamma > 100.0

    def place(share: np.ndarray) -> np.ndarray:
        growth = np.log(1.0 / layer)
        return np.asarray(np.expm1(growth * share) / np.expm1(growth))

    width, values = WIDTH, STRIP
    if steep:
        width, values = WIDTH / 10.0, {**STRIP, "thickness_m": STRIP["thickness_m"] / 10.0}
    held = strip(LENGTH, width, values, cells, pattern, place=place if steep else None)
    gravity = gamma * values["E_pa"] * values["thickness_m"] ** 2 / 12.0 / (DENSITY * LENGTH**3)

    def apply(share: float) -> None:
        held.system.gravity = np.array([0.0, 0.0, -gravity * share])

    first = min(1.0, 3.0 / gamma)
    shares = np.geomspace(first, 1.0, 1 + int(np.ceil(np.log(1.0 / first) / np.log(1.6))))
    end = load_up(held.system, shares, apply).x[held.lines[1]].mean(axis=0)
    return float(-end[2] / LENGTH), float(end[0] / LENGTH)


def tip_loaded(held: Strip, force: float, shares: list[float]) -> list[tuple[float, float]]:
    """Deflection and shortening [m] of a cantilever at shares of the end shear ``force`` [N]."""
    spread, tip = held.spread(1), held.lines[1]
    state, before, found = rest(held.system), 0.0, []
    for share in shares:
        for part in np.linspace(before, share, 2 + int(8 * (share - before)))[1:]:
            held.system.loads[:, 2] = -part * force * spread
            state, _ = advance(held.system, state, held.system.nodes, 1.0)
        before = share
        end = state.x[tip].mean(axis=0)
        found.append((float(-end[2]), float(held.length - end[0])))
    return found


def tip_loaded_strip(alpha: float, pattern: str, cells: tuple[int, int]) -> tuple[float, float]:
    """Deflection and shortening of the tip over the length."""
    held = strip(LENGTH, WIDTH, STRIP, cells, pattern)
    stiffness = STRIP["E_pa"] * WIDTH * STRIP["thickness_m"] ** 3 / 12.0
    deflection, shortening = tip_loaded(held, alpha * stiffness / LENGTH**2, [1.0])[0]
    return deflection / LENGTH, shortening / LENGTH


def end_shear(pattern: str, cells: tuple[int, int]) -> list[tuple[float, float]]:
    """Deflection and shortening over the length at the shares of :data:`SHARES`."""
    found = tip_loaded(strip(10.0, 1.0, SZE_STRIP, cells, pattern), 4.0, list(SHARES))
    return [(deflection / 10.0, shortening / 10.0) for deflection, shortening in found]


def end_moment(pattern: str, cells: tuple[int, int], parts: int = 20) -> list[tuple[float, float]]:
    """Deflection and shortening over the length at the shares of :data:`SHARES`; the moment grows in ``parts``."""
    held = strip(12.0, 1.0, SZE_STRIP, cells, pattern, ends=("clamped", "turned"), couple=True)
    assert held.couple is not None
    state, found = rest(held.system), {}
    for k in range(1, parts + 1):
        held.couple.configure({"moment_nm": 50.0 * np.pi / 3.0 * k / parts})
        state, _ = advance(held.system, state, held.system.nodes, 1.0)
        end = state.x[held.lines[1]].mean(axis=0)
        found[round(k / parts, 9)] = float(end[2] / 12.0), float(1.0 - end[0] / 12.0)
    return [found[share] for share in SHARES]


def elastica_cases() -> Iterator[Case | NotCovered]:
    """All comparisons of strips that bend far."""
    for gamma in HEAVY:
        patterns = ("regular", "irregular", "crossed") if 1.0 <= gamma <= 100.0 else ("regular", "irregular")
        for pattern in patterns:
            meshes = LONG if pattern == "crossed" or gamma > 100.0 else MESHES
            runs = [heavy_strip(gamma, pattern, cells) for cells in meshes]
            mesh = described(pattern, meshes) + (", graded" if gamma > 100.0 else "")
            name, expected = f"heavy elastica, Gamma = {gamma:g}", planar_elastica.heavy(gamma)
            yield from compare(name, HEAVY_QUANTITIES, expected, runs, STATICS, mesh, ROMERO)
            if gamma <= 0.01:
                *coarser, slope = (8.0 * drop / reach / gamma for drop, reach in runs)
                ratio = 8.0 * expected[0] / expected[1] / gamma
                yield Case(
                    name, "drop / reach", "Gamma/8", ratio, slope, STATICS, mesh, ROMERO, tuple(coarser)
                )  # fmt: skip
    for gamma, angle in CHORD.items():
        for pattern in ("regular", "irregular"):
            *coarser, chord = (float(np.degrees(np.arctan2(*heavy_strip(gamma, pattern, n)))) for n in MESHES)
            name, mesh = f"overhanging strip, Gamma = {gamma:.4f}", described(pattern, MESHES)
            yield Case(name, "angle of the chord", "deg", angle, chord, STATICS, mesh, ROMERO, tuple(coarser))
    for pattern in ("regular", "irregular"):
        for alpha in TIP:
            runs = [tip_loaded_strip(alpha, pattern, cells) for cells in MESHES]
            name, expected = f"tip load, P L^2/B = {alpha:g}", planar_elastica.tip_loaded(alpha)
            mesh = described(pattern, MESHES)
            yield from compare(name, TIP_QUANTITIES, expected, runs, STATICS, mesh, MATTIASSON)
    for title, run, meshes, exact, scale in (
        ("end shear", end_shear, MESHES, [planar_elastica.tip_loaded(4.0 * share) for share in SHARES], None),
        ("end moment", end_moment, FINE, [planar_elastica.rolled(TURN * share) for share in SHARES], 1.0),
    ):
        for pattern in ("regular", "irregular"):
            by_share = zip(*(run(pattern, cells) for cells in meshes), strict=True)
            for share, expected, found in zip(SHARES, exact, by_share, strict=True):
                yield from compare(
                    f"cantilever, {title}, {share:g} of the largest", TIP_QUANTITIES, expected,
                    found, STATICS, described(pattern, meshes), SZE, scale=scale, remark=PRINTED,
                )  # fmt: skip
    yield NotCovered("naturally curved rod that bends and twists", "sheets are no rods", "Romero et al. 2021")
