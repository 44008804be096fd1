"""Triangles to pixels: a depth-buffered renderer on numpy, which needs no display and no graphics card.

Perspective views interpolate 1/depth, which is linear in the picture, so that the depth test is exact where surfaces
touch. What is transparent is drawn as its nearest layer over what is opaque. Of each pixel several samples are tested;
colours are computed once where one triangle covers all of them, and for each sample elsewhere. What is transparent is
blended with the mean of the pixel behind it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

CHUNK = 120_000
"""Pixels of bounding boxes that are looked at together: what fits the cache of a core."""

NEAR = 1e-5
"""Depth [m] in front of which nothing is drawn."""

FAR = 1e3
"""Depth [m] of nothing in a parallel projection."""

FLAT = 1e-3
"""Spread of depths, as a share of them, below which a picture is taken for one of a plane, without shades of depth."""

CREASE = np.cos(np.deg2rad(40.0))
"""Cosine of the angle between a triangle and its vertex normal beyond which the edge is drawn as a sharp one."""


@dataclass(frozen=True)
class View:
    """A camera. ``rotation``: rows are its axes right, down and forward in the world; ``focal_px``: focal length, or
    pixels a metre of a parallel projection with ``parallel``; ``size``: width and height in pixels."""

    eye: np.ndarray
    rotation: np.ndarray
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    size: tuple[int, int]
    parallel: bool = False

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels ``(n, 2)`` and depths [m] ``(n,)`` of points [m] ``(n, 3)``; NaN behind the eye."""
        local = (points - self.eye) @ self.rotation.T
        depth = local[:, 2]
        if self.parallel:
            return local[:, :2] * self.focal_px + self.centre_px, depth
        safe = np.where(depth > NEAR, depth, np.nan)
        return local[:, :2] / safe[:, None] * self.focal_px + self.centre_px, depth

    def lines(self, ends: np.ndarray) -> np.ndarray:
        """Pixels ``(n, 2, 2)`` of the ends of lines [m] ``(n, 2, 3)``."""
        return self.project(ends.reshape(-1, 3))[0].reshape(-1, 2, 2)

    def nearness(self, depth: np.ndarray) -> np.ndarray:
        """What grows towards the eye and is linear in the picture along a line: 1/depth, NaN behind the eye."""
        return FAR - depth if self.parallel else 1.0 / np.where(depth > NEAR, depth, np.nan)

    def scaled(self, factor: float) -> View:
        """The same view on a picture with ``factor`` times the pixels along each side."""
        fx, fy = self.focal_px
        cx, cy = self.centre_px
        size = (round(factor * self.size[0]), round(factor * self.size[1]))
        return View(
            self.eye, self.rotation, (fx * factor, fy * factor), (cx * factor, cy * factor), size, self.parallel
        )


@dataclass(frozen=True)
class Skin:
    """Triangles to draw. ``colours``: RGB from 0 to 1 of each vertex ``(v, 3)``; ``alpha``: opacity; ``lines``: opacity
    of the edges of the mesh; ``light``: share of the colour that the light decides; ``closed``: the triangles are
    outward and close a body, of which the eye, outside, sees those alone that face it."""

    vertices: np.ndarray
    triangles: np.ndarray
    colours: np.ndarray
    alpha: float = 1.0
    lines: float = 0.0
    light: float = 0.55
    closed: bool = False


def look_at(
    points: np.ndarray,
    towards: np.ndarray,
    up: np.ndarray,
    size: tuple[int, int],
    angle_deg: float = 26.0,
    fill: float = 0.92,
) -> View:
    """A view along ``towards`` with ``up`` upwards that shows all points [m] ``(n, 3)``, as near as they allow."""
    forward = towards / np.linalg.norm(towards)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    local = points @ rotation.T
    width, height = size
    focal = 0.5 * height / np.tan(np.deg2rad(0.5 * angle_deg))
    slope = fill * np.array([0.5 * width, 0.5 * height]) / focal
    # On each axis the eye is where the two outermost lines of sight, of slopes +s and -s, meet.
    high = (local[:, :2] - slope * local[:, 2:]).max(axis=0)
    low = (local[:, :2] + slope * local[:, 2:]).min(axis=0)
    middle = 0.5 * (high + low)
    depth = float((-0.5 * (high - low) / slope).min())
    eye = np.concatenate([middle, [depth - 1e-4]]) @ rotation
    return View(eye, rotation, (focal, focal), (0.5 * width, 0.5 * height), size)


def render(
    view: View, skins: Sequence[Skin], background: np.ndarray, oversample: int = 2
) -> tuple[np.ndarray, np.ndarray]:
    """The picture, uint8 ``(height, width, 3)`` RGB, and how near what is opaque is in each pixel ``(height, width)``,
    as :meth:`View.nearness` has it. ``background``: RGB from 0 to 1 ``(3,)``, or of each row ``(height, 3)``."""
    fine = view.scaled(oversample)
    width, height = view.size
    rows = np.broadcast_to(background, (height, 3))
    picture = np.repeat(rows[:, None], width, axis=1).astype(np.float32)
    nearness = np.zeros(fine.size[::-1])
    for transparent in (False, True):
        chosen = [s for s in skins if (s.alpha < 1.0) == transparent and len(s.triangles)]
        if not chosen:
            continue
        found = _Layer(fine, chosen, nearness)
        found.paint(picture, oversample)
        if not transparent:
            nearness = found.nearness
            picture = _with_depth_cues(picture, nearness[::oversample, ::oversample])
    return np.clip(255.0 * picture + 0.5, 0, 255).astype(np.uint8), nearness[::oversample, ::oversample]


def in_front(pixel: np.ndarray, near: np.ndarray, nearness: np.ndarray) -> np.ndarray:
    """Which points, at pixels ``(n, 2)`` and as ``near`` ``(n,)``, nothing opaque is before, bool ``(n,)``."""
    height, width = nearness.shape
    known = np.isfinite(pixel).all(axis=1) & np.isfinite(near)
    column = np.clip(np.nan_to_num(pixel[:, 0]).astype(int), 0, width - 1)
    row = np.clip(np.nan_to_num(pixel[:, 1]).astype(int), 0, height - 1)
    return np.asarray(known & (near >= nearness[row, column] * (1.0 - 4e-3)))


class _Layer:
    """The nearest triangle of each pixel that is nearer than what is there already."""

    def __init__(self, view: View, skins: Sequence[Skin], behind: np.ndarray) -> None:
        width, height = view.size
        corners: list[np.ndarray] = []
        colours: list[np.ndarray] = []
        for skin in skins:
            corners.append(skin.vertices[skin.triangles])
            colours.append(_lit(skin.colours[skin.triangles], _corner_normals(skin), view, skin.light))
        counts = [len(skin.triangles) for skin in skins]
        self._alpha = np.repeat(np.array([skin.alpha for skin in skins], dtype=np.float32), counts)
        self._lines = np.repeat(np.array([skin.lines for skin in skins], dtype=np.float32), counts)
        self._closed = np.repeat([skin.closed for skin in skins], counts)
        corner = np.concatenate(colours).astype(np.float32)
        self._colour, self._slant = corner[:, 0], (corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        pixel, depth = view.project(np.concatenate(corners).reshape(-1, 3))
        self._corner, depth = pixel.reshape(-1, 3, 2), depth.reshape(-1, 3)
        self._near = view.nearness(depth)
        self.nearness = behind.copy()
        self._triangle = np.full((height, width), -1, dtype=np.int32)
        self._scan(width, height)

    def _scan(self, width: int, height: int) -> None:
        p = self._corner
        whole = np.isfinite(p).all(axis=(1, 2)) & np.isfinite(self._near).all(axis=1)
        low = np.where(whole[:, None], np.floor(np.nan_to_num(p.min(axis=1))), 0.0)
        high = np.where(whole[:, None], np.ceil(np.nan_to_num(p.max(axis=1))), -1.0)
        low = np.clip(low, 0, [width, height]).astype(np.int64)
        high = np.clip(high, -1, [width - 1, height - 1]).astype(np.int64)
        rows = np.where((high >= low).all(axis=1), high[:, 1] - low[:, 1] + 1, 0)
        a, u, v = p[:, 0], p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        det = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        # Rows go down the picture, so that what faces the eye turns to the left there.
        rows[~(np.abs(det) > 1e-9) | (self._closed & (det > 0.0))] = 0
        det = np.where(np.abs(det) > 1e-9, det, 1.0)
        heights = np.abs(det)[:, None] / np.maximum(
            np.stack([np.linalg.norm(p[:, 2] - p[:, 1], axis=1), np.linalg.norm(v, axis=1), np.linalg.norm(u, axis=1)],
                     axis=1), 1e-9)  # fmt: skip
        self._heights = heights.astype(np.float32)
        # Barycentric weights are linear in the picture: b = s_0 x + s_1 y + s_2, at the middle of pixel (x, y).
        shift = 0.5 - a
        slopes = np.stack([v[:, 1], -v[:, 0], (shift * v[:, ::-1]) @ [1.0, -1.0],
                           -u[:, 1], u[:, 0], (shift * u[:, ::-1]) @ [-1.0, 1.0]], axis=1) / det[:, None]  # fmt: skip
        self._slopes = slopes
        spans = _Spans(rows, slopes, low, high)
        flat, triangle = self.nearness.reshape(-1), self._triangle.reshape(-1)
        rise = self._near[:, 1:] - self._near[:, :1]
        begin = self._near[spans.triangle, 0] + (spans.first * rise[spans.triangle]).sum(axis=1)
        along_row = (slopes[:, [0, 3]] * rise).sum(axis=1)[spans.triangle]
        for some in spans.chunks():
            count = spans.count[some]
            along = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
            spot = np.repeat(spans.row[some] * width + spans.begin[some], count) + along
            near = np.repeat(begin[some], count)
            near += along * np.repeat(along_row[some], count)
            np.maximum.at(flat, spot, near)
            first = np.flatnonzero(near >= flat[spot])
            triangle[spot[first]] = np.repeat(spans.triangle[some], count)[first]

    def paint(self, picture: np.ndarray, samples: int) -> None:
        """Blend the layer into an RGB picture ``(height, width, 3)``, of which ``samples`` x ``samples`` pixels of the
        view make one."""
        height, width = picture.shape[:2]
        of_sample = np.ascontiguousarray(
            self._triangle.reshape(height, samples, width, samples).transpose(1, 3, 0, 2)
        ).reshape(samples**2, -1)
        spots, first = picture.reshape(-1, 3), of_sample[0]
        alike = (of_sample == first).all(axis=0)
        middle = 0.5 * (samples - 1)
        whole = np.flatnonzero(alike & (first >= 0))
        for begin in range(0, len(whole), CHUNK):
            pixels = whole[begin : begin + CHUNK]
            row, column = np.divmod(pixels, width)
            colour, opacity = self._shade(first[pixels], samples * column + middle, samples * row + middle)
            behind = spots[pixels]
            spots[pixels] = behind + opacity * (colour - behind)
        mixed = np.flatnonzero(~alike)
        row, column = np.divmod(mixed, width)
        behind = spots[mixed]
        total = np.zeros_like(behind)
        for k, triangle in enumerate(of_sample[:, mixed]):
            hit = np.flatnonzero(triangle >= 0)
            x, y = samples * column[hit] + k % samples, samples * row[hit] + k // samples
            colour, opacity = self._shade(triangle[hit], x, y)
            total[hit] += opacity * (colour - behind[hit])
        spots[mixed] = behind + total / samples**2

    def _shade(self, t: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Colours ``(n, 3)`` and opacities ``(n, 1)`` of triangles at places in the picture."""
        s = self._slopes.take(t, axis=0)
        b1 = (s[:, 0] * x + s[:, 1] * y + s[:, 2]).astype(np.float32)
        b2 = (s[:, 3] * x + s[:, 4] * y + s[:, 5]).astype(np.float32)
        colour = self._colour.take(t, axis=0)
        colour += b1[:, None] * self._slant[0].take(t, axis=0)
        colour += b2[:, None] * self._slant[1].take(t, axis=0)
        heights = self._heights.take(t, axis=0)
        to_edge = np.minimum(np.minimum((1.0 - b1 - b2) * heights[:, 0], b1 * heights[:, 1]), b2 * heights[:, 2])
        line = self._lines.take(t) * np.clip(1.6 - to_edge, 0.0, 1.0)
        colour *= (1.0 - line)[:, None]
        return colour, np.maximum(self._alpha.take(t), line)[:, None]


class _Spans:
    """Rows of pixels that triangles cover. ``rows``: how many the box around each has; ``slopes`` ``(m, 6)``: of the
    weights of its second and third corner; ``low``, ``high``: its bounding box in the picture."""

    def __init__(self, rows: np.ndarray, slopes: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
        t = np.repeat(np.arange(len(rows)), rows)
        row = low[t, 1] + np.arange(len(t)) - np.repeat(np.cumsum(rows) - rows, rows)
        left, right = low[t, 0].astype(float), high[t, 0].astype(float)
        # In a row each weight is s x + c, and not negative on one side of x = -c / s.
        s1, s2 = slopes[t, 0], slopes[t, 3]
        c1, c2 = slopes[t, 1] * row + slopes[t, 2], slopes[t, 4] * row + slopes[t, 5]
        with np.errstate(divide="ignore", invalid="ignore"):
            for slope, constant in ((s1, c1), (s2, c2), (-s1 - s2, 1.0 - c1 - c2)):
                edge = -constant / slope
                left = np.where(slope > 0.0, np.maximum(left, np.ceil(edge)), left)
                right = np.where(slope < 0.0, np.minimum(right, np.floor(edge)), right)
                right = np.where((slope == 0.0) & (constant < 0.0), left - 1.0, right)
        some = np.flatnonzero(right >= left)
        self.triangle, self.row = t[some], row[some]
        self.begin = left[some].astype(np.int64)
        self.count = (right[some] - left[some]).astype(np.int64) + 1
        self.first = np.stack([c[some] + s[some] * self.begin for s, c in ((s1, c1), (s2, c2))], axis=1)

    def chunks(self) -> Iterator[slice]:
        """Spans that hold about :data:`CHUNK` pixels together, one after the other."""
        ends = np.cumsum(self.count)
        begin = 0
        while begin < len(ends):
            done = int(ends[begin - 1]) if begin else 0
            end = max(begin + 1, int(np.searchsorted(ends, done + CHUNK, side="right")))
            yield slice(begin, end)
            begin = end


def _lit(colours: np.ndarray, normals: np.ndarray, view: View, light: float) -> np.ndarray:
    """Colours at the corners of triangles ``(m, 3, 3)`` under a lamp at the eye and one above its left shoulder."""
    right, down, forward = view.rotation
    key = -0.55 * forward - 0.62 * down - 0.55 * right
    key /= np.linalg.norm(key)
    towards = np.where(normals @ forward > 0.0, -1.0, 1.0)[..., None] * normals
    sideways, ahead = np.maximum(towards @ key, 0.0), np.maximum(towards @ -forward, 0.0)
    lit = 0.62 + 0.26 * sideways + 0.20 * ahead
    found = colours * (1.0 + 1.8 * light * (lit - 0.95))[..., None] + (0.10 * light * sideways**24)[..., None]
    return np.asarray(np.clip(found, 0.0, 1.0))


def _corner_normals(skin: Skin) -> np.ndarray:
    """Normals at the corners of each triangle ``(m, 3, 3)``: smooth, but those of the triangle at sharp edges."""
    from sim_core.postprocess import vertex_normals

    corner = skin.vertices[skin.triangles]
    flat = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
    smooth = vertex_normals(skin.vertices, skin.triangles)[skin.triangles]
    sharp = np.einsum("tkj,tj->tk", smooth, flat) < CREASE
    return np.where(sharp[..., None], flat[:, None], smooth)


def _with_depth_cues(picture: np.ndarray, nearness: np.ndarray) -> np.ndarray:
    """Darker where something nearer is close by in the picture: unsharp masking of the depth buffer (Luft, Colditz &
    Deussen, Image enhancement by unsharp masking the depth buffer, SIGGRAPH 2006)."""
    solid = nearness > 0.0
    if not solid.any():
        return picture
    low, high = np.percentile(nearness[solid], [2, 98])
    scale = max(float(high - low), FLAT * float(high))
    depth = np.where(solid, nearness, float(nearness[solid].min())).astype(np.float32)
    # Blurred at a quarter of the size, which takes a twentieth of the time and is as smooth.
    height, width = depth.shape
    coarse = cv2.resize(depth, (max(1, width // 4), max(1, height // 4)), interpolation=cv2.INTER_AREA)
    wide = cv2.resize(cv2.GaussianBlur(coarse, (0, 0), 2.25), (width, height))
    shade = np.clip((depth - wide) / scale, -1.0, 0.0)
    factor = np.where(solid, 1.0 + 0.9 * np.maximum(shade, -0.35), 1.0).astype(np.float32)
    return np.asarray(picture * factor[..., None])
