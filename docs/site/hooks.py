"""What MkDocs calls while it builds the site: it adds generated pages, and those of files that pages link to."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files
from mkdocs.utils import get_relative_url

sys.path.insert(0, str(Path(__file__).parent))

import command_reference
import effects_catalogue
import public_api
import rig_reference
import source_pages

GENERATED = {
    "reference/rig.md": rig_reference.page,
    "reference/effects.md": effects_catalogue.page,
    "reference/commands.md": command_reference.page,
    "reference/api/index.md": public_api.index,
}

ROLE = re.compile(r":(?:func|class|mod|meth|attr|data|exc):(?=<code)")


def on_files(files: Files, config: Any) -> Files:
    """Add the generated pages and those of linked files of the repository."""
    for path, make in GENERATED.items():
        files.append(File.generated(config, path, content=make()))
    for module in public_api.PUBLIC:
        files.append(File.generated(config, f"reference/api/{module}.md", content=public_api.page(module)))
    pages = [(file.src_uri, file.content_string) for file in files.documentation_pages()]
    for path in sorted(source_pages.linked(pages)):
        files.append(File.generated(config, source_pages.address(path), content=source_pages.page(path)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links to files of the repository lead to pages of the site."""
    if page.file.src_uri.startswith("source/"):
        return markdown
    return source_pages.rewritten(page.file.src_uri, markdown)


def on_page_content(html: str, **_: Any) -> str:
    """Leave out the roles of cross-references in docstrings, which name what follows as code."""
    return ROLE.sub("", html)


SHIM = "https://unpkg.com/iframe-worker/shim"
"""What the theme loads so that search works in pages opened from a folder."""
OWN_SHIM = "javascripts/iframe-worker.js"
"""The same file within the site."""


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Load nothing from elsewhere."""
    return output.replace(SHIM, get_relative_url(OWN_SHIM, page.url))
