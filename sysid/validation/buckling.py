"""Columns: loads at which they give way, and the elastica beyond.

Euler's loads P L^2 / B of a column with two ends of any kind (Timoshenko & Gere, Theory of Elastic Stability, 2nd
ed., sec. 2.1-2.2) and the weight w L^3 / B under which an upright column gives way (Greenhill 1881). Where the column
is straight, the square of its lowest natural frequency falls to zero with the load: :func:`critical_load`.

Beyond its first buckling load a column with two hinges is an elastica (:mod:`sysid.validation.planar_elastica`),
driven here by the approach of the ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from sim_core.errors import ConfigError
from sim_core.solve.step import State, advance, exerted
from sim_core.solve.system import System
from sysid.validation import planar_elastica
from sysid.validation.case import STATICS, THRESHOLDS, Case, compare
from sysid.validation.small_motions import natural_vibrations
from sysid.validation.specimens import DENSITY, FINE, LONG, MESHES, Strip, described, rest, strip

EULER = {
    ("clamped", "free"): np.pi**2 / 4.0,
    ("pinned", "rolling"): np.pi**2,
    ("clamped", "rolling"): 4.493409457909064**2,
    ("clamped", "guided"): 4.0 * np.pi**2,
}
"""Ends: P L^2 / B."""

GREENHILL = 7.83734744
"""Weight w L^3 / B of an upright column, w per length."""

POST_BUCKLED = (0.0675678, 0.25898, 0.543053, 0.87684)
"""Approaches of the ends over the length, at which their slope is 30, 60, 90 and 120 degrees."""

STRIP = {"E_pa": 1e9, "nu": 0.0, "thickness_m": 2e-4}
LENGTH, WIDTH = 0.2, 0.02
STIFFNESS = STRIP["E_pa"] * WIDTH * STRIP["thickness_m"] ** 3 / 12.0
TIMOSHENKO = "Timoshenko & Gere, Theory of Elastic Stability"
GREENHILL_1881 = "Greenhill 1881, boundary value problem"
ELASTICA = "planar elastica, elliptic integrals"


def critical_load(system: System, state: State, apply: Callable[[float], None], guess: float) -> float:
    """Load at which the equilibrium that it leads to from ``state`` ceases to be stable.

    ``apply`` puts a load on. The square of the lowest natural frequency is followed from ``guess``, which may be far
    too low, towards its zero, which is extrapolated from the last three loads.
    """
    loads: list[float] = []
    squares: list[float] = []
    for _ in range(12):
        load = guess * len(loads) if len(loads) < 2 else loads[-1] + 0.8 * (zero(loads[-2:], squares[-2:]) - loads[-1])
        apply(load)
        state, _ = advance(system, state, system.nodes, 1.0)
        loads.append(load)
        squares.append(float(natural_vibrations(system, 1)[0][0] ** 2))
        if len(loads) > 1 and squares[-1] >= squares[-2]:
            break
        if squares[-1] < 0.03 * squares[0]:
            return zero(loads[-3:], squares[-3:])
    raise ConfigError("The lowest frequency does not fall to zero with the load.", "Start from another load.")


def zero(loads: list[float], squares: list[float]) -> float:
    """Load at which the polynomial through all points, load over square, has its zero."""
    return float(np.polynomial.Polynomial.fit(squares, loads, len(loads) - 1)(0.0))


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
        yield state, float(exerted(system)[column.ends[1], 0].sum())


def post_buckled(pattern: str, cells: tuple[int, int]) -> list[tuple[float, float, float]]:
    """P / P_E, slope at the ends [deg] and deflection at the middle at the approaches of :data:`POST_BUCKLED`."""
    column = strip(LENGTH, WIDTH, STRIP, cells, pattern, ("pinned", "pinned"))
    found = []
    for state, force in pushed_together(column, list(POST_BUCKLED)):
        tangent = column.line(state.x, 0.0)[1]
        slope = float(np.degrees(np.arctan2(tangent[2], tangent[0])))
        middle = float(column.line(state.x, 0.5 * LENGTH)[0][2]) / LENGTH
        found.append((-force * LENGTH**2 / STIFFNESS / np.pi**2, slope, middle))
    return found


def buckling_cases() -> Iterator[Case]:
    """All comparisons of columns."""
    for pattern in ("regular", "irregular"):
        mesh = described(pattern, MESHES)
        for ends, reference in EULER.items():
            *coarser, load = (euler(ends, pattern, cells) for cells in MESHES)
            yield Case(
                f"column, {ends[0]} and {ends[1]}", "buckling load", "B/L^2", reference, load, THRESHOLDS, mesh,
                TIMOSHENKO, tuple(coarser),
            )  # fmt: skip
        *coarser, weight = (greenhill(pattern, cells) for cells in MESHES)
        yield Case(
            "upright column under its own weight", "buckling weight", "B/L^2", GREENHILL, weight, THRESHOLDS, mesh,
            GREENHILL_1881, tuple(coarser),
        )  # fmt: skip
    for pattern, meshes in (("regular", FINE), ("irregular", FINE), ("crossed", LONG)):
        runs = zip(*(post_buckled(pattern, cells) for cells in meshes), strict=True)
        for approach, found in zip(POST_BUCKLED, runs, strict=True):
            force, slope, middle = planar_elastica.hinged(approach)
            name = f"column with two hinges, shortened by {approach:.3f} L"
            quantities = ("P / P_Euler", "slope at the ends [deg]", "deflection / length")
            expected = (force, float(np.degrees(slope)), middle)
            yield from compare(name, quantities, expected, found, STATICS, described(pattern, meshes), ELASTICA)
