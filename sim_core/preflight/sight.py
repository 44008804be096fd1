"""Cameras that see nothing, markers that leave the picture, markers on a side that cannot be seen."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.postprocess import Layout, surfaces
from sim_core.preflight.distance import signed_distance
from sim_core.preflight.finding import Finding
from sim_core.rigs import Affine, Gel, OrthographicCamera, Rigid, marker_positions
from sim_core.rigs.observers import Camera, Points
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Frame
from sim_core.sensing.camera import project
from sim_core.sensing.observe import Tracked

STEPS = 200
"""Points along each line of sight at which it is looked whether a rigid body is in the way."""

INSTANTS = 40
"""Instants of a motion at which cameras are looked at."""

SUNK_M = 2e-5
"""How deep in a body a marker on its surface may seem to lie: facets are not quite what they stand for."""


def sight_findings(layout: Layout, poses: Mapping[str, PoseTrajectory] | None) -> list[Finding]:
    """Findings of all cameras, at the start and along the motion where markers are on gels that mounts carry."""
    found = []
    for name, camera in layout.rig.cameras.items():
        for sight in camera.sees:
            points, x0 = _points(layout, sight.body, sight.points), layout.rest
            if points is None:
                continue
            world = points.positions(x0)
            here = _seen_at(layout, name, camera, sight.body, world, layout.start)
            found += here
            if not here and poses is not None and isinstance(layout.rig.bodies[sight.body], Gel):
                found += _leaving(layout, name, camera, sight.body, points, poses)
            found += _hidden(layout, name, camera, sight.body, world) if not here else []
            found += _glued(layout, name, sight.body, sight.points)
    return found


def _points(layout: Layout, body: str, points: Points) -> Tracked | None:
    spec = layout.rig.bodies[body]
    if isinstance(spec, Rigid):
        return None
    return layout.tracked(body, marker_positions(points, spec)[0])


def _optic(layout: Layout, camera: Camera, world: np.ndarray, frames: Mapping[str, Frame]) -> np.ndarray:
    origin, rotation = layout.camera_frame(camera, frames)
    return np.asarray(rotation.inv().apply(world - origin))


def out_of_picture(camera: Camera, optic: np.ndarray) -> np.ndarray:
    """Which points in the optical frame [m] ``(n, 3)`` are out of the picture, bool ``(n,)``."""
    if isinstance(camera, OrthographicCamera):
        return np.zeros(len(optic), dtype=bool)  # of a picture whose crop is not known
    return np.asarray(np.isnan(project(camera, optic)).any(axis=1))


def _sideways(point: np.ndarray) -> str:
    """How far a point in the optical frame [m] ``(3,)`` is off the axis, in words."""
    named = ((point[0], "right", "left"), (point[1], "down", "up"))
    least = 0.01 * float(np.linalg.norm(point))
    return " and ".join(f"{1e3 * abs(v):.3g} mm {a if v > 0.0 else b}" for v, a, b in named if abs(v) > least)


def _seen_at(
    layout: Layout, name: str, camera: Camera, body: str, world: np.ndarray, frames: Mapping[str, Frame]
) -> list[Finding]:
    optic = _optic(layout, camera, world, frames)
    lost = out_of_picture(camera, optic)
    if not lost.any():
        return []
    behind = int((optic[:, 2] <= 0.0).sum())
    if lost.all():
        if behind == len(optic):
            where = (
                f"they are behind it, {1e3 * float(-optic[:, 2].mean()):.3g} mm against its viewing direction (z of "
                "its optical frame points out of the lens)"
            )
        else:
            mean = optic[optic[:, 2] > 0.0].mean(axis=0)
            off = np.rad2deg(np.arctan2(np.linalg.norm(mean[:2]), mean[2]))
            half = np.rad2deg(np.arctan2(0.5 * camera.width_px, camera.fx_px))  # type: ignore[union-attr]
            where = (
                f"they are {off:.0f} deg off its axis, and its picture reaches {half:.0f} deg to each side "
                f"({_sideways(mean)} at {1e3 * mean[2]:.3g} mm distance)"
            )
        return [
            Finding(
                "camera blind",
                f"The camera {name} sees none of its {len(optic)} markers on {body}: {where}.",
                f"Turn or move it (cameras.{name}.pose, in the frame of {camera.mount}).",
            )
        ]
    return [
        Finding(
            "markers outside",
            f"{int(lost.sum())} of the {len(optic)} markers on {body} are outside of the picture "
            f"of the camera {name} at the start.",
            "Move it away, reduce its focal length, or take these markers out of 'sees'.",
        )
    ]


def _leaving(
    layout: Layout,
    name: str,
    camera: Camera,
    body: str,
    points: Tracked,
    poses: Mapping[str, PoseTrajectory],
) -> list[Finding]:
    """Markers of a gel that leave the picture because the hand moves. Where the gel follows the camera none do."""
    if camera.mount == layout.mount_of(body):
        return []
    end = max((p.times[-1] for p in poses.values()), default=0.0)
    times = np.linspace(0.0, end, INSTANTS)
    worst, when = 0, 0.0
    for t, frames in zip(times, layout.frames_along(poses, times), strict=True):
        lost = int(
            out_of_picture(camera, _optic(layout, camera, points.positions(layout.carried(frames)), frames)).sum()
        )
        if lost > worst:
            worst, when = lost, float(t)
    if not worst:
        return []
    return [
        Finding(
            "markers outside",
            f"{worst} of the {len(points.nodes)} markers on {body} leave the picture of the camera "
            f"{name} in this motion (at {when:.2f} s).",
            "Move the camera away, reduce its focal length, or move less.",
        )
    ]


def _hidden(layout: Layout, name: str, camera: Camera, body: str, world: np.ndarray) -> list[Finding]:
    """Markers that a rigid body stands before, and markers on the far side of a gel or an affine body for a camera that
    is outside of it. Gels are looked through by cameras on the same mount, as those of tactile sensors."""
    origin, rotation = layout.camera_frame(camera, layout.start)
    back = rotation.apply([0.0, 0.0, -1.0])
    parallel = isinstance(camera, OrthographicCamera)
    eyes = world + back if parallel else np.broadcast_to(origin, world.shape)
    blocked: dict[str, np.ndarray] = {}
    shares = np.linspace(0.0, 1.0, STEPS, endpoint=False)[:, None, None]
    rays = world + (eyes - world) * (1.0 - shares)
    for other, spec in layout.rig.bodies.items():
        if isinstance(spec, Rigid):
            place, turn = layout.body_frame(other, layout.start)
            depth = signed_distance(spec, turn.inv().apply((rays - place).reshape(-1, 3))).reshape(STEPS, -1)
            blocked[other] = np.asarray((depth < -SUNK_M).any(axis=0))
    spec = layout.rig.bodies[body]
    if isinstance(spec, Affine) or (isinstance(spec, Gel) and camera.mount != layout.mount_of(body)):
        blocked[body] = _far_side(layout, body, world, eyes)
    found = []
    for other, hidden in blocked.items():
        if hidden.any():
            what = f"{other} stands before them" if other != body else f"they are on the far side of {body}"
            of = f"any of its {len(world)}" if hidden.all() else f"{int(hidden.sum())} of its {len(world)}"
            found.append(
                Finding(
                    "markers hidden",
                    f"The camera {name} cannot see {of} markers on {body} at the start: {what}.",
                    "Move the camera or the markers, or take them out of 'sees'.",
                )
            )
    return found


def _far_side(layout: Layout, body: str, world: np.ndarray, eyes: np.ndarray) -> np.ndarray:
    """Which points on a closed surface ``(n, 3)`` face away from where they are looked at from, by the triangle that
    each is nearest to the centre of, bool ``(n,)``."""
    skin = next(s for s in surfaces(layout) if s.body == body)
    corner = skin.vertices(layout, layout.rest, layout.start)[skin.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    facing = []
    for point, eye in zip(world, eyes, strict=True):
        off = np.abs(np.einsum("ti,ti->t", point - corner[:, 0], normal))
        near = np.linalg.norm(corner - point, axis=2).min(axis=1)
        on = near <= near.min() + 1e-9
        plane = on & (off <= off[on].min() + SUNK_M)
        facing.append(float((normal[plane] @ (eye - point)).max()) <= 0.0)
    return np.array(facing)


def _glued(layout: Layout, name: str, body: str, points: Points) -> list[Finding]:
    """Markers on the face of a gel that is glued to its mount."""
    spec = layout.rig.bodies[body]
    if not isinstance(spec, Gel) or spec.bonded is None or points.face != spec.bonded:
        return []
    return [
        Finding(
            "markers hidden",
            f"The camera {name} follows markers on the face {points.face!r} of {body}, which is glued "
            f"to {spec.mount}: they never move against it.",
            "Put the markers on a free face.",
        )
    ]
