"""A subject at one instant as triangles, lines and points for the renderer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sim_core.errors import ThinshellError
from sim_core.postprocess import Surface
from sim_core.preflight.distance import sampled
from sim_core.rigs import OrthographicCamera, Rigid
from sim_core.rigs.observers import Camera
from sim_core.scene.assembly import held_nodes
from sim_core.scene.scene import Frame
from sysid.show.colouring import Colouring
from sysid.show.raster import Skin, View
from sysid.show.style import BOND, CLAMP, GEL_ALPHA, PAPER_TOP, body_colours, by_value, colour_table, rgb
from sysid.show.subject import Subject

PLANE_CELLS = 24
"""Squares along each side of what stands for a plane."""

GHOST = 0.30
"""Opacity of rigid bodies where others are coloured by a quantity that they may hide."""


def held_vertices(subject: Subject) -> dict[str, np.ndarray]:
    """Which vertices of each deformable body a clamp holds, bool ``(v,)``; bonds are in the surfaces themselves."""
    found = {}
    for skin in subject.skins:
        body = subject.layout.bodies[skin.body]
        if skin.kind not in ("sheet", "gel") or skin.nodes is None:
            continue
        inside = np.zeros(len(body.nodes), dtype=bool)
        try:
            for label, holder in held_nodes(subject.rig, body).items():
                if not label.endswith((".bond", "_cut")):
                    inside |= holder.inside
        except ThinshellError:  # a clamp that holds nothing is reported elsewhere
            pass
        found[skin.body] = inside[skin.nodes - body.nodes[0]]
    return found


class Scenery:
    """Surfaces of a subject, coloured by body or by a quantity. ``colours``: of bodies."""

    def __init__(self, subject: Subject, coloured: Colouring | None) -> None:
        self.subject, self.coloured = subject, coloured
        self.colours = body_colours(subject.skins)
        self._held = held_vertices(subject)

    def swatch(self, surface: Surface) -> np.ndarray:
        """What a legend shows for a body, RGB ``(n, 3)`` from left to right: the colour in which it is drawn on paper,
        or the scale of the quantity."""
        if self.coloured is not None and surface.nodes is not None:
            return colour_table()
        alpha = {"gel": GEL_ALPHA}.get(surface.kind, 1.0)
        if self.coloured is not None and surface.kind == "rigid":
            alpha = GHOST
        return np.asarray(alpha * rgb(self.colours[surface.body]) + (1.0 - alpha) * rgb(PAPER_TOP))[None]

    def skins(self, step: int, camera: str | None = None) -> list[Skin]:
        """What is drawn at one instant; for the eye of a camera without the faces that it looks through."""
        subject = self.subject
        x, frames = subject.states.positions[step], subject.frames[step]
        through = None if camera is None else subject.rig.cameras[camera].mount
        found = []
        for surface in subject.skins:
            vertices = surface.vertices(subject.layout, x, frames)
            triangles, alpha, lines = surface.triangles, 1.0, 0.0
            colours = np.repeat(rgb(self.colours[surface.body])[None], len(vertices), axis=0)
            if surface.kind == "plane":
                found.append(_plane(vertices, colours[0]))
                continue
            if surface.kind in ("sheet", "gel"):
                lines = 0.22
            if self.coloured is not None and surface.nodes is not None:
                colours = by_value(self.coloured.values[surface.body][step], self.coloured.top)
                lines = 0.12
            elif surface.body in self._held:
                colours[self._held[surface.body]] = rgb(CLAMP)
            if surface.kind == "gel":
                alpha = GEL_ALPHA if self.coloured is None else 0.88
                if camera is not None and subject.layout.mount_of(surface.body) == through != "world":
                    triangles, alpha = triangles[~surface.bonded], 0.999
                elif self.coloured is None and surface.bonded.any():
                    glued = np.unique(triangles[surface.bonded])
                    colours[glued] = 0.45 * colours[glued] + 0.55 * rgb(BOND)
            if self.coloured is not None and surface.kind in ("rigid", "affine") and camera is None:
                alpha = GHOST if surface.kind == "rigid" else alpha
            closed = surface.kind != "sheet" and camera is None  # a camera may be within a body
            found.append(Skin(vertices, triangles, colours, alpha, lines, closed=closed))
        return found


def _plane(corners: np.ndarray, colour: np.ndarray) -> Skin:
    """A chequered square."""
    origin, u, v = corners[0], corners[1] - corners[0], corners[3] - corners[0]
    steps = np.arange(PLANE_CELLS)
    i, j = (a.ravel() for a in np.meshgrid(steps, steps, indexing="ij"))
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    place = (np.stack([i, j], axis=1)[:, None] + square) / PLANE_CELLS
    vertices = (origin + place[..., :1] * u + place[..., 1:] * v).reshape(-1, 3)
    dark = 1.0 - 0.045 * ((i + j) % 2)
    colours = np.repeat(dark[:, None] * colour, 4, axis=0)
    base = 4 * np.arange(len(i))[:, None]
    return Skin(vertices, np.vstack([base + [0, 1, 2], base + [0, 2, 3]]), colours, 1.0, 0.0, 0.2)


def camera_view(camera: Camera, frame: Frame, width: int, shift: np.ndarray | tuple[float, float] = (0.0, 0.0)) -> View:
    """The view through a camera, without its distortion, on a picture so many pixels wide, all moved by ``shift`` [px]
    of the camera's."""
    origin, rotation = frame
    axes = rotation.as_matrix().T
    size = (camera.width_px, camera.height_px)
    scale = width / camera.width_px
    centre = (camera.cx_px + float(shift[0]), camera.cy_px + float(shift[1]))
    if isinstance(camera, OrthographicCamera):
        focal = 1.0 / camera.scale_m_per_px
        view = View(origin - 10.0 * axes[2], axes, (focal, focal), centre, size, parallel=True)
    else:
        view = View(origin, axes, (camera.fx_px, camera.fy_px), centre, size)
    return view.scaled(scale)


def cone(camera: Camera, frame: Frame, length: float) -> np.ndarray:
    """Lines [m] ``(k, 2, 3)`` from a camera's eye to the corners of its picture ``length`` away, and between these; the
    frame of the picture alone for a parallel projection."""
    origin, rotation = frame
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * [camera.width_px, camera.height_px]
    corners = corners - [camera.cx_px, camera.cy_px]
    if isinstance(camera, OrthographicCamera):
        far = np.column_stack([corners * camera.scale_m_per_px, np.zeros(4)])
        rays = np.empty((0, 2, 3))
    else:
        far = np.column_stack([corners / [camera.fx_px, camera.fy_px], np.ones(4)]) * length
        rays = np.stack([np.zeros((4, 3)), far], axis=1)
    around = np.stack([far, np.roll(far, -1, axis=0)], axis=1)
    upper = 0.5 * (far[0] + far[1])
    mark = np.stack([np.stack([far[0], upper * [1, 1.18, 1]]), np.stack([upper * [1, 1.18, 1], far[1]])])
    local = np.concatenate([rays, around, mark])
    return np.asarray(origin + rotation.apply(local.reshape(-1, 3)).reshape(-1, 2, 3))


def sight(subject: Subject, camera: str, step: int) -> float:
    """Distance [m] along a camera's axis at which its points are."""
    origin, rotation = subject.layout.camera_frame(subject.rig.cameras[camera], subject.frames[step])
    points = subject.tracks[camera].positions(subject.states.positions[step])
    return max(float(((points - origin) @ rotation.apply([0.0, 0.0, 1.0])).mean()), 1e-3)


@dataclass(frozen=True)
class Nearest:
    """The nearest two points [m] of a declared pair, their distance [m] and how hard the pair is pressed [N]."""

    pair: str
    points: np.ndarray
    distance: float
    force: float

    @property
    def words(self) -> str:
        """The force where there is one, else the distance."""
        return f"{self.force:.3g} N" if self.force > 1e-6 else f"{1e3 * self.distance:.2g} mm"


def nearest_points(subject: Subject, step: int) -> list[Nearest]:
    """Of each declared pair of bodies; of two points on meshes."""
    x, frames = subject.states.positions[step], subject.frames[step]
    clouds = {}
    for skin in subject.skins:
        vertices = skin.vertices(subject.layout, x, frames)
        spacing = max(float(np.ptp(vertices, axis=0).max()) / 60.0, 1e-6)
        clouds[skin.body] = sampled(vertices, skin.triangles, spacing)
    found = []
    for contact in subject.rig.contacts:
        one, other = contact.between
        if one == other:
            continue
        a, b = clouds[one], clouds[other]
        distance, index = cKDTree(b).query(a)
        k = int(np.argmin(distance))
        points = np.stack([a[k], b[int(index[k])]])
        for flat, first in ((one, 1), (other, 0)):
            spec = subject.rig.bodies[flat]
            if isinstance(spec, Rigid) and spec.shape.type == "plane":
                points = _onto_plane(subject.layout.body_frame(flat, frames), clouds[contact.between[first]])
                if flat == one:
                    points = points[::-1]
        force = subject.states.pair_forces.get(contact.name)
        found.append(
            Nearest(
                contact.name,
                points,
                float(np.linalg.norm(points[0] - points[1])),
                0.0 if force is None else _pressed(subject, one, force[step]),
            )
        )
    return found


def _onto_plane(frame: Frame, points: np.ndarray) -> np.ndarray:
    """The lowest of some points over a plane, and the point below it."""
    origin, rotation = frame
    normal = rotation.apply([0.0, 0.0, 1.0])
    height = (points - origin) @ normal
    k = int(np.argmin(height))
    return np.stack([points[k], points[k] - height[k] * normal])


def _pressed(subject: Subject, body: str, force: np.ndarray) -> float:
    nodes = subject.layout.bodies[body].nodes
    return float(np.linalg.norm(force[nodes].sum(axis=0)))


def triads(frames: Mapping[str, Frame], length: float) -> dict[str, np.ndarray]:
    """Axes of frames as lines [m] ``(3, 2, 3)`` by name."""
    return {
        name: np.stack([np.stack([origin, origin + length * axis]) for axis in rotation.as_matrix().T])
        for name, (origin, rotation) in frames.items()
    }
