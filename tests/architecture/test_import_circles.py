"""No two modules of a package import each other, directly or by way of others."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def modules_in(root: Path, package: str) -> dict[str, Path]:
    """Files of a package by the names under which they are imported."""
    found = {}
    for path in sorted((root / package).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports_of(name: str, path: Path, known: Mapping[str, Path]) -> set[str]:
    """Modules among those ``known`` that the module ``name`` imports when it runs, at its top or within a function, and
    the packages that contain those; not its own packages, whose import has begun before, and not what only a checker of
    types reads."""
    found = set()
    for node in running(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: write imports in full, not relative to the package."
            found |= {str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)}
    own = parents(name) - {name}
    return {parent for module in found for parent in parents(module)} & set(known) - own - {name}


def running(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes of a module but those below ``if TYPE_CHECKING``."""
    yield tree
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"):
            yield from running(node)


def parents(name: str) -> set[str]:
    """A module and the packages that it is in."""
    parts = name.split(".")
    return {".".join(parts[: count + 1]) for count in range(len(parts))}


def circle_in(root: Path, package: str) -> list[str]:
    """Modules of an import circle, in order; empty where there is none."""
    known = modules_in(root, package)
    graph = {name: imports_of(name, path, known) for name, path in known.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


@pytest.mark.parametrize("package", ["sim_core", "sysid", "thinshell_ros"])
def test_modules_form_no_import_circle(package: str) -> None:
    circle = circle_in(ROOT, package)
    assert not circle, " -> ".join(circle)


@pytest.mark.parametrize(
    "late",
    ["from shelf.first import NAME\n", "import shelf.first\n", "def load():\n    from shelf import first\n"],
)
def test_a_circle_by_way_of_a_third_module_is_found(tmp_path: Path, late: str) -> None:
    (tmp_path / "shelf").mkdir()
    files = {"__init__": "", "first": "from shelf.second import NAME\n", "second": "import shelf.third\n", "third": ""}
    for name, text in files.items():
        (tmp_path / "shelf" / f"{name}.py").write_text(text)
    assert circle_in(tmp_path, "shelf") == []
    (tmp_path / "shelf" / "third.py").write_text(late)
    assert set(circle_in(tmp_path, "shelf")) == {"shelf.first", "shelf.second", "shelf.third"}
