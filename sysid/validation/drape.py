"""A disc of fabric that hangs over a smaller round table, in folds (Cusick, J. Text. Inst. 56, 1965, T596).

The drape coefficient is the area of the shadow of what hangs over, divided by its area at rest: a disc of 30 cm on one
of 18 cm, as in the standard test (BS 5058), which holds the fabric between two discs. The fabric is an isotropic shell
with the weight and the bending stiffness of a denim. It may rest with one number of folds or another; which it takes
depends on how it is let down, so light forces at its rim begin the folds and then fade away.

The reference solutions are those of another method, which shares nothing with this one: the same shell (Koiter's
energy) by B-splines of degree five along the radius and Fourier series around, its energy minimised by Newton's method
among shapes with that number of equal folds (``tests/validation/draped_disc.py``). Eight harmonics of the folds in
place of the fourteen here change the coefficient by 0.002.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from sim_core.rigs import Rig, parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sysid.validation.case import STATICS, Case, compare

TABLE, DISC = 0.09, 0.15
"""Radii [m]."""

THICKNESS, BENDING, NU, AREAL = 1e-3, 5e-5, 0.3, 0.4
"""Thickness [m], bending stiffness [N m], Poisson's ratio, mass per area [kg/m^2]."""

SEED, SEEDED_S = 0.02, 4.0
"""Force at each crest and against each valley at the start [N], and the time [s] in which it fades away."""

DRAPED = {5: (0.7340, -0.2634, -0.7600), 4: (0.6961, -0.1770, -0.8338)}
"""Number of folds: drape coefficient, and heights of the rim at crests and valleys over the width that hangs over."""

SHELL = "Koiter shell, splines and Fourier series"


def disc_mesh(around: int, across: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes ``(n, 3)`` [m] in rings, every other one turned by half a cell, and triangles ``(m, 3)``. The innermost
    ring is a cell within the table, the next one is its edge, the last one the rim, which is not turned."""
    radii = TABLE + (DISC - TABLE) / across * np.arange(-1, across + 1)
    ahead = (np.arange(across + 1, -1, -1) % 2).astype(bool)
    angles = 2.0 * np.pi * (np.arange(around) + 0.5 * ahead[:, None]) / around
    nodes = np.stack([radii[:, None] * np.cos(angles), radii[:, None] * np.sin(angles), 0.0 * angles], axis=-1)
    index = np.arange(angles.size).reshape(angles.shape)
    triangles = []
    for low, high, turned in zip(index[:-1], index[1:], ahead[:-1], strict=True):
        a, b, c, d = low, np.roll(low, -1), high, np.roll(high, -1)
        for corners in ((a, c, d), (a, d, b)) if turned else ((a, c, b), (b, c, d)):
            triangles.append(np.stack(corners, axis=1))
    return nodes.reshape(-1, 3), np.concatenate(triangles)


def drape_rig(folds: int, around: int, across: int, file: Path) -> Rig:
    """The fabric with the cells of :func:`disc_mesh`, which is written to a file."""
    nodes, triangles = disc_mesh(around, across)
    lines = [f"v {x:.12g} {y:.12g} {z:.12g}" for x, y, z in nodes.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    file.write_text("\n".join(lines) + "\n")
    reach = 0.2 * (DISC - TABLE) / across

    def near(node: np.ndarray) -> dict[str, Any]:
        x, y, _ = node.tolist()
        return {"x_m": [x - reach, x + reach], "y_m": [y - reach, y + reach]}

    seeds = [
        {
            "name": f"seed_{k}",
            "type": "force",
            "body": "fabric",
            "region": near(nodes[len(nodes) - around + k * around // (2 * folds)]),
            "force_n": [0.0, 0.0, SEED * (-1.0) ** k],
            "times_s": [0.0, SEEDED_S],
            "values": [1.0, 0.0],
        }
        for k in range(2 * folds)
    ]
    material = {
        "E_pa": 12.0 * BENDING * (1.0 - NU**2) / THICKNESS**3,
        "nu": NU,
        "thickness_m": THICKNESS,
        "density_kg_m3": AREAL / THICKNESS,
    }
    shape = {"type": "mesh", "file": str(file), "unit": "m"}
    return parse_rig(
        {
            "name": "drape",
            "solver": {"dt_s": 1.0, "inertia": False},
            "bodies": {"fabric": {"type": "sheet", "shape": shape, "material": material}},
            "clamps": [
                {"body": "fabric", "region": near(node), "axes": ["x", "y", "z"]} for node in nodes[: 2 * around]
            ],
            "loads": seeds,
        },
        "drape",
    )


def draped(folds: int, around: int, across: int) -> tuple[float, float, float]:
    """What :data:`DRAPED` has, as the simulator finds it."""
    with TemporaryDirectory() as folder:
        scene = build_scene(drape_rig(folds, around, across, Path(folder) / "disc.obj"))
    simulation = Simulation(scene)
    for _ in range(round(SEEDED_S) + 1):
        simulation.step({}, 1.0)
    x, y, z = simulation.state.x[scene.bodies["fabric"].nodes[-around:]].T
    shadow = 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    inside, whole = np.pi * TABLE**2, np.pi * DISC**2
    crests, valleys = z[:: around // folds], z[around // (2 * folds) :: around // folds]
    crest, valley = (float(part.mean()) / (DISC - TABLE) for part in (crests, valleys))
    return (shadow - inside) / (whole - inside), crest, valley


def drape_cases() -> Iterator[Case]:
    """All comparisons of the disc."""
    for folds, expected in DRAPED.items():
        yield from compare(
            f"fabric disc over a round table, {folds} folds",
            ("drape coefficient", "height of crests", "height of valleys"), expected,
            [draped(folds, n, n // 10) for n in (40, 80, 160)], STATICS, "rings, 2880 nodes", SHELL, scale=1.0,
        )  # fmt: skip
