"""Templates to one self-contained file."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

if TYPE_CHECKING:
    from sysid.report.tables import ErrorRow


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["raw_svg"] = Markup
    environment.filters["groupby_run"] = _by_run
    return environment


def _by_run(rows: Sequence[ErrorRow]) -> list[list[ErrorRow]]:
    """Rows of errors, those of one recording together."""
    return [list(group) for _, group in groupby(rows, key=lambda r: (r.run, r.held_out))]


def write_page(template: str, path: Path, **context: Any) -> Path:
    """Render a template of this package into ``path``; its folder is made if need be."""
    style = (Path(__file__).parent / "style.css").read_text(encoding="utf-8")
    text = _environment().get_template(template).render(style=Markup(style), **context)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def embedded_json(data: Any) -> Markup:
    """Data for a ``<script type="application/json">`` element: NaN as null, nothing that ends the element."""
    text = json.dumps(_finite(data), ensure_ascii=True, allow_nan=False, default=float)
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))


def _finite(data: Any) -> Any:
    """The same data with None for numbers that JSON cannot hold."""
    if isinstance(data, dict):
        return {str(k): _finite(v) for k, v in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(v) for v in data]
    if isinstance(data, float) and not math.isfinite(data):
        return None
    return data
