"""Files of a subject in one folder: a picture, the page, and an animation of what moves."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from PIL import Image

from sim_core.errors import ConfigError
from sim_core.rigs import Rig
from sysid.progress.callback import Progress
from sysid.show.animation import animate
from sysid.show.colouring import check_quantity, chosen, colourings, telling_step
from sysid.show.page import page
from sysid.show.picture import draw
from sysid.show.subject import Subject, subject_of

PICTURE, PAGE, ANIMATION = "picture.png", "view.html", "animation"
OURS = {PICTURE, PAGE, f"{ANIMATION}.gif", f"{ANIMATION}.mp4"}
"""Files that are written, and replaced when the same is shown again."""

SIMULATED = 0.6
"""Share of the time, about, after which what moves is simulated."""

Animation = Literal["gif", "mp4", "none"]


def check_folder(out: Path) -> None:
    """A folder that does not exist or holds nothing but what is written here. Raises ``ConfigError``."""
    if out.exists() and not out.is_dir():
        raise ConfigError(f"{out} is a file.", "Name a folder with --out.")
    others = sorted(p.name for p in out.iterdir() if p.name not in OURS) if out.exists() else []
    if others:
        raise ConfigError(
            f"The folder {out} holds {others[0]!r}, which 'show' did not write.", "Name another with --out."
        )


def show(
    rig: Rig,
    what: str | None,
    out: Path,
    *,
    by: str | None = None,
    animation: Animation = "gif",
    on_progress: Progress | None = None,
) -> Subject:
    """Draw what ``what`` names on a rig (:func:`sysid.show.subject.subject_of`) into a folder; what was shown.

    ``by``: the quantity that picture and animation are coloured by, 'body' for none; by default the one that says most.
    """
    say = on_progress or (lambda share, text: None)
    check_folder(out)
    check_quantity(by)
    subject = subject_of(rig, what, lambda share, text: say(SIMULATED * share, text))
    coloured = colourings(subject)
    coloured_by = chosen(subject, coloured, by)
    out.mkdir(parents=True, exist_ok=True)
    say(SIMULATED, "picture")
    step = len(subject.times) - 1 if subject.sought else telling_step(subject, coloured_by)
    Image.fromarray(draw(subject, coloured_by, step)).save(out / PICTURE, optimize=True)
    say(SIMULATED + 0.05, "page")
    (out / PAGE).write_text(page(subject, coloured), encoding="utf-8")
    for kind in ("gif", "mp4"):
        if not (subject.moves and animation == kind):
            (out / f"{ANIMATION}.{kind}").unlink(missing_ok=True)
    if subject.moves and animation != "none":
        rest = 0.9 - SIMULATED
        animate(subject, coloured_by, out / f"{ANIMATION}.{animation}", lambda s, t: say(SIMULATED + 0.1 + rest * s, t))
    say(1.0, "")
    return subject
