"""Pages of the repository's files that the documentation links to, so that the site is whole by itself."""

from __future__ import annotations

import ast
import posixpath
import re
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)\s#]+)(#[^)]*)?\)")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".yml": "yaml", ".toml": "toml", ".md": "markdown", "": "text"}


def target(page: str, link: str) -> str | None:
    """Path from the root of the repository that a link of a page in ``docs/`` names, if it is outside of ``docs/`` and
    exists. ``page``: path of the page within ``docs/``."""
    if "://" in link or link.startswith(("/", "mailto:")):
        return None
    path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), link))
    if path.startswith(("docs/", "..")) or not (ROOT / path).exists():
        return None
    return path


def address(path: str) -> str:
    """Page of the site, within ``docs/``, that shows a file or folder of the repository."""
    return f"source/{path}.md"


def linked(pages: Iterable[tuple[str, str]]) -> set[str]:
    """Files and folders of the repository that pages (path and text) link to."""
    return {path for page, text in pages for _, link, _ in LINK.findall(text) if (path := target(page, link))}


def rewritten(page: str, text: str) -> str:
    """The text of a page whose links to the repository lead to pages of the site."""

    def new(match: re.Match[str]) -> str:
        words, link, _ = match.groups()
        path = target(page, link)
        if path is None:
            return match.group(0)
        return f"[{words}]({posixpath.relpath(address(path), posixpath.dirname(page) or '.')})"

    return LINK.sub(new, text)


def page(path: str) -> str:
    """A file as a page, or the modules of a folder with their first sentences."""
    place = ROOT / path
    if place.is_dir():
        rows = [f"| `{p.name}` | {_first_line(p)} |" for p in sorted(place.iterdir()) if p.suffix in (".py", ".yaml")]
        return "\n".join([f"# {path}/", "", "| file | content |", "| --- | --- |", *rows, ""])
    fence = "`" * 6
    language = LANGUAGES.get(place.suffix, "text")
    return f"# {path}\n\n{fence}{language}\n{place.read_text().rstrip()}\n{fence}\n"


def _first_line(path: Path) -> str:
    if path.suffix != ".py":
        return ""
    words = ast.get_docstring(ast.parse(path.read_text())) or ""
    return words.splitlines()[0].replace("|", "\\|") if words else ""
