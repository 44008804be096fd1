"""Sheets that keep a bend: springback with the effect ``bending_plasticity``.

A strip is bent to the curvature k by turning its end clamps, free to shift, and let go. Its law is elastic up to the
curvature k_Y, with linear hardening H beyond (:mod:`sim_core.energies.bending`): plastic part (k - k_Y) / (1 + H),
which is what stays, moment B times the rest, work lost B (k_Y k_p + H k_p^2 / 2) per length. Simo & Hughes,
Computational Inelasticity, sec. 1.2. As k_Y is a curvature and not an angle, the mesh does not decide.

A section whose fibres yield one after the other (elastic-perfectly plastic through the thickness) has another law,
M / M_Y = 3/2 - (k_Y / k)^2 / 2, which this effect does not claim.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_core.solve.step import State, advance, exerted
from sysid.validation.case import STATICS, Case, NotCovered
from sysid.validation.specimens import Strip, rest, strip

SHEET = {"E_pa": 1e9, "nu": 0.0, "thickness_m": 2e-4}
LENGTH, WIDTH, YIELD = 0.05, 0.02, 10.0
STIFFNESS = SHEET["E_pa"] * WIDTH * SHEET["thickness_m"] ** 3 / 12.0
SOURCE = "closed form of the moment-curvature law"


@dataclass
class Bender:
    """A strip with one clamp, and one that turns it; ``hardening``: over the bending stiffness."""

    pattern: str
    cells: tuple[int, int]
    hardening: float = 0.1
    yield_curvature: float = YIELD

    def __post_init__(self) -> None:
        self.bent, self.let_go = (self._strip(("clamped", end)) for end in ("driven", "turned"))
        self.state = rest(self.bent.system)

    def _strip(self, ends: tuple[str, str]) -> Strip:
        law = {"yield_curvature_per_m": self.yield_curvature, "hardening_ratio": self.hardening}
        return strip(LENGTH, WIDTH, {**SHEET, **law}, self.cells, self.pattern, ends)

    def bend(self, curvatures: Sequence[float]) -> list[float]:
        """Turn to each of the curvatures [1/m] in turn, in one step each; the moment [N m] at each."""
        return [self._turn(k) for k in curvatures]

    def _turn(self, curvature: float) -> float:
        system, turned = self.bent.system, self.bent.ends[1]
        angle = curvature * LENGTH
        c, s = np.cos(angle), np.sin(angle)
        tip = LENGTH * np.array([np.sinc(angle / np.pi), 0.0, 0.5 * angle * np.sinc(0.5 * angle / np.pi) ** 2])
        beyond = system.nodes[turned] - [LENGTH, 0.0, 0.0]
        targets = system.nodes.copy()
        targets[turned] = tip + beyond @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        self.state, report = advance(system, self.state, targets, 1.0)
        self.iterations = report.iterations
        arm = self.state.x[turned] - self.state.x[turned].mean(axis=0)
        return -float(np.cross(arm, exerted(system)[turned]).sum(axis=0)[1])

    def release(self) -> float:
        """Curvature [1/m] that stays when the second clamp lets go."""
        system = self.let_go.system
        state: State = replace(self.state, v=np.zeros_like(self.state.v))
        state, _ = advance(system, state, system.nodes, 1.0)
        beyond = self.let_go.ends[1] & ~self.let_go.lines[1]
        tangent = state.x[beyond].mean(axis=0) - state.x[self.let_go.lines[1]].mean(axis=0)
        self.state = state
        return float(np.arctan2(tangent[2], tangent[0]) / LENGTH)


def dissipated(bender: Bender, curvature: float, parts: int = 60) -> float:
    """Work of the clamp [J] on the way to a curvature and back to no moment."""
    there = np.linspace(0.0, curvature, parts + 1)[1:]
    back = curvature - (1.0 - 1e-9) * (curvature - bender.yield_curvature) / (1.0 + bender.hardening)
    down = np.linspace(curvature, curvature - back, parts + 1)[1:]
    path = np.concatenate([[0.0], there, down])
    moments = np.concatenate([[0.0], bender.bend(path[1:].tolist())])
    return float(LENGTH * np.sum(0.5 * (moments[1:] + moments[:-1]) * np.diff(path)))


def springback_cases() -> Iterator[Case | NotCovered]:
    """All comparisons of sheets that keep a bend."""
    meshes = (("regular", (10, 4)), ("irregular", (20, 6)))
    for pattern, cells in meshes:
        mesh = f"{pattern} {cells[0]} x {cells[1]}"
        elastic = Bender(pattern, cells)
        elastic.bend([0.5 * YIELD, 0.95 * YIELD])
        yield Case(
            "bent to 0.95 k_Y and let go", "residual curvature", "k_Y", 0.0, elastic.release() / YIELD, STATICS, mesh,
            SOURCE, scale=1.0,
        )  # fmt: skip
        for hardening in (0.02, 0.2):
            bender = Bender(pattern, cells, hardening)
            name = f"bent to 3 k_Y, H = {hardening:g}"
            moments = np.array(bender.bend([YIELD, 2.0 * YIELD, 3.0 * YIELD])) / (STIFFNESS * YIELD)
            plastic = 2.0 / (1.0 + hardening)
            for k, moment in zip((2.0, 3.0), moments[1:], strict=True):
                flowing = 1.0 + hardening * (k - 1.0) / (1.0 + hardening)
                yield Case(
                    name, f"moment at {k:g} k_Y, flowing by {1.0 / (1.0 + hardening):.2g} k_Y in the step", "B k_Y",
                    flowing, moment, STATICS, mesh, SOURCE,
                )  # fmt: skip
            first = bender.release() / YIELD
            yield Case(name + ", let go", "residual curvature", "k_Y", plastic, first, STATICS, mesh, SOURCE)
            bender.bend([2.5 * YIELD, 3.0 * YIELD])
            again = bender.release() / YIELD
            yield Case(
                name + ", let go, bent again", "change of the residual", "k_Y", 0.0, again - first, STATICS, mesh,
                SOURCE, scale=1.0,
            )  # fmt: skip
            many = Bender(pattern, cells, hardening)
            final = many.bend((YIELD * np.linspace(0.0, 3.0, 25)[1:]).tolist())[-1] / (STIFFNESS * YIELD)
            yield Case(
                name + " in 24 steps", "change of the moment against 3 steps", "B k_Y", 0.0, final - moments[-1], 1e-4,
                mesh, SOURCE, scale=1.0,
            )  # fmt: skip
            yield Case(
                name + " in 24 steps",
                "residual curvature",
                "k_Y",
                plastic,
                many.release() / YIELD,
                STATICS,
                mesh,
                SOURCE,
            )
            lost = dissipated(Bender(pattern, cells, hardening), 3.0 * YIELD) / (STIFFNESS * YIELD**2 * LENGTH)
            exact = plastic + 0.5 * hardening * plastic**2
            yield Case(name + " and back", "work lost", "B k_Y^2 L", exact, lost, STATICS, mesh, SOURCE)
    yield NotCovered(
        "strip that yields through its thickness",
        "the effect is a law of moment and curvature with one yield curvature; residuals k - M(k)/B of a section whose "
        "fibres yield in turn (0.2222 k_Y at 1.5 k_Y, 1.5556 at 3) are another law",
        "elastic-perfectly plastic section",
    )
