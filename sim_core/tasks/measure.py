"""What the reward of a task is made of: positions of material points, and plastic fold angles at the end.

Points are read by marker sensors that are added to the rig, so that the adjoint of readings takes their derivatives.
A plastic fold angle is a linear function of the plastic curvature of a sheet's triangles (Voigt 11, 22, 2*12 along the
sheet's x and y),

    F = 1/W sum_T A_T s_T kappa^p_T,11,

W the width of the sheet and s_T the share of the triangle T within the band of the line: the integral of the plastic
curvature over the band, per length of the crease. On a mesh of hinges of length l_e across the crease that turn by
theta_e it is sum_e l_e theta_e / W, the mean of the hinges' plastic angles, and does not depend on the mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim_core.energies.term import Internals
from sim_core.geometry.sheets import SheetMesh
from sim_core.rigs import MarkerSensor, Points, Rectangle, Rig, Sheet, WrenchSensor
from sim_core.scene import Scene
from sim_core.tasks.load import MadeTask
from sim_core.tasks.schema import FoldLine, ObservedPoints

POINTS, FORCE = "task_points_", "task_force_"
"""Beginnings of the names of channels: of observed points and of the wrenches of fingers."""


@dataclass(frozen=True)
class Seen:
    """What a reward is made of. ``times`` [s] ``(n,)``; ``points`` by name: positions in the base frame [m]
    ``(n, k, 3)``; ``folds`` by name: plastic fold angles at the end [rad]; ``acting``: number of the time at which the
    hands begin to act; ``settings`` of the variant; ``target``: positions of points at the end that are to be reached,
    where the task has some."""

    times: np.ndarray
    points: Mapping[str, np.ndarray]
    folds: Mapping[str, float]
    acting: int
    settings: Mapping[str, Any]
    target: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Scored:
    """A reward and its derivatives by what it is made of, in the same shapes; what is left out counts as zero.
    ``holds``: whether what a success asks besides a high reward is so; ``sought`` by name: where observed points are to
    be at the end, in the base frame [m] ``(k, 3)``, to be drawn."""

    reward: float
    by_points: Mapping[str, np.ndarray]
    by_folds: Mapping[str, float]
    holds: bool = True
    sought: Mapping[str, np.ndarray] = field(default_factory=dict)


Reward = Callable[[Seen], Scored]


def instrumented(made: MadeTask, rig: Rig, own: bool = False) -> Rig:
    """The rig with the sensors of the task in place of its ``own``, or besides those and its cameras."""
    sensors: dict[str, Any] = {
        f"{POINTS}{name}": MarkerSensor(
            type="markers", body=seen.body, points=Points(positions_m=local_points(seen, rig)), topic=f"task/{name}"
        )
        for name, seen in made.task.points.items()
    }
    for hand in made.actions.hands.values():
        for finger in hand.fingers:
            sensors[f"{FORCE}{finger}"] = WrenchSensor(type="wrench", on=finger, topic=f"task/{finger}")
    kept = {"sensors": {**rig.sensors, **sensors}} if own else {"sensors": sensors, "cameras": {}}
    return rig.model_copy(update=kept)


def local_points(seen: ObservedPoints, rig: Rig) -> tuple[tuple[float, float, float], ...]:
    """Observed points in the rest coordinates of their body [m]."""
    if seen.grid is None:
        return ((0.0, 0.0, 0.0),)
    shape: Any = rig.bodies[seen.body].shape
    sizes = (shape.length_m, shape.width_m) if isinstance(shape, Rectangle) else shape.size_m
    stations = [
        np.linspace(-0.5 * size, 0.5 * size, n) if n > 1 else np.zeros(1)
        for n, size in zip(seen.grid, sizes, strict=True)
    ]
    points = np.stack(np.meshgrid(*stations, indexing="ij"), axis=-1).reshape(-1, len(stations))
    points = np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    if seen.row is not None:
        points = points[(points[:, 0] >= seen.row[0] - 1e-9) & (points[:, 0] <= seen.row[1] + 1e-9)]
    return tuple((float(x), float(y), float(z)) for x, y, z in points)


class Measure:
    """Reads what a reward is made of from the rollouts of a scene, and takes its derivatives back to them."""

    def __init__(self, made: MadeTask, scene: Scene, acting: int, target: Mapping[str, np.ndarray]) -> None:
        self._made, self._acting, self._target = made, acting, target
        self._frames = {}
        for name, seen in made.task.points.items():
            origin, rotation = scene.body_frame(seen.body, scene.start)
            self._frames[name] = origin, rotation.as_matrix()
        self._folds = {name: _FoldWeights(line, scene) for name, line in made.task.folds.items()}

    def seen(self, times: np.ndarray, outputs: Mapping[str, np.ndarray], memory: Mapping[str, Internals]) -> Seen:
        """Of the readings of a rollout and the internal variables at its end."""
        points = {
            name: origin + outputs[f"{POINTS}{name}"] @ rotation.T for name, (origin, rotation) in self._frames.items()
        }
        folds = {name: weights.angle(memory) for name, weights in self._folds.items()}
        return Seen(times, points, folds, self._acting, self._made.settings, self._target)

    def middle(self, name: str, reading: Mapping[str, np.ndarray]) -> np.ndarray:
        """Mean of observed points in the base frame [m] ``(3,)``."""
        origin, rotation = self._frames[name]
        return np.asarray(origin + rotation @ reading[f"{POINTS}{name}"].mean(axis=0))

    def back(self, scored: Scored) -> tuple[dict[str, np.ndarray], dict[str, dict[str, np.ndarray]]]:
        """Derivatives by readings, and by internal variables at the end, of a reward."""
        readings = {f"{POINTS}{name}": np.asarray(by) @ self._frames[name][1] for name, by in scored.by_points.items()}
        memory: dict[str, dict[str, np.ndarray]] = {}
        for name, by in scored.by_folds.items():
            weights = self._folds[name]
            there = memory.setdefault(weights.term, {})
            added = by * weights.weights
            there[weights.variable] = there[weights.variable] + added if weights.variable in there else added
        return readings, memory


class _FoldWeights:
    """``weights`` ``(m, 3)`` of the plastic curvature of a sheet's triangles in a fold angle."""

    variable = "plastic_curvature"

    def __init__(self, line: FoldLine, scene: Scene) -> None:
        body = scene.bodies[line.body]
        assert isinstance(body.spec, Sheet) and isinstance(body.layout, SheetMesh)
        self.term = f"{line.body}.bending"
        flat = body.layout.nodes[body.layout.triangles][..., 0]
        half = 0.5 * line.over_m
        shares = share_within(flat, line.at_m - half, line.at_m + half)
        width = float(np.ptp(body.layout.nodes[:, 1]))
        self.weights = np.zeros((len(flat), 3))
        self.weights[:, 0] = body.layout.areas * shares / width

    def angle(self, memory: Mapping[str, Internals]) -> float:
        """The fold angle [rad]."""
        return float((self.weights * memory[self.term][self.variable]).sum())


def share_within(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """Share of the area of triangles with corners at ``x`` ``(m, 3)`` along an axis that lies between two places."""
    return np.asarray(_share_below(x, high) - _share_below(x, low))


def _share_below(x: np.ndarray, place: float) -> np.ndarray:
    """Of the area: with corners a <= b <= c the width of the triangle grows linearly from a to b and falls to c."""
    a, b, c = np.sort(x, axis=1).T
    p = np.clip(place, a, c)
    rising = np.where(b > a, (np.minimum(p, b) - a) ** 2 / np.where(b > a, (b - a) * (c - a), 1.0), 0.0)
    left = np.where(c > b, (c - np.maximum(p, b)) ** 2 / np.where(c > b, (c - b) * (c - a), 1.0), 0.0)
    return np.asarray(np.where(p <= b, rising, 1.0 - left))
