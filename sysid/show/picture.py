"""The picture of a subject at one instant: seen from the side, from afar, and by its own cameras."""

from __future__ import annotations

from textwrap import wrap
from typing import Any

import numpy as np

from sim_core.preflight.distance import sampled
from sim_core.rigs import WORLD
from sysid.show.colouring import Colouring
from sysid.show.pane import Pane
from sysid.show.raster import View, in_front, look_at, render
from sysid.show.scenery import Scenery, camera_view, cone, nearest_points, sight, triads
from sysid.show.style import (
    AXES,
    BAD,
    CAMERA,
    CLAMP,
    INK,
    MARKER,
    MEASURED,
    MUTED,
    PAPER_BOTTOM,
    PAPER_TOP,
    SOUGHT,
    colour_table,
    rgb,
    round_length,
)  # fmt: skip
from sysid.show.subject import Subject
from sysid.show.viewpoint import direction, framed
from sysid.show.words import body_words, contact_words, sensor_words

Axes = Any
"""Of matplotlib, whose types take no arrays of points."""

RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans", "font.size": 9.0, "axes.linewidth": 0.6, "text.color": INK, "axes.edgecolor": MUTED,
    "xtick.color": MUTED, "ytick.color": MUTED, "axes.labelcolor": MUTED,
}  # fmt: skip

CAMERAS = 2
"""Cameras whose own view is drawn at most."""

FINDING_WIDTH, FINDING_LINES = 185, 3
"""Letters of a line of what looks wrong, and such lines."""

SOUGHT_WORDS = "where it is to be in the end"

ARROWS_PX = 18.0
"""Length in the camera's picture, in pixels of the drawing, to which the largest displacement of a marker is drawn."""


class Board:
    """A figure that is laid out once and drawn at any instant. ``small``: for animations, without the facts."""

    def __init__(self, subject: Subject, coloured: Colouring | None, small: bool = False) -> None:
        import matplotlib
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self.subject, self.coloured, self.small = subject, coloured, small
        self.scenery = Scenery(subject, coloured)
        with matplotlib.rc_context(RC):
            size, self.dpi = ((9.6, 5.4), 100) if small else ((16.0, 10.0), 110)
            self.figure = Figure(figsize=size, dpi=self.dpi, facecolor="none")
            canvas = FigureCanvasAgg(self.figure)
            self._artists: list[Any] = []
            self._lay_out()
            self._pane = Pane(canvas)

    def _lay_out(self) -> None:
        subject, small = self.subject, self.small
        top, bottom = (0.905, 0.035) if small else (0.915, 0.215 + 0.0)
        self._main = self._panel(0.012, bottom, 0.655, top)
        cameras = list(subject.rig.cameras)[: 1 if small else CAMERAS]
        plots = subject.moves and bool(subject.wrenches)
        rows = ([] if small else ["afar"]) + cameras + (["plot"] if plots else [])
        heights = {"afar": 1.0, "plot": 0.85}
        total = sum(heights.get(r, 1.15) for r in rows) or 1.0
        self._cameras: dict[str, Axes] = {}
        self._afar = self._plot = None
        at = top
        for row in rows:
            height = (top - bottom) * heights.get(row, 1.15) / total
            gap = 0.030 if not small else 0.055
            if row == "afar":
                self._afar = self._panel(0.675, at - height + 0.4 * gap, 0.988, at)
                self._caption(self._afar, "from afar, with cameras")
            elif row == "plot":
                self._plot = self.figure.add_axes((0.725, at - height + 0.045, 0.258, height - 0.075))
                self._draw_plot(self._plot)
            else:
                self._cameras[row] = self._panel(0.675, at - height + 0.4 * gap, 0.988, at - gap)
                self._span(self._cameras[row], self._camera_size(row))
                self._caption(self._cameras[row], f"what the camera '{row}' sees", outside=True)
            at -= height
        points = framed(subject)
        towards, up = direction(subject, points)
        self._view = look_at(points, towards, up, self._size(self._main))
        self._span(self._main, self._view.size)
        self._draw_bar(self._main, self._view)
        self._extent = float(np.ptp(points, axis=0).max())
        self._marks_every_camera(points, towards, up)
        self._titles()
        if self.coloured is not None:
            self._scale()
        if subject.sought:
            self._main.text(0.015, 0.975, f"\u25cb {SOUGHT_WORDS}", transform=self._main.transAxes, fontsize=8.5,
                            color=SOUGHT, va="top", zorder=9)  # fmt: skip

    def _marks_every_camera(self, points: np.ndarray, towards: np.ndarray, up: np.ndarray) -> None:
        """The view from afar holds all cameras and mounts as well."""
        subject = self.subject
        if self._afar is None:
            return
        more = [points]
        for k in (0, -1):
            for camera in subject.rig.cameras.values():
                more.append(subject.layout.camera_frame(camera, subject.frames[k])[0][None])
            more += [origin[None] for name, (origin, _) in subject.frames[k].items() if name != WORLD]
        every = np.vstack(more)
        self._far_view = look_at(every, towards, up, self._size(self._afar), fill=0.84)
        self._span(self._afar, self._far_view.size)
        self._far_extent = float(np.ptp(every, axis=0).max())

    def _panel(self, left: float, bottom: float, right: float, top: float) -> Axes:
        axes = self.figure.add_axes((left, bottom, right - left, top - bottom), facecolor="none")
        axes.set_xticks([])
        axes.set_yticks([])
        for spine in axes.spines.values():
            spine.set_color("#c9d0d8")
        return axes

    def _span(self, axes: Axes, size: tuple[int, int]) -> None:
        """Coordinates of a panel are pixels of its picture, from the upper left."""
        axes.set(xlim=(0.0, size[0]), ylim=(size[1], 0.0), aspect="equal", autoscale_on=False)

    def _camera_size(self, name: str) -> tuple[int, int]:
        """Of the picture of a camera in its panel."""
        camera = self.subject.rig.cameras[name]
        width, height = self._size(self._cameras[name])
        scale = min(width / camera.width_px, height / camera.height_px)
        return round(scale * camera.width_px), round(scale * camera.height_px)

    def _size(self, axes: Axes) -> tuple[int, int]:
        box = axes.get_position()
        width, height = self.figure.get_size_inches() * self.dpi
        return round(box.width * width), round(box.height * height)

    def _caption(self, axes: Axes, text: str, outside: bool = False) -> None:
        if outside:
            axes.set_title(text, fontsize=8.5, color=MUTED, loc="left", pad=3)
        else:
            axes.text(0.015, 0.975, text, transform=axes.transAxes, fontsize=8.5, color=MUTED, va="top", zorder=9)

    def _titles(self) -> None:
        subject, text = self.subject, self.figure.text
        text(0.012, 0.975, subject.title, fontsize=12 if self.small else 17, weight="bold", va="top")
        if self.small:
            return
        text(0.012, 0.937, _cut(subject.rig.description, 150), fontsize=10, color=MUTED, va="top")
        rows = [(self.scenery.swatch(s), s.body, body_words(subject.rig, s.body)) for s in subject.skins]
        wide = 0.012 + 0.0062 * max(len(name) for _, name, _ in rows)
        room = 66 if len(rows) <= 4 else 62 - max(len(name) for _, name, _ in rows)
        for k, (swatch, name, words) in enumerate(rows[:8]):
            x, y = 0.012 + 0.33 * (k // 4), 0.150 - 0.026 * (k % 4)
            square = self.figure.add_axes((x, y - 0.007, 0.009, 0.0144))
            square.imshow(swatch[None], aspect="auto")
            square.set_axis_off()
            text(x + 0.013, y, name, fontsize=9, weight="bold", va="center")
            text(x + 0.013 + wide, y, _cut(words, room), fontsize=8.5, color=MUTED,
                 va="center")  # fmt: skip
        lines = [*(f"contact {c}" for c in contact_words(subject.rig)), *sensor_words(subject.rig)]
        more = [] if len(lines) <= 7 else [f"and {len(lines) - 6} more"]
        for k, line in enumerate([*lines[: 7 - len(more)], *more]):
            text(0.675, 0.180 - 0.0215 * k, _cut(line, 78), fontsize=8.5, color=MUTED, va="center")
        self._findings()

    def _findings(self) -> None:
        findings = self.subject.findings
        if not findings:
            self.figure.text(0.012, 0.022, "Nothing looks wrong: bodies are apart, cameras see their markers, and "
                             "bonded faces point away from what is touched.", fontsize=9, color="#17713f",
                             va="center")  # fmt: skip
            return
        lines: list[str] = []
        for k, finding in enumerate(findings):
            wrapped = wrap(f"\u26a0 {finding.text}", FINDING_WIDTH)
            if len(lines) + len(wrapped) > FINDING_LINES and lines:
                lines[-1] += f"  (and {len(findings) - k} more)"
                break
            lines += wrapped[:FINDING_LINES]
        for k, line in enumerate(lines):
            at = 0.018 + 0.020 * (len(lines) - 1 - k)
            self.figure.text(0.012, at, line, fontsize=9, color=BAD, weight="bold", va="center")

    def _scale(self) -> None:
        coloured = self.coloured
        assert coloured is not None
        width = 0.20 if not self.small else 0.18
        axes = self.figure.add_axes((0.03, (0.245 if not self.small else 0.085), width, 0.014))
        axes.imshow(colour_table()[None], aspect="auto", extent=(0.0, coloured.top, 0.0, 1.0))
        axes.set_yticks([])
        axes.set_xticks([0.0, 0.5 * coloured.top, coloured.top])
        axes.tick_params(labelsize=8, length=2, pad=2, colors=INK)
        axes.set_title(coloured.label, fontsize=8.5, loc="left", pad=3)

    def _draw_plot(self, axes: Axes) -> None:
        """Force of the first wrench sensors against time."""
        subject = self.subject
        name = max(subject.wrenches, key=lambda n: float(np.ptp(subject.wrenches[n][:, :3])))
        for k, (colour, label) in enumerate(zip(AXES, "xyz", strict=True)):
            axes.plot(subject.times, subject.wrenches[name][:, k], color=colour, linewidth=1.2, label=f"force {label}")
            if name in subject.measured_wrenches:
                axes.plot(subject.times, subject.measured_wrenches[name][:, k], ":", color=colour, linewidth=1.2)
        axes.set_title(f"{name} [N]" + (", dotted as measured" if name in subject.measured_wrenches else ""),
                       fontsize=8.5, color=MUTED, loc="left", pad=3)  # fmt: skip
        axes.tick_params(labelsize=7.5, length=2)
        axes.set_xlabel("time [s]", fontsize=8, labelpad=1)
        axes.legend(fontsize=7.5, frameon=False, loc="best", ncols=3, handlelength=1.2, columnspacing=0.8)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)

    def draw(self, step: int) -> np.ndarray:
        """RGB ``(height, width, 3)``, uint8."""
        import matplotlib

        with matplotlib.rc_context(RC):
            for artist in self._artists:
                artist.remove()
            self._artists.clear()
            self._taken: dict[int, list[tuple[float, float, float, float]]] = {}
            subject = self.subject
            self._pane.begin()
            self._draw_view(self._main, self._view, step, 0.10 * self._extent, names=True)
            if self._afar is not None:
                self._draw_view(self._afar, self._far_view, step, 0.09 * self._far_extent, names=False)
            for name, axes in self._cameras.items():
                self._draw_camera(axes, name, step)
            if self._plot is not None:
                self._keep(self._plot.axvline(subject.times[step], color=INK, linewidth=0.8))
            if subject.moves:
                words = f"{subject.times[step]:.2f} s of {subject.times[-1]:.2f} s"
                self._keep(self._main.text(0.985, 0.975, words, transform=self._main.transAxes, ha="right", va="top",
                                           fontsize=10, weight="bold"))  # fmt: skip
            return self._pane.finish(self._artists)

    def _keep(self, *artists: Any) -> None:
        self._artists.extend(artists)

    def _lines(self, axes: Axes, lines: np.ndarray, zorder: float, **style: Any) -> None:
        """Lines between pixels ``(n, 2, 2)``."""
        from matplotlib.collections import LineCollection

        self._keep(axes.add_collection(LineCollection(list(lines), zorder=zorder, **style), autolim=False))

    def _dots(self, axes: Axes, pixels: np.ndarray, colour: Any, size: float, zorder: float) -> None:
        self._keep(axes.scatter(*pixels.T, s=size, c=colour, linewidths=0, zorder=zorder))

    def _draw_view(self, axes: Axes, view: View, step: int, length: float, names: bool) -> None:
        from matplotlib.colors import to_rgba

        subject = self.subject
        picture, nearness = render(view, self.scenery.skins(step), _paper(view.size[1]))
        self._pane.put(axes, picture)
        frames = subject.frames[step]
        axis_lines = {name: view.lines(lines) for name, lines in triads(frames, length).items()}
        self._lines(axes, np.concatenate(list(axis_lines.values())), 5, colors=AXES * len(axis_lines),
                    linewidths=2.0 if names else 1.2, capstyle="round")  # fmt: skip
        if names:
            for name, lines in axis_lines.items():
                self._label(axes, lines[0, 0], name, MUTED, view, 8.0, (7, 10))
        for name, camera in subject.rig.cameras.items():
            frame = subject.layout.camera_frame(camera, frames)
            for reach, width, alpha in ((0.8 * length, 1.3, 1.0), (sight(subject, name, step), 0.7, 0.45)):
                self._lines(axes, view.lines(cone(camera, frame, reach)), 5, colors=CAMERA, linewidths=width,
                            alpha=alpha)  # fmt: skip
            self._label(axes, view.project(frame[0][None])[0][0], name, CAMERA, view, 8.0, (7, -9))
        for points in subject.sought.values():
            pixel, _ = view.project(points)
            self._keep(axes.scatter(*pixel.T, s=16.0 if names else 5.0, facecolors="none", edgecolors=SOUGHT,
                                    linewidths=0.8 if names else 0.4, zorder=4.5))  # fmt: skip
        for marks in [*subject.markers.values(), *subject.tracks.values()]:
            points = marks.positions(subject.states.positions[step])
            pixel, depth = view.project(points)
            seen = in_front(pixel, view.nearness(depth), nearness)
            colours = [to_rgba(MARKER, 1.0 if s else 0.22) for s in seen]
            self._dots(axes, pixel, colours, 14.0 if names else 4.0, 4)
        if names:
            self._draw_pairs(axes, view, step)
            self._draw_names(axes, view, step, nearness)

    def _draw_pairs(self, axes: Axes, view: View, step: int) -> None:
        for near in nearest_points(self.subject, step):
            pixel, _ = view.project(near.points)
            self._lines(axes, pixel[None], 6, colors=CLAMP, linewidths=1.6, linestyles="dotted")
            self._dots(axes, pixel, CLAMP, 10, 6)
            self._label(axes, pixel.mean(axis=0), f"{near.pair}: {near.words}", CLAMP, view, 8.5, (12, -14))

    def _draw_names(self, axes: Axes, view: View, step: int, nearness: np.ndarray) -> None:
        subject = self.subject
        x, frames = subject.states.positions[step], subject.frames[step]
        for skin in subject.skins:
            vertices = skin.vertices(subject.layout, x, frames)
            if skin.nodes is None:
                vertices = sampled(vertices, skin.triangles, 0.05 * float(np.ptp(vertices, axis=0).max()))
            pixel, depth = view.project(vertices)
            inside = np.all((pixel > 12) & (pixel < np.array(view.size) - 12), axis=1)
            if not inside.any():
                continue
            seen = inside & in_front(pixel, view.nearness(depth), nearness)
            inside = seen if seen.any() else inside
            spot = pixel[inside]
            at = spot[np.argmax(spot[:, 0] + 0.6 * spot[:, 1])]
            self._label(axes, at, skin.body, INK, view, 9.5, (6, 6), weight="bold")

    def _draw_bar(self, axes: Axes, view: View) -> None:
        """A length at the depth of what is in the middle."""
        points = framed(self.subject)
        _, depth = view.project(points)
        per_metre = view.focal_px[0] / float(np.median(depth))
        bar = round_length(0.16 * view.size[0] / per_metre)
        x, y = view.size[0] - 18.0, view.size[1] - 16.0
        axes.plot([x - bar * per_metre, x], [y, y], color=INK, linewidth=2.2, solid_capstyle="butt", zorder=8)
        axes.text(x - 0.5 * bar * per_metre, y - 6, f"{1e3 * bar:g} mm", ha="center", va="bottom", fontsize=8.5)

    def _draw_camera(self, axes: Axes, name: str, step: int) -> None:
        subject = self.subject
        camera = subject.rig.cameras[name]
        width, _ = self._camera_size(name)
        scale = width / camera.width_px
        frame = subject.layout.camera_frame(camera, subject.frames[step])
        shift = subject.picture_shift(name)
        view = camera_view(camera, frame, width, shift)
        picture, _ = render(view, self.scenery.skins(step, name), rgb("#eef1f4"))
        self._pane.put(axes, picture)
        before, now = (scale * (subject.pixels(name, k) + shift) for k in (0, step))
        measured = subject.tracks[name].measured
        moved = np.linalg.norm(now - before, axis=1)
        largest = float(np.nanmax(moved)) if np.isfinite(moved).any() else 0.0
        words = f"{int(np.isfinite(now).all(axis=1).sum())} of {len(now)} points in the picture"
        if largest > 0.05:
            zoom = max(1.0, float(round_length(ARROWS_PX / largest)) if largest < ARROWS_PX else 1.0)
            arrows = zoom * (now - before)
            self._keep(axes.quiver(*before.T, *arrows.T, angles="xy", scale_units="xy", scale=1.0, color=MARKER,
                                   width=0.0042, zorder=5))  # fmt: skip
            if zoom > 1.0:
                words += f"; arrows {zoom:g} times as long as the motion"
        else:
            self._dots(axes, now, MARKER, 11, 5)
        if measured is not None:
            self._keep(
                axes.scatter(
                    *(scale * (measured[step] + shift)).T, s=22, marker="x", c=MEASURED, linewidths=1.0, zorder=6
                )
            )
            words += "; crosses: as measured"
        self._keep(axes.text(0.0, -0.02, words, transform=axes.transAxes, fontsize=7.5, color=MUTED, va="top"))

    def _label(
        self,
        axes: Axes,
        at: np.ndarray,
        text: str,
        colour: str,
        view: View,
        size: float,
        offset: tuple[int, int],
        weight: str = "normal",
    ) -> None:
        """Words next to a point, moved down as far as other words of the same panel are in the way."""
        from matplotlib.patheffects import withStroke

        if not np.isfinite(at).all() or (at < 0).any() or (at > np.array(view.size)).any():
            return
        point = self.dpi / 72.0
        wide, high = 0.62 * size * point * len(text), 1.25 * size * point
        right = at[0] + offset[0] * point + wide > view.size[0]
        x = at[0] + point * (-offset[0] if right else offset[0]) - (wide if right else 0.0)
        y = float(at[1] + point * offset[1])
        taken = self._taken.setdefault(id(axes), [])
        for _ in range(12):
            if not any(x < b and x + wide > a and abs(y - c) < 0.5 * (high + h) for a, b, c, h in taken):
                break
            y += 0.5 * high
        taken.append((x, x + wide, y, high))
        self._keep(
            axes.text(
                x + (wide if right else 0.0), y, text, ha="right" if right else "left", va="center", fontsize=size,
                color=colour, weight=weight, zorder=9, clip_on=True,
                path_effects=[withStroke(linewidth=2.6, foreground="white", alpha=0.9)],
            )
        )  # fmt: skip


def _paper(height: int) -> np.ndarray:
    share = np.linspace(0.0, 1.0, height)[:, None]
    return np.asarray((1.0 - share) * rgb(PAPER_TOP) + share * rgb(PAPER_BOTTOM))


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length - 1].rstrip()}\u2026"


def draw(subject: Subject, coloured: Colouring | None, step: int) -> np.ndarray:
    """The picture at one instant, RGB uint8 ``(1100, 1760, 3)``."""
    return Board(subject, coloured).draw(step)
