"""What diagnoses may not know how cases are made: the import graph, read from the source."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GENERATOR = "sysid.proof.generator"
TRUTHS = "sysid.proof.truths"


def modules_of(folder: Path) -> dict[str, Path]:
    """Every module under a package folder by its dotted name."""
    found = {}
    for path in folder.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports_of(name: str, path: Path, known: set[str]) -> set[str]:
    """Modules of the project that a module imports anywhere, also within functions, with their packages."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    wanted: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            wanted |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parts, base] if base else parts)
            wanted |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
    found = set()
    for module in wanted & known:
        parts = module.split(".")
        found |= {".".join(parts[:k]) for k in range(1, len(parts) + 1)} & known
    return found


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    modules = {**modules_of(ROOT / "sim_core"), **modules_of(ROOT / "sysid")}
    return {name: imports_of(name, path, set(modules)) for name, path in modules.items()}


def reachable(graph: dict[str, set[str]], starts: set[str]) -> set[str]:
    seen, todo = set(starts), list(starts)
    while todo:
        new = graph[todo.pop()] - seen
        seen |= new
        todo += new
    return seen


def test_graph_sees_imports(graph: dict[str, set[str]]) -> None:
    assert "sysid.proof.seal" in graph["sysid.proof.generator.make"]
    assert GENERATOR in graph["sysid.proof"]


@pytest.mark.parametrize("part", ["sim_core", "sysid.diagnosis", "sysid.fit"])
def test_diagnosis_does_not_reach_the_proof(graph: dict[str, set[str]], part: str) -> None:
    starts = {name for name in graph if name == part or name.startswith(part + ".")}
    assert starts
    bad = {name for name in reachable(graph, starts) if name.startswith("sysid.proof")}
    assert not bad, f"{part} reaches {sorted(bad)}"


def test_diagnose_command_does_not_reach_the_generator(graph: dict[str, set[str]]) -> None:
    assert not {m for m in reachable(graph, {"sysid.cli.diagnose"}) if m.startswith("sysid.proof")}


def test_independent_truths_do_not_reach_the_simulator(graph: dict[str, set[str]]) -> None:
    """Nothing of the simulator but its errors, so that both share no method."""
    truths = {name for name in graph if name.startswith(TRUTHS)}
    assert len(truths) > 5
    shared = {m for name in truths for m in graph[name] if m.startswith("sim_core.")}
    assert shared <= {"sim_core.errors"}, shared


def test_running_and_scoring_do_not_reach_the_generator(graph: dict[str, set[str]]) -> None:
    direct = {name: graph[name] for name in ("sysid.proof.run", "sysid.proof.score", "sysid.proof.seal")}
    for name, imported in direct.items():
        assert not {m for m in imported if m.startswith((GENERATOR, TRUTHS))}, name


def test_no_name_of_the_proof_in_strings_of_the_diagnosis() -> None:
    """No import by name either."""
    for folder in ("sim_core", "sysid/diagnosis", "sysid/fit"):
        for path in (ROOT / folder).rglob("*.py"):
            assert "sysid.proof" not in path.read_text(), path
