"""What a subject shows as nodes of a viser scene, at one instant at a time.

Viser has no meshes with a colour of each vertex but those in files, which a browser parses for some milliseconds in
which nothing is drawn. So a body whose colours or shape change has a node for each of its states, all sent at once, of
which one is visible; a rigid one has one node, whose vertices move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sysid.show.colouring import Colouring
from sysid.show.glb import binary_gltf
from sysid.show.raster import Skin
from sysid.show.scenery import Scenery, cone, nearest_points, sight
from sysid.show.style import CAMERA, CLAMP, MARKER, rgb
from sysid.show.subject import Marks, Subject
from sysid.show.viewpoint import framed

if TYPE_CHECKING:
    import viser

AXIS, AXIS_RADIUS, CAMERA_CONE, POINT = 0.10, 0.003, 0.08, 0.012
"""Lengths as shares of the extent of what is simulated."""

LINE_PX = 1.6
"""Thickness of lines on the screen."""

FAINT = 0.55
"""How far the lines of sight of a camera are from its colour to white."""

Colour = tuple[int, int, int]


class LiveScene:
    """Nodes of a subject. ``bodies``: of each body that deforms, its node in each state; ``rigid``: node of each rigid
    body; ``points``, ``frames``, ``cameras`` and ``pairs``: nodes by name."""

    def __init__(self, api: viser.SceneApi, subject: Subject, coloured: Colouring | None, step: int) -> None:
        self.bodies: dict[str, list[viser.GlbHandle]] = {}
        self.rigid: dict[str, viser.MeshHandle] = {}
        self.points: dict[str, viser.PointCloudHandle] = {}
        self.frames: dict[str, viser.FrameHandle] = {}
        self.cameras: dict[str, viser.LineSegmentsHandle] = {}
        self.pairs: dict[str, viser.LineSegmentsHandle] = {}
        self._labels: dict[str, viser.LabelHandle] = {}
        self._api, self._subject, self._step = api, subject, step
        self._extent = float(np.ptp(framed(subject), axis=0).max())
        self._add_marks()
        self._add_frames()
        self._add_cameras()
        self._add_pairs()
        self.colour(coloured)

    def colour(self, coloured: Colouring | None) -> None:
        """Colour all bodies by a quantity, or each in its own colour."""
        scenery = Scenery(self._subject, coloured)
        states = [scenery.skins(k) for k in range(len(self._subject.times))]
        for i, surface in enumerate(self._subject.skins):
            skins = [state[i] for state in states]
            if surface.kind == "rigid":
                self._add_rigid(surface.body, skins[self._step])
            else:
                self._add_states(surface.body, skins)

    def show(self, step: int) -> None:
        """Show the state at one instant."""
        subject, before, self._step = self._subject, self._step, step
        x, frames = subject.states.positions[step], subject.frames[step]
        for nodes in self.bodies.values():
            nodes[before].visible = False
            nodes[step].visible = True
        for surface in subject.skins:
            if surface.body in self.rigid:
                self.rigid[surface.body].vertices = _float32(surface.vertices(subject.layout, x, frames))
        for name, marks in self._marks().items():
            self.points[name].points = _float32(marks.positions(x))
        for name, (origin, rotation) in frames.items():
            self.frames[name].position = origin
            self.frames[name].wxyz = rotation.as_quat()[[3, 0, 1, 2]]
        for name, node in self.cameras.items():
            node.points = _float32(self._camera_lines(name))
            self._labels[f"/cameras/{name}"].position = self._eye(name)
        for near in nearest_points(subject, step):
            self.pairs[near.pair].points = _float32(near.points[None])
            label = self._labels[f"/contacts/{near.pair}"]
            label.position, label.text = near.points.mean(axis=0), f"{near.pair}: {near.words}"

    def _add_states(self, body: str, skins: list[Skin]) -> None:
        """A node for each state that is another than those before it."""
        for old in {node.name: node for node in self.bodies.get(body, [])}.values():
            old.remove()
        known: dict[bytes, viser.GlbHandle] = {}
        nodes = []
        for k, skin in enumerate(skins):
            data = binary_gltf(skin)
            if data not in known:
                known[data] = self._api.add_glb(f"/bodies/{body}/{k}", data, visible=False)
            nodes.append(known[data])
        nodes[self._step].visible = True
        self.bodies[body] = nodes

    def _add_rigid(self, body: str, skin: Skin) -> None:
        self.rigid[body] = self._api.add_mesh_simple(
            f"/bodies/{body}", _float32(skin.vertices), skin.triangles, color=_byte(skin.colours[0]),
            opacity=skin.alpha if skin.alpha < 1.0 else None, flat_shading=self._sharp(body), side="double",
        )  # fmt: skip

    def _sharp(self, body: str) -> bool:
        return self._subject.rig.bodies[body].shape.type == "box"

    def _marks(self) -> dict[str, Marks]:
        return {**self._subject.markers, **self._subject.tracks}

    def _add_marks(self) -> None:
        x = self._subject.states.positions[self._step]
        for name, marks in self._marks().items():
            self.points[name] = self._api.add_point_cloud(
                f"/markers/{name}", _float32(marks.positions(x)), _byte(rgb(MARKER)), point_size=POINT * self._extent,
                point_shape="circle", point_shading="flat", precision="float32",
            )  # fmt: skip

    def _add_frames(self) -> None:
        for name, (origin, rotation) in self._subject.frames[self._step].items():
            self.frames[name] = self._api.add_frame(
                f"/frames/{name}", axes_length=AXIS * self._extent, axes_radius=AXIS_RADIUS * self._extent,
                position=origin, wxyz=rotation.as_quat()[[3, 0, 1, 2]],
            )  # fmt: skip
            self._api.add_label(f"/frames/{name}/name", name)

    def _camera_lines(self, name: str) -> np.ndarray:
        """The cone of a camera, and its lines of sight as far as its points are [m] ``(n, 2, 3)``."""
        subject, camera = self._subject, self._subject.rig.cameras[name]
        frame = subject.layout.camera_frame(camera, subject.frames[self._step])
        reaches = (CAMERA_CONE * self._extent, sight(subject, name, self._step))
        return np.concatenate([cone(camera, frame, reach) for reach in reaches])

    def _add_cameras(self) -> None:
        for name in self._subject.rig.cameras:
            lines = self._camera_lines(name)
            colours = np.repeat(rgb(CAMERA)[None], 2 * len(lines), axis=0).reshape(lines.shape)
            colours[len(lines) // 2 :] += FAINT * (1.0 - colours[len(lines) // 2 :])
            self.cameras[name] = self._api.add_line_segments(
                f"/cameras/{name}", _float32(lines), colours, thickness=LINE_PX, thickness_units="screen"
            )
            self._label(f"/cameras/{name}", name, self._eye(name))

    def _add_pairs(self) -> None:
        for near in nearest_points(self._subject, self._step):
            self.pairs[near.pair] = self._api.add_line_segments(
                f"/contacts/{near.pair}", _float32(near.points[None]), _byte(rgb(CLAMP)), thickness=LINE_PX,
                thickness_units="screen",
            )  # fmt: skip
            self._label(f"/contacts/{near.pair}", f"{near.pair}: {near.words}", near.points.mean(axis=0))

    def _eye(self, camera: str) -> np.ndarray:
        frames = self._subject.frames[self._step]
        return self._subject.layout.camera_frame(self._subject.rig.cameras[camera], frames)[0]

    def _label(self, node: str, text: str, at: np.ndarray) -> None:
        self._labels[node] = self._api.add_label(f"{node}/name", text, position=at)


def _float32(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, dtype=np.float32)


def _byte(colour: np.ndarray) -> Colour:
    red, green, blue = (255.0 * colour).round().astype(int).tolist()
    return red, green, blue
