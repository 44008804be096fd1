"""Animations of a subject: GIF by Pillow, MP4 (VP9) by OpenCV."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from sim_core.errors import ThinshellError
from sysid.show.colouring import Colouring
from sysid.show.picture import Board
from sysid.show.subject import Progress, Subject

STATES = 48
"""States that an animation shows at most."""

SHORTEST_S, LONGEST_S = 2.0, 12.0
"""Length of an animation, which otherwise takes as long as the motion."""

GIF_COLOURS = 128


def animate(subject: Subject, coloured: Colouring | None, path: Path, say: Progress) -> None:
    """Write a ``.gif`` or ``.mp4`` of a subject that moves. Raises ``ThinshellError`` where it cannot be written."""
    steps = np.unique(np.linspace(0, len(subject.times) - 1, min(STATES, len(subject.times))).round().astype(int))
    board = Board(subject, coloured, small=True)
    frames = []
    for k, step in enumerate(steps):
        frames.append(board.draw(int(step)))
        say((k + 1) / len(steps), f"picture {k + 1} of {len(steps)}")
    seconds = float(np.clip(subject.times[-1] - subject.times[0], SHORTEST_S, LONGEST_S))
    if path.suffix == ".gif":
        images = [Image.fromarray(f).quantize(GIF_COLOURS, dither=Image.Dither.NONE) for f in frames]
        images[0].save(
            path,
            save_all=True,
            append_images=images[1:],
            duration=1000.0 * seconds / len(frames),
            loop=0,
            optimize=True,
        )
        return
    height, width = frames[0].shape[:2]
    code = cv2.VideoWriter.fourcc(*"vp09")
    writer = cv2.VideoWriter(str(path), code, len(frames) / seconds, (width - width % 2, height - height % 2))
    if not writer.isOpened():
        raise ThinshellError(f"This OpenCV cannot write {path}.", "Write a GIF with --animation gif.")
    for frame in frames:
        writer.write(np.ascontiguousarray(frame[: height - height % 2, : width - width % 2, ::-1]))
    writer.release()
