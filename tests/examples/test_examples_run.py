"""Every example runs as it stands, and the quickstart of the README; each asserts its own number."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from notebooks import DIGEST, code_digest, executed, paths_in
from notebooks import main as make_notebooks

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
DEAR = {"diagnose", "quickstart"}
"""Examples that fit."""

DEAR_NOTEBOOKS = {"fit", "diagnose", "optimise"}
"""Notebooks that fit or search."""
LARGEST_BYTES = 300_000
"""Of a notebook with its pictures."""

SCRIPTS = [
    pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.stem in DEAR else [])
    for path in sorted(EXAMPLES.glob("*.py"))
]


@pytest.mark.parametrize("script", SCRIPTS)
def test_an_example_runs(script: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="example")["main"]()
    assert list(tmp_path.iterdir()) == [], "it leaves nothing behind"


NOTEBOOKS = sorted((EXAMPLES / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize(
    "notebook",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.stem in DEAR_NOTEBOOKS else [])
        for path in NOTEBOOKS
    ],
)
def test_a_notebook_runs_from_top_to_bottom(notebook: Path) -> None:
    """In a kernel of its own, as a reader runs it; each asserts numbers of its own."""
    pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    found = executed(notebook)
    stored = json.loads(notebook.read_text(encoding="utf-8"))
    assert [_kinds(cell) for cell in found["cells"]] == [_kinds(cell) for cell in stored["cells"]]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_outputs_are_those_of_the_code_and_name_no_place_on_a_machine(notebook: Path) -> None:
    stored = json.loads(notebook.read_text(encoding="utf-8"))
    code = [cell for cell in stored["cells"] if cell["cell_type"] == "code"]
    assert stored["metadata"].get(DIGEST) == code_digest(stored), "run 'make notebooks'"
    assert sum(bool(cell["outputs"]) for cell in code) >= len(code) - 2
    assert not [o for cell in code for o in cell["outputs"] if o["output_type"] == "error" or o.get("name") == "stderr"]
    assert not paths_in(stored)
    assert notebook.stat().st_size < LARGEST_BYTES


def test_outputs_of_other_code_and_places_in_them_are_found() -> None:
    stored = json.loads(NOTEBOOKS[0].read_text(encoding="utf-8"))
    code = next(cell for cell in stored["cells"] if cell["cell_type"] == "code")
    code["source"] = [*code["source"], "\nx = 1"]
    assert stored["metadata"][DIGEST] != code_digest(stored)
    code["outputs"] = [{"output_type": "stream", "name": "stdout", "text": [f"written: {ROOT}/out\n"]}]
    assert paths_in(stored)


def _kinds(cell: dict[str, Any]) -> list[str]:
    """What a cell puts out, pictures and texts; a text that came in parts is one."""
    kinds = [kind for output in cell.get("outputs", []) for kind in output.get("data", {"text": ""})]
    return [kind for kind, _ in groupby(kinds)]


def test_an_effect_of_another_package_is_found_by_its_entry_point(tmp_path: Path) -> None:
    """As pip would install it: its metadata on the path."""
    declared = (EXAMPLES / "own_effect" / "pyproject.toml").read_text()
    group, key, value = re.findall(r'entry-points\."(.+?)"\]\n(\w+) = "(\w+)"', declared)[0]
    metadata = tmp_path / "own_effect-0.1.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: own_effect\nVersion: 0.1\n")
    (metadata / "entry_points.txt").write_text(f"[{group}]\n{key} = {value}\n")
    path = os.pathsep.join([str(tmp_path), str(EXAMPLES / "own_effect"), str(ROOT)])
    command = [sys.executable, str(EXAMPLES / "own_effect" / "try_it.py")]
    run = subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert "leaks" in run.stdout


def test_all_examples_are_listed() -> None:
    said = set(re.findall(r"\]\(([\w/.]+)\)", (EXAMPLES / "README.md").read_text()))
    found = {
        p.relative_to(EXAMPLES).as_posix() for p in EXAMPLES.rglob("*.*") if p.suffix in (".py", ".ipynb", ".yaml")
    }
    assert found - {"own_effect/torque_leak.py", "own_effect/try_it.py"} <= said
    assert all((EXAMPLES / path).exists() for path in said)


@pytest.mark.slow
def test_the_quickstart_of_the_readme_runs(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    assert len([line for line in code.splitlines() if line.startswith("    ")]) <= 10
    (tmp_path / "quickstart.py").write_text(code)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        [sys.executable, "quickstart.py"], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "look" / "picture.png").exists()
    assert (tmp_path / "diagnosis" / "report.html").exists()
    assert "strip.E" in run.stdout


def test_what_is_no_notebook_is_refused_before_any_is_executed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "text.md").touch()
    for name in ("nothing.ipynb", "text.md", "."):
        assert make_notebooks([tmp_path / name]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"error: {tmp_path / name} is no notebook.") and "first_steps.ipynb" in error
