"""All that the page shows, as numbers that a browser unpacks: a deflated block of integers and a table of contents."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np

from sim_core.rigs import OrthographicCamera
from sim_core.rigs.bodies import WORLD
from sysid.show.colouring import Colouring
from sysid.show.scenery import held_vertices, nearest_points
from sysid.show.style import body_colours, colour_table
from sysid.show.subject import Subject
from sysid.show.viewpoint import direction, framed
from sysid.show.words import body_words, contact_words, sensor_words

STEPS = 30000
"""Steps of the integers that stand for coordinates, from the middle to either end."""

LARGEST_BYTES = 4_200_000
"""Of the packed block in text form; a subject with more is shown with every second state, and so on."""


class _Block:
    """Arrays one after the other; what is added is addressed by offset, count and type."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def add(self, values: np.ndarray) -> dict[str, Any]:
        """Keep an array of uint8, int16 or uint16; the entry that finds it again."""
        data = np.ascontiguousarray(values)
        raw = data.tobytes()
        entry = {"at": self._size, "count": int(data.size), "type": data.dtype.name}
        padding = -len(raw) % 4
        self._parts.append(raw + bytes(padding))
        self._size += len(raw) + padding
        return entry

    def text(self) -> str:
        """All of it, deflated, in base 64."""
        return base64.b64encode(zlib.compress(b"".join(self._parts), 9)).decode()


def payload(subject: Subject, coloured: dict[str, Colouring]) -> tuple[dict[str, Any], str]:
    """Table of contents and block, with as many states as fit."""
    stride = 1
    while True:
        steps = np.unique(np.append(np.arange(0, len(subject.times), stride), len(subject.times) - 1))
        head, block = _packed(subject, coloured, steps)
        if len(block) < LARGEST_BYTES or len(steps) <= 2:
            return head, block
        stride *= 2


def _packed(subject: Subject, coloured: dict[str, Colouring], steps: np.ndarray) -> tuple[dict[str, Any], str]:
    block = _Block()
    points = framed(subject)
    towards, up = direction(subject, points)
    low, high = points.min(axis=0), points.max(axis=0)
    vertices = {
        s.body: np.stack([s.vertices(subject.layout, subject.states.positions[k], subject.frames[k]) for k in steps])
        for s in subject.skins
    }
    everything = np.vstack([*(v.reshape(-1, 3) for v in vertices.values()), *subject.sought.values()])
    centre = 0.5 * (everything.min(axis=0) + everything.max(axis=0))
    unit = float(np.abs(everything - centre).max()) / STEPS

    def coordinates(values: np.ndarray) -> dict[str, Any]:
        """Coordinates ``(n, k, 3)`` as whole units from the centre, states after the first as differences."""
        whole = np.clip(np.round((values - centre) / unit), -32767, 32767).astype(np.int64)
        if len(whole) > 1 and not np.ptp(whole, axis=0).any():
            whole = whole[:1]
        return {**block.add(np.diff(whole, axis=0, prepend=0).astype(np.int16)), "states": len(whole)}

    held, colours = held_vertices(subject), body_colours(subject.skins)
    bodies = []
    for skin in subject.skins:
        flags = np.zeros(len(skin.local), dtype=np.uint8)
        flags[np.unique(skin.triangles[skin.bonded])] |= 1
        if skin.body in held:
            flags[held[skin.body]] |= 2
        bodies.append(
            {
                "name": skin.body, "kind": skin.kind, "colour": colours[skin.body],
                "words": body_words(subject.rig, skin.body), "mount": subject.layout.mount_of(skin.body),
                "sharp": subject.rig.bodies[skin.body].shape.type in ("box", "block", "plane"),
                "triangles": block.add(skin.triangles.astype(np.uint16)), "flags": block.add(flags),
                "bonded": block.add(skin.bonded.astype(np.uint8)),
                "positions": coordinates(vertices[skin.body]),
                "values": {
                    name: block.add(_shares(c, skin.body, steps))
                    for name, c in coloured.items() if not np.isnan(c.values[skin.body]).all()
                },
            }
        )  # fmt: skip
    head = {
        "title": subject.title, "first": "" if subject.what == "rig" else next(iter(coloured), ""),
        "what": subject.what, "description": subject.rig.description,
        "times": [round(float(t), 5) for t in subject.times[steps]], "up": up.tolist(), "towards": towards.tolist(),
        "centre": centre.tolist(), "unit": unit, "low": low.tolist(), "high": high.tolist(), "bodies": bodies,
        "quantities": {n: {"unit": c.unit, "top": c.top, "words": c.words} for n, c in coloured.items()},
        "colours": (255.0 * colour_table()[::4]).round().astype(int).ravel().tolist(),
        "mounts": {m: _poses(subject, m, steps) for m in subject.frames[0]},
        "markers": {
            n: {**coordinates(_at(m, subject, steps)), "residual": _residual(subject, n, steps)}
            for n, m in subject.markers.items()
        },
        "sought": {n: coordinates(points[None]) for n, points in subject.sought.items()},
        "cameras": {n: _camera(subject, n, steps, coordinates) for n in subject.rig.cameras},
        "pairs": _pairs(subject, steps),
        "wrenches": _wrenches(subject, steps),
        "facts": [*(f"contact {c}" for c in contact_words(subject.rig)), *sensor_words(subject.rig)],
        "findings": [f.text for f in subject.findings],
        "world": WORLD,
    }  # fmt: skip
    return head, block.text()


def _shares(coloured: Colouring, body: str, steps: np.ndarray) -> np.ndarray:
    """Values as shares of the end of the scale, 0 to 254; 255 where there is none."""
    values = coloured.values[body][steps]
    shares = np.clip(np.nan_to_num(values) / coloured.top, 0.0, 1.0)
    return np.where(np.isnan(values), 255, (254.0 * shares).round()).astype(np.uint8)


def _at(marks: Any, subject: Subject, steps: np.ndarray) -> np.ndarray:
    return np.stack([marks.positions(subject.states.positions[k]) for k in steps])


def _poses(subject: Subject, mount: str, steps: np.ndarray) -> list[list[float]]:
    """Origin [m] and the three axes of a mount, one after the other; of one state where it rests."""
    found = [[*subject.frames[k][mount][0], *subject.frames[k][mount][1].as_matrix().T.ravel()] for k in steps]
    return _rounded(found)


def _rounded(values: list[list[float]]) -> list[list[float]]:
    rows: list[list[float]] = np.round(np.array(values, dtype=float), 6).tolist()
    return rows[:1] if all(r == rows[0] for r in rows) else rows


def _residual(subject: Subject, channel: str, steps: np.ndarray) -> list[list[float | None]] | None:
    """Distance [mm] of markers from where they were measured, in the sensor's frame."""
    measured = subject.markers[channel].measured
    if measured is None:
        return None
    predicted = subject.predicted_markers(channel, steps)
    return _nullable(1e3 * np.linalg.norm(measured[steps] - predicted, axis=2), 4)


def _nullable(values: np.ndarray, digits: int) -> list[Any]:
    found: list[Any] = [None if np.isnan(v) else float(v) for v in np.round(values, digits).ravel()]
    return np.array(found, dtype=object).reshape(values.shape).tolist()  # type: ignore[no-any-return]


def _camera(subject: Subject, name: str, steps: np.ndarray, coordinates: Any) -> dict[str, Any]:
    camera, marks, shift = subject.rig.cameras[name], subject.tracks[name], subject.picture_shift(name)
    poses = []
    for k in steps:
        origin, rotation = subject.layout.camera_frame(camera, subject.frames[k])
        poses.append([*origin, *rotation.as_matrix().T.ravel()])
    points = _at(marks, subject, steps)
    found = {
        "width": camera.width_px, "height": camera.height_px,
        "cx": camera.cx_px + float(shift[0]), "cy": camera.cy_px + float(shift[1]),
        "mount": camera.mount, "poses": _rounded(poses), "points": coordinates(points),
        "pixels": _nullable(np.stack([subject.pixels(name, k) + shift for k in steps]), 2),
        "measured": None if marks.measured is None else _nullable(marks.measured[steps] + shift, 2),
        "parallel": isinstance(camera, OrthographicCamera),
    }  # fmt: skip
    if isinstance(camera, OrthographicCamera):
        found["fx"] = found["fy"] = 1.0 / camera.scale_m_per_px
    else:
        found["fx"], found["fy"] = camera.fx_px, camera.fy_px
    return found


def _pairs(subject: Subject, steps: np.ndarray) -> list[dict[str, Any]]:
    """Of each declared pair: the nearest points [m], their distance [mm] and the force [N] at each state."""
    by_step = [{n.pair: n for n in nearest_points(subject, k)} for k in steps]
    return [
        {
            "pair": pair,
            "points": _rounded([b[pair].points.ravel().tolist() for b in by_step]),
            "distance": [float(f"{1e3 * b[pair].distance:.3g}") for b in by_step],
            "force": [float(f"{b[pair].force:.3g}") for b in by_step],
        }
        for pair in by_step[0]
    ]


def _wrenches(subject: Subject, steps: np.ndarray) -> dict[str, Any]:
    found = {}
    for name, values in subject.wrenches.items():
        measured = subject.measured_wrenches.get(name)
        found[name] = {
            "force": _nullable(values[steps, :3], 5),
            "measured": None if measured is None else _nullable(measured[steps, :3], 5),
        }
    return found
