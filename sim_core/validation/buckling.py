"""Columns: loads at which they give way, and the elastica beyond.

Euler's loads P L^2 / B of a column with two ends of any kind (Timoshenko & Gere, Theory of Elastic Stability, 2nd
ed., sec. 2.1-2.2) and the weight w L^3 / B under which an upright column gives way (Greenhill 1881). Where the column
is straight, the square of its lowest natural frequency falls to zero with the load: :func:`critical_load`.

Beyond its first buckling load a column with two hinges is an elastica: with the slope a at the ends,
P / P_E = (2 K(k) / pi)^2, k = sin(a/2); shortening and deflection by elliptic integrals. Driven here by the approach
of the ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from sim_core.errors import ConfigError
from sim_core.solve.modes import natural_vibrations
from sim_core.solve.step import State, advance
from sim_core.solve.system import System
from sim_core.validation.case import STATICS, THRESHOLDS, Case, compare
from sim_core.validation.specimens import DENSITY, Strip, rest, strip

EULER = {
    ("clamped", "free"): np.pi**2 / 4.0,
    ("pinned", "rolling"): np.pi**2,
    ("clamped", "rolling"): 20.1907,
    ("clamped", "guided"): 4.0 * np.pi**2,
}
"""Ends: P L^2 / B."""

GREENHILL = 7.837347
"""Weight w L^3 / B of an upright column, w per length."""

POST_BUCKLED = {
    30: (1.03512, 0.0675678, 0.16195),
    60: (1.15172, 0.25898, 0.296604),
    90: (1.3932, 0.543053, 0.38138),
    120: (1.8848, 0.87684, 0.401585),
}
"""Slope at the ends [deg]: P / P_E, approach of the ends and deflection at the middle over the length."""

STRIP = {"E_pa": 1e9, "nu": 0.0, "thickness_m": 2e-4}
LENGTH, WIDTH = 0.2, 0.02
STIFFNESS = STRIP["E_pa"] * WIDTH * STRIP["thickness_m"] ** 3 / 12.0
TIMOSHENKO = "Timoshenko & Gere, Theory of Elastic Stability"
GREENHILL_1881 = "Greenhill 1881, boundary value problem"
ELASTICA = "planar elastica, elliptic integrals"


def critical_load(system: System, state: State, apply: Callable[[float], None], guess: float) -> float:
    """Load at which the equilibrium that it leads to from ``state`` ceases to be stable.

    ``apply`` puts a load on. The square of the lowest natural frequency is followed from ``guess``, which may be far
    too low, towards its zero, which is extrapolated from the last two loads.
    """
    loads: list[float] = []
    squares: list[float] = []
    for _ in range(12):
        load = guess * len(loads) if len(loads) < 2 else loads[-1] + 0.8 * (zero(loads, squares) - loads[-1])
        apply(load)
        state, _ = advance(system, state, system.nodes, 1.0)
        loads.append(load)
        squares.append(float(natural_vibrations(system, 1)[0][0] ** 2))
        if len(loads) > 1 and squares[-1] >= squares[-2]:
            break
        if squares[-1] < 0.03 * squares[0]:
            return zero(loads, squares)
    raise ConfigError("The lowest frequency does not fall to zero with the load.", "Start from another load.")


def zero(loads: list[float], squares: list[float]) -> float:
    """Zero of the straight line through the last two points."""
    slope = (squares[-1] - squares[-2]) / (loads[-1] - loads[-2])
    return loads[-1] - squares[-1] / slope


def euler(ends: tuple[str, str], pattern: str, cells: tuple[int, int]) -> float:
    """P L^2 / B of a column with these ends; the load acts along x on the second."""
    column = strip(LENGTH, WIDTH, STRIP, cells, pattern, ends)
    spread = column.spread(1)

    def apply(load: float) -> None:
        column.system.loads[:, 0] = -load * STIFFNESS / LENGTH**2 * spread

    return critical_load(column.system, rest(column.system), apply, 0.5)


def greenhill(pattern: str, cells: tuple[int, int]) -> float:
    """w L^3 / B of a column that stands on its clamp."""
    column = strip(LENGTH, WIDTH, STRIP, cells, pattern)
    weight = STIFFNESS / (DENSITY * STRIP["thickness_m"] * WIDTH * LENGTH**3)

    def apply(load: float) -> None:
        column.system.gravity = np.array([-load * weight, 0.0, 0.0])

    return critical_load(column.system, rest(column.system), apply, 2.0)


def pushed_together(column: Strip, approaches: list[float], parts: int = 40) -> Iterator[tuple[State, float]]:
    """States of a column whose ends approach by shares of its length, and the force between them [N]. A light
    push at the middle, taken off again, shows the way out."""
    system = column.system
    state, before = rest(system), 0.0
    for approach in approaches:
        for part in np.linspace(before, approach, 2 + int(parts * (approach - before)))[1:]:
            targets = system.nodes.copy()
            targets[column.ends[1], 0] -= part * column.length
            if before == 0.0:
                push = 0.3 * STIFFNESS / LENGTH**2
                system.loads[:, 2] = push * column.middle() / np.count_nonzero(column.middle())
                state, _ = advance(system, state, targets, 1.0)
                system.loads[:, 2] = 0.0
            state, _ = advance(system, state, targets, 1.0)
            before = part
        yield state, float(system.static_gradient()[column.ends[1], 0].sum())


def post_buckled(pattern: str, cells: tuple[int, int]) -> list[tuple[float, float, float]]:
    """P / P_E, slope at the ends [deg] and deflection at the middle at the approaches of :data:`POST_BUCKLED`."""
    column = strip(LENGTH, WIDTH, STRIP, cells, pattern, ("pinned", "pinned"))
    found = []
    for state, force in pushed_together(column, [row[1] for row in POST_BUCKLED.values()]):
        tangent = column.line(state.x, 0.0)[1]
        slope = float(np.degrees(np.arctan2(tangent[2], tangent[0])))
        middle = float(column.line(state.x, 0.5 * LENGTH)[0][2]) / LENGTH
        found.append((-force * LENGTH**2 / STIFFNESS / np.pi**2, slope, middle))
    return found


def buckling_cases() -> Iterator[Case]:
    """All comparisons of columns."""
    for pattern in ("regular", "irregular"):
        for ends, reference in EULER.items():
            fine, coarse = euler(ends, pattern, (40, 4)), euler(ends, pattern, (20, 2))
            yield Case(
                f"column, {ends[0]} and {ends[1]}", "buckling load", "B/L^2", reference, fine, THRESHOLDS,
                f"{pattern} 40 x 4", TIMOSHENKO, coarse,
            )  # fmt: skip
        fine, coarse = greenhill(pattern, (40, 4)), greenhill(pattern, (20, 2))
        yield Case(
            "upright column under its own weight", "buckling weight", "B/L^2", GREENHILL, fine, THRESHOLDS,
            f"{pattern} 40 x 4", GREENHILL_1881, coarse,
        )  # fmt: skip
    for pattern, (along, across) in (("regular", (40, 4)), ("irregular", (40, 4)), ("crossed", (80, 2))):
        found, coarser = post_buckled(pattern, (along, across)), post_buckled(pattern, (along // 2, across // 2))
        for (slope, (force, approach, middle)), ours, twice in zip(POST_BUCKLED.items(), found, coarser, strict=True):
            name = f"column with two hinges, shortened by {approach:.3f} L"
            quantities = ("P / P_Euler", "slope at the ends [deg]", "deflection / length")
            answers = (force, float(slope), middle)
            yield from compare(
                name, quantities, answers, ours, STATICS, f"{pattern} {along} x {across}", ELASTICA, twice
            )
