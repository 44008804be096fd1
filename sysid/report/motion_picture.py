"""A picture of an experiment: its rig from the side at some instants, and what is commanded, against time."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from sim_core.geometry.sheets import SheetMesh
from sim_core.rigs import Rig
from sim_core.rigs.bodies import Affine, Rigid
from sim_core.rigs.motion import Experiment, compile_experiment
from sim_core.rigs.rigid_shapes import Box, Cylinder, Plane, Sphere
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.scene.assembly import BuiltBody
from sim_core.simulate import Simulation, step_times

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INSTANTS = 4
RADIAN_M = 0.05
"""Length that counts as much as a turn of 1 rad where instants are chosen."""

RC: dict[Any, Any] = {"svg.fonttype": "none", "svg.hashsalt": "thinshell", "font.size": 8.0, "axes.linewidth": 0.6}
STILL_M = 1e-7
"""Way between two samples below which nothing moves."""

STILL_SHARE = 0.05
"""Share of the time that a motion with holds is still; others only start and end slowly."""

APART_M = 1e-5
"""Way between two instants below which they show the same."""

ROUND = np.linspace(0.0, 2.0 * np.pi, 33)
SHEET, GEL, RIGID, PATHS = "#b5541c", "#4a90c2", "#9a9a9a", ("#3b7d3b", "#7a4fa3", "#b03060", "#00808a")
COMPONENTS = ("x", "y", "z"), ("about x", "about y", "about z")
STYLES = ("-", "--", ":")


@dataclass(frozen=True)
class Shape:
    """A body seen from the side: points x, z [m] ``(n, 2)``, rows of NaN between lines; ``filled``: it is an area."""

    kind: str
    points: np.ndarray
    filled: bool


def draw_experiment(rig: Rig, experiment: Experiment) -> str:
    """The picture as SVG text. Raises ``ThinshellError`` where the rig cannot follow the experiment."""
    import matplotlib
    from matplotlib.figure import Figure

    poses = compile_experiment(experiment, rig)
    moving = [name for name in poses if np.ptp(displacements(poses[name]), axis=0).any()]
    instants = telling_instants(poses)
    seen = _side_views(rig, poses, instants)
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(9.0, 3.6), dpi=72)
        grid = figure.add_gridspec(max(2, len(moving)), 4, left=0.06, right=0.945, bottom=0.13, top=0.9, wspace=0.35,
                                   hspace=0.45)  # fmt: skip
        views = figure.add_subplot(grid[:, :2])
        views.axis("off")
        _draw_views(figure.add_axes, seen, poses, moving, instants)
        rows = len(moving)
        for k, name in enumerate(moving):
            axes = figure.add_subplot(grid[:, 2:] if rows == 1 else grid[k, 2:])
            _draw_commands(axes, name, poses[name], instants)
            if k == rows - 1:
                axes.set_xlabel("time [s]")
        figure.suptitle(f"{experiment.name} on {rig.name}", fontsize=9.5, x=0.02, ha="left")
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", facecolor="white", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def displacements(trajectory: PoseTrajectory) -> np.ndarray:
    """Displacement [m] and turn [rad] (rotation vector) since the start, ``(n, 6)``."""
    turns = Rotation.from_quat(trajectory.quaternions)
    return np.hstack([trajectory.positions - trajectory.positions[0], (turns * turns[0].inv()).as_rotvec()])


def telling_instants(poses: Mapping[str, PoseTrajectory]) -> np.ndarray:
    """Instants [s] at which the commanded poses differ most from each other: the start, then always the farthest.

    They are taken from the middle of the times at which everything is still, if it is at times.
    """
    times = next(iter(poses.values())).times if poses else np.zeros(1)
    moved = [displacements(trajectory) * np.repeat([1.0, RADIAN_M], 3) for trajectory in poses.values()]
    where = np.hstack(moved) if moved else np.zeros((1, 6))
    step = np.linalg.norm(np.diff(where, axis=0, append=where[-1:]), axis=1)
    still = step < STILL_M
    if np.mean(still) < STILL_SHARE:
        still[:] = True
    stretch = np.cumsum(~still)
    chosen = [0]
    away = np.where(still, np.linalg.norm(where - where[0], axis=1), 0.0)
    while len(chosen) < INSTANTS and away.max() > APART_M:
        farthest = int(np.argmax(away))
        held = np.flatnonzero(still & (stretch == stretch[farthest])) if not still.all() else np.array([farthest])
        chosen.append(int(held[len(held) // 2]))
        away = np.minimum(away, np.linalg.norm(where - where[chosen[-1]], axis=1))
        away[held] = 0.0
    return np.asarray(times[sorted(chosen)])


def _side_views(rig: Rig, poses: Mapping[str, PoseTrajectory], instants: np.ndarray) -> list[list[Shape]]:
    """All bodies at the instants, from a simulation that ends at the last of them."""
    simulation = Simulation(build_scene(rig))
    last = float(instants[-1])
    ahead = step_times(0.0, last, rig.solver.dt_s) if last > 0.0 else np.zeros(1)
    times = np.unique(np.concatenate([ahead, instants]))
    frames = [
        {name: (p[k], Rotation.from_quat(q[k])) for name, (p, q) in _sampled(poses, times).items()}
        for k in range(len(times))
    ]
    simulation.reset(frames[0])
    found = []
    for k, now in enumerate(times):
        if k:
            simulation.step(frames[k], float(now - times[k - 1]))
        if now in instants:
            found.append(_shapes(simulation))
    return found


def _sampled(poses: Mapping[str, PoseTrajectory], times: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    return {name: trajectory.sample(times) for name, trajectory in poses.items()}


def _shapes(simulation: Simulation) -> list[Shape]:
    scene = simulation.scene
    found = []
    for name, body in scene.bodies.items():
        if isinstance(body.spec, Rigid):
            origin, rotation = scene.body_frame(name, simulation.frames)
            found.append(_solid(body.spec.shape, origin, rotation))
        elif isinstance(body.spec, Affine):
            origin, rotation = scene.pose_of(name, simulation.state.x)
            found.append(_solid(body.spec.shape, origin, rotation))
        else:
            found.append(_soft(body, simulation.state.x[body.nodes]))
    return found


def _soft(body: BuiltBody, x: np.ndarray) -> Shape:
    """A sheet as its border, a gel as its outline."""
    if not isinstance(body.mesh, SheetMesh):
        return Shape("gel", _hull(x), True)
    edges = np.sort(body.mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    border, count = np.unique(edges, axis=0, return_counts=True)
    lines = x[border[count == 1]][:, :, [0, 2]]
    gaps = np.full((len(lines), 1, 2), np.nan)
    return Shape("sheet", np.concatenate([lines, gaps], axis=1).reshape(-1, 2), False)


def _solid(shape: Sphere | Cylinder | Box | Plane, origin: np.ndarray, rotation: Rotation) -> Shape:
    if isinstance(shape, Plane):
        return Shape("plane", np.array([[-1.0, origin[2]], [1.0, origin[2]]]), False)
    if isinstance(shape, Sphere):
        local = shape.radius_m * np.stack([np.cos(ROUND), 0.0 * ROUND, np.sin(ROUND)], axis=1)
        return Shape("rigid", (origin + local)[:, [0, 2]], True)
    if isinstance(shape, Cylinder):
        ring = shape.radius_m * np.stack([np.cos(ROUND), np.sin(ROUND)], axis=1)
        ends = [np.column_stack([ring, np.full(len(ring), s * shape.length_m / 2)]) for s in (-1.0, 1.0)]
        local = np.vstack(ends)
    else:
        signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
        local = signs * np.array(shape.size_m)
    return Shape("rigid", _hull(origin + rotation.apply(local)), True)


def _hull(points: np.ndarray) -> np.ndarray:
    """Outline of points [m] ``(n, 3)`` from the side."""
    flat = points[:, [0, 2]]
    try:
        return np.asarray(flat[ConvexHull(flat).vertices])
    except QhullError:
        return flat


def _draw_views(
    add_axes: object,
    seen: list[list[Shape]],
    poses: Mapping[str, PoseTrajectory],
    moving: list[str],
    instants: np.ndarray,
) -> None:
    """Side views one below the other, in one scale."""
    assert callable(add_axes)
    solid = [s.points for shapes in seen for s in shapes if s.kind != "plane"]
    everything = np.vstack(solid + [poses[name].positions[:, [0, 2]] for name in moving])
    low, high = np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)
    margin = 0.04 * float(np.max(high - low))
    columns = 2 if (high - low)[1] > 0.25 * (high - low)[0] else 1
    rows = -(-len(seen) // columns)
    width, height = 0.47 / columns, 0.84 / rows
    for k, shapes in enumerate(seen):
        corner = (0.015 + width * (k % columns), 0.06 + height * (rows - 1 - k // columns))
        axes = add_axes((*corner, 0.94 * width, 0.8 * height))
        axes.set_aspect("equal")
        axes.set_xlim(low[0] - margin, high[0] + margin)
        axes.set_ylim(low[1] - margin, high[1] + margin)
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_title(f"{instants[k]:.2f} s", fontsize=8, loc="left", pad=2)
        for shape in shapes:
            _draw_shape(axes, shape)
        for colour, name in zip(PATHS, moving, strict=False):
            path = poses[name].positions[:, [0, 2]]
            axes.plot(*path.T, color=colour, linewidth=0.8)
            now = poses[name].sample(instants[k : k + 1])[0][0, [0, 2]]
            axes.plot(*now, "o", color=colour, markersize=3)
    bar = _round_length(0.3 * float(high[0] - low[0]))
    at = low[1] - 0.4 * margin
    axes.plot([low[0], low[0] + bar], [at, at], color="black", linewidth=1.5, solid_capstyle="butt")
    axes.set_xlabel(f"bar: {1e3 * bar:g} mm; seen along +y", fontsize=8, labelpad=2)


def _round_length(length: float) -> float:
    """1, 2 or 5 times a power of ten, at most ``length``."""
    power = 10.0 ** np.floor(np.log10(max(length, 1e-6)))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length))


def _draw_shape(axes: Axes, shape: Shape) -> None:
    colour = {"sheet": SHEET, "gel": GEL}.get(shape.kind, RIGID)
    if shape.filled:
        axes.fill(*shape.points.T, facecolor=colour, alpha=0.55, edgecolor=colour, linewidth=0.5)
    else:
        axes.plot(*shape.points.T, color=colour, linewidth=1.2)


def _draw_commands(axes: Axes, name: str, trajectory: PoseTrajectory, instants: np.ndarray) -> None:
    """Displacement and turn of one end effector since its start; what does not change is left out."""
    moved = displacements(trajectory) * np.repeat([1e3, np.rad2deg(1.0)], 3)
    turning = axes.twinx() if np.ptp(moved[:, 3:]) > 1e-6 else None
    for axis, columns, unit, offset in ((axes, COMPONENTS[0], "mm", 0), (turning, COMPONENTS[1], "deg", 3)):
        if axis is None:
            continue
        for k, component in enumerate(columns):
            values = moved[:, offset + k]
            if np.ptp(values) > 1e-6:
                keep = _corners(values)
                colour = "black" if unit == "mm" else RIGID
                axis.plot(trajectory.times[keep], values[keep], STYLES[k], color=colour, linewidth=1.0, label=component)
        axis.set_ylabel(f"{name} [{unit}]" if axis is axes else unit)
        axis.legend(loc="lower left" if axis is axes else "lower right", frameon=False, fontsize=7, ncols=3,
                    bbox_to_anchor=(0.0 if axis is axes else 1.0, 1.0), borderpad=0.0)  # fmt: skip
    for instant in instants:
        axes.axvline(instant, color=RIGID, linewidth=0.6, dashes=(2, 2))


def _corners(values: np.ndarray) -> np.ndarray:
    """Indices of samples that are not in the middle of a stretch at rest."""
    still = (np.abs(np.diff(values, prepend=np.nan)) < 1e-9) & (np.abs(np.diff(values, append=np.nan)) < 1e-9)
    return np.flatnonzero(~still)
