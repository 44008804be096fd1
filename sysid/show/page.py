"""The page of a subject: one file, no network, with a view that turns and plays."""

from __future__ import annotations

import json
from importlib.resources import files

from jinja2 import Environment
from markupsafe import Markup

from sysid.show.colouring import Colouring
from sysid.show.payload import payload
from sysid.show.subject import Subject

CALM = {
    "rig": "bodies are apart, cameras see their markers, and bonded faces point away from what is touched.",
    "motion": "bodies start apart, cameras see their markers, and what is to touch does.",
}


def page(subject: Subject, coloured: dict[str, Colouring]) -> str:
    """The page as text, under 5 MB."""
    head, block = payload(subject, coloured)
    room = files("sysid.show")

    def text(name: str) -> str:
        return room.joinpath(name).read_text(encoding="utf-8")

    template = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(text("show.html.j2"))
    data = json.dumps(head, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return template.render(
        head=head,
        calm=CALM["motion" if subject.moves else "rig"],
        css=Markup(text("show.css")),
        js=Markup(text("show.js")),
        head_json=Markup(data),
        block=Markup(block),
    )
