"""Strips that bend far: elasticas.

Heavy elastica: a strip held horizontally at one end sags under its own weight,
B theta'' = -w (L - s) cos(theta), depending on Gamma = w L^3 / B alone (w weight per length). Romero et al.,
ACM Trans. Graph. 40(4), 2021; values by integration of the boundary value problem. Drop over reach tends to
Gamma/8 for small Gamma; for large Gamma all of the bend is in a length L / sqrt(2 Gamma) at the clamp, where cells
have to be small.

Tip load: B theta'' = -P cos(theta), Bisshopp & Drucker, Quart. Appl. Math. 3, 1945; Mattiasson, Int. J. Numer.
Meth. Eng. 17, 1981; values by integration, equal to the printed ones. The same with the data of Sze, Liu & Lo,
Finite Elem. Anal. Des. 40, 2004, example 3.1 (L = 10, b = 1, h = 0.1, E = 1.2e6, nu = 0, end shear up to 4).

End moment (Sze, Liu & Lo, example 3.2: L = 12): the strip is an arc of angle t = M L / B, a full circle at the
largest moment: tip at (sin t / t, (1 - cos t) / t) L. The moment is a couple that turns with a rigid tip
(:mod:`sim_core.energies.couple`).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.solve.step import advance
from sim_core.validation.case import STATICS, Case, NotCovered, compare
from sim_core.validation.specimens import DENSITY, Strip, load_up, rest, strip

HEAVY = {
    1e-3: (0.000125, 1.0),
    1e-2: (0.00125, 0.999999),
    0.1: (0.0124984, 0.999911),
    1.0: (0.123471, 0.991246),
    10.0: (0.7002, 0.656354),
    100.0: (0.937524, 0.159223),
    1e3: (0.981141, 0.0459865),
    1e4: (0.99411, 0.0142609),
}
"""Gamma: tip drop and horizontal reach over the length."""

TIP = {1.0: (0.301721, 0.0564332), 5.0: (0.713792, 0.387628), 10.0: (0.810609, 0.554996)}
"""P L^2 / B: tip deflection and shortening over the length."""

END_SHEAR = {0.1: (1.309, 0.103), 0.25: (3.015, 0.563), 0.5: (4.933, 1.604), 0.75: (6.031, 2.541), 1.0: (6.698, 3.286)}
"""Share of the largest end shear: deflection and shortening of the tip."""

END_MOMENT = {0.1: (3.648, 0.774), 0.25: (7.639, 4.361), 0.5: (7.639, 12.0), 0.75: (2.546, 14.546), 1.0: (0.0, 12.0)}
"""Share of the largest end moment: deflection and shortening of the tip."""

HEAVY_QUANTITIES, TIP_QUANTITIES = ("drop / length", "reach / length"), ("deflection / length", "shortening / length")
STRIP = {"E_pa": 1e9, "nu": 0.0, "thickness_m": 2e-4}
SZE_STRIP = {"E_pa": 1.2e6, "nu": 0.0, "thickness_m": 0.1}
LENGTH, WIDTH = 0.2, 0.02
ROMERO = "Romero et al. 2021, boundary value problem"
CHORD = {8.004197: 41.5, 9.253808: 45.0}
"""Gamma: angle [deg] of the chord from the clamp to the tip; at 41.5 deg ASTM D1388 reads a strip's overhang, and
takes 7.5687 (Peirce) for Gamma."""

MATTIASSON = "Mattiasson 1981, boundary value problem"
SZE = "Sze, Liu & Lo 2004"


def heavy_strip(gamma: float, pattern: str, cells: tuple[int, int]) -> tuple[float, float]:
    """Drop and reach of the tip over the length. Beyond Gamma = 100 cells shrink towards the clamp, in proportion to
    the bend there, and the strip is narrower."""
    layer = 1.0 / np.sqrt(2.0 * gamma)
    steep = gamma > 100.0

    def place(share: np.ndarray) -> np.ndarray:
        growth = np.log(1.0 / layer)
        return np.asarray(np.expm1(growth * share) / np.expm1(growth))

    width = WIDTH / 10.0 if steep else WIDTH
    held = strip(LENGTH, width, STRIP, cells, pattern, place=place if steep else None)
    gravity = gamma * STRIP["E_pa"] * STRIP["thickness_m"] ** 2 / 12.0 / (DENSITY * LENGTH**3)

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
    """Deflection and shortening at the shares of :data:`END_SHEAR`."""
    return tip_loaded(strip(10.0, 1.0, SZE_STRIP, cells, pattern), 4.0, list(END_SHEAR))


def end_moment(pattern: str, cells: tuple[int, int], parts: int = 20) -> list[tuple[float, float]]:
    """Deflection and shortening at the shares of :data:`END_MOMENT`; the moment grows in ``parts``."""
    held = strip(12.0, 1.0, SZE_STRIP, cells, pattern, ends=("clamped", "turned"), couple=True)
    assert held.couple is not None
    state, found = rest(held.system), {}
    for k in range(1, parts + 1):
        held.couple.configure({"moment_nm": 50.0 * np.pi / 3.0 * k / parts})
        state, _ = advance(held.system, state, held.system.nodes, 1.0)
        end = state.x[held.lines[1]].mean(axis=0)
        found[round(k / parts, 9)] = float(end[2]), float(12.0 - end[0])
    return [found[share] for share in END_MOMENT]


def elastica_cases() -> Iterator[Case | NotCovered]:
    """All comparisons of strips that bend far."""
    for gamma, reference in HEAVY.items():
        steep = gamma > 100.0
        meshes = [(pattern, (80, 2) if steep else (40, 4)) for pattern in ("regular", "irregular")]
        if 1.0 <= gamma <= 100.0:
            meshes.append(("crossed", (80, 2)))
        for pattern, cells in meshes:
            found = heavy_strip(gamma, pattern, cells)
            coarser = heavy_strip(gamma, pattern, (cells[0] // 2, cells[1] // 2))
            mesh = f"{pattern} {cells[0]} x {cells[1]}" + (", graded" if steep else "")
            name = f"heavy elastica, Gamma = {gamma:g}"
            yield from compare(name, HEAVY_QUANTITIES, reference, found, STATICS, mesh, ROMERO, coarser)
            if gamma <= 0.01:
                ratios = (found[0] / found[1], coarser[0] / coarser[1])
                yield Case(
                    name, "drop / reach", "Gamma/8", 1.0, 8.0 * ratios[0] / gamma, STATICS, mesh, ROMERO,
                    8.0 * ratios[1] / gamma,
                )  # fmt: skip
    for gamma, angle in CHORD.items():
        for pattern in ("regular", "irregular"):
            low, high = (float(np.degrees(np.arctan2(*heavy_strip(gamma, pattern, n)))) for n in ((20, 2), (40, 4)))
            name, mesh = f"overhanging strip, Gamma = {gamma:.4f}", f"{pattern} 40 x 4"
            yield Case(name, "angle of the chord", "deg", angle, high, STATICS, mesh, ROMERO, low)
    for pattern in ("regular", "irregular"):
        for alpha, reference in TIP.items():
            found, coarser = (tip_loaded_strip(alpha, pattern, cells) for cells in ((40, 4), (20, 2)))
            name, mesh = f"tip load, P L^2/B = {alpha:g}", f"{pattern} 40 x 4"
            yield from compare(name, TIP_QUANTITIES, reference, found, STATICS, mesh, MATTIASSON, coarser)
    for title, answers, run, scale in (
        ("end shear", END_SHEAR, end_shear, None),
        ("end moment", END_MOMENT, end_moment, 12.0),
    ):
        for pattern in ("regular", "irregular"):
            fine, coarse = run(pattern, (40, 4)), run(pattern, (20, 2))
            for (share, reference), ours, twice in zip(answers.items(), fine, coarse, strict=True):
                name, mesh = f"cantilever, {title}, {share:g} of the largest", f"{pattern} 40 x 4"
                quantities = ("deflection", "shortening")
                yield from compare(name, quantities, reference, ours, STATICS, mesh, SZE, twice, scale=scale)
    yield NotCovered("naturally curved rod that bends and twists", "sheets are no rods", "Romero et al. 2021")
