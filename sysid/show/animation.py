"""Animations of a subject: GIF by Pillow, MP4 (VP9) by OpenCV."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from sim_core.errors import ThinshellError
from sysid.progress.callback import Progress
from sysid.show.colouring import Colouring
from sysid.show.picture import Board
from sysid.show.style import colour_table
from sysid.show.subject import Subject

STATES, PER_S = 48, 8.0
"""States that an animation shows at most, and a second."""

SHORTEST_S, LONGEST_S = 2.0, 12.0
"""Length of an animation, which otherwise takes as long as the motion."""

GIF_COLOURS, GIF_STATES = 223, 4
"""Colours of a GIF in addition to those of values and white, and states that they are chosen from."""


def animate(subject: Subject, coloured: Colouring | None, path: Path, say: Progress) -> None:
    """Write a ``.gif`` or ``.mp4`` of a subject that moves. Raises ``ThinshellError`` where it cannot be written."""
    seconds = float(np.clip(subject.times[-1] - subject.times[0], SHORTEST_S, LONGEST_S))
    steps = chosen_states(len(subject.times), seconds)
    board = Board(subject, coloured, small=True)
    frames = []
    for k, step in enumerate(steps):
        frames.append(board.draw(int(step)))
        say((k + 1) / len(steps), f"picture {k + 1} of {len(steps)}")
    if path.suffix == ".gif":
        _write_gif(path, frames, durations(subject.times[steps], seconds))
    else:
        _write_mp4(path, frames, (len(frames) - 1) / seconds)


def chosen_states(count: int, seconds: float) -> np.ndarray:
    """Which of so many states an animation of so many seconds [s] shows, ``(n,)``, the first and the last with them."""
    wanted = min(STATES, count, round(PER_S * seconds) + 1)
    return np.unique(np.linspace(0, count - 1, wanted).round().astype(int))


def durations(times: np.ndarray, seconds: float) -> list[int]:
    """How long each picture of a GIF stays [ms], in its unit of 10 ms, when the times [s] ``(n,)`` are to pass in so
    many seconds; errors of rounding do not add up. The last stays as long as the others in the mean."""
    shown = seconds * (times - times[0]) / (times[-1] - times[0])
    ends = np.append(shown[1:], seconds * len(times) / (len(times) - 1))
    found: list[int] = (10 * np.diff(np.round(100.0 * ends), prepend=0.0)).astype(int).tolist()
    return found


def _write_gif(path: Path, frames: list[np.ndarray], stays: list[int]) -> None:
    some = np.unique(np.linspace(0, len(frames) - 1, GIF_STATES).round().astype(int))
    several = Image.fromarray(np.concatenate([frames[k] for k in some]))
    common = several.quantize(GIF_COLOURS, dither=Image.Dither.NONE).getpalette() or []
    values = (255.0 * colour_table()[::8]).round().astype(int).ravel().tolist()
    colours = [*common[: 3 * GIF_COLOURS], *values, 255, 255, 255]
    palette = Image.new("P", (1, 1))
    palette.putpalette(colours)
    images = []
    for frame in frames:
        indices = np.array(Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE))
        indices[(frame == 255).all(axis=2)] = len(colours) // 3 - 1  # paper stays white
        images.append(Image.fromarray(indices).convert("P"))
        images[-1].putpalette(colours)
    images[0].save(path, save_all=True, append_images=images[1:], duration=stays, loop=0, optimize=True)


def _write_mp4(path: Path, frames: list[np.ndarray], per_s: float) -> None:
    height, width = frames[0].shape[:2]
    code = cv2.VideoWriter.fourcc(*"vp09")
    writer = cv2.VideoWriter(str(path), code, per_s, (width - width % 2, height - height % 2))
    if not writer.isOpened():
        raise ThinshellError(f"This OpenCV cannot write {path}.", "Write a GIF with --animation gif.")
    for frame in frames:
        writer.write(np.ascontiguousarray(frame[: height - height % 2, : width - width % 2, ::-1]))
    writer.release()
