"""Membrane energy of a rubber film: incompressible neo-Hookean law in plane stress.

    W = mu / 2 (tr C + 1 / det C - 3),    mu = E / 3,    C = F^T F = 1 + 2 E_Green  (2 x 2, in plane)

per volume at rest; a film that keeps its volume is 1 / J = 1 / sqrt(det C) times as thick as at rest, and that is the
last stretch of the three (Treloar, The Physics of Rubber Elasticity, 3rd ed., eq. 4.10; Holzapfel, Nonlinear Solid
Mechanics, sec. 6.3). At small strain it is linear elasticity with nu = 1/2, whose stiffness D the film's own membrane
has (:mod:`sim_core.energies.membrane`), its damping included; the law is what the energy is more than 1/2 e . D e.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sim_core.core.material import MaterialFormula
from sim_core.effects.hooks import MaterialLaw
from sim_core.effects.scopes import Scope
from sim_core.errors import ConfigError
from sim_core.rigs import Sheet

INCOMPRESSIBLE = 0.5


def beyond_linear(e: Any, d: Any) -> Any:
    """h W - 1/2 e . D e, with h mu = D_33, of the Green strain e = (e_11, e_22, 2 e_12)."""
    thinner = 1.0 / ((1.0 + 2.0 * e[0]) * (1.0 + 2.0 * e[1]) - e[2] * e[2])
    return d[2, 2] * (e[0] + e[1] + 0.5 * (thinner - 1.0)) - 0.5 * e.dot(d @ e)


class RubberFilm(MaterialLaw):
    """The law of sheets that the rig calls neo-Hookean. It is no effect that a rig may add."""

    name = "rubber"
    title = "the sheet is a rubber film"
    parts = ("membrane",)
    formula = MaterialFormula(beyond_linear)
    scope = Scope(
        "a sheet with the neo-Hookean law",
        lambda rig: tuple(n for n, b in rig.bodies.items() if isinstance(b, Sheet) and b.law == "neo_hookean"),
    )


RUBBER = RubberFilm()


def check_numbers(name: str, numbers: Mapping[str, float]) -> None:
    """Raise ``ConfigError`` where the numbers of the membrane of a film are not those of such a law."""
    ratio = numbers.get("anisotropy_ratio", 1.0)
    if numbers["nu"] != INCOMPRESSIBLE or ratio != 1.0:
        raise ConfigError(
            f"{name}: the neo-Hookean law of films is isotropic and keeps the volume, and nu is {numbers['nu']:g}, the "
            f"ratio of moduli {ratio:g}.",
            "Write 'nu: 0.5' and leave out what makes a sheet anisotropic, or leave out 'law: neo_hookean'.",
        )
