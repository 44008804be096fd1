"""Every example runs as it stands, and the quickstart of the README; each asserts its own number."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
DEAR = {"diagnose", "quickstart"}
"""Examples that fit."""

SCRIPTS = [
    pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.stem in DEAR else [])
    for path in sorted(EXAMPLES.glob("*.py"))
]


@pytest.mark.parametrize("script", SCRIPTS)
def test_an_example_runs(script: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="example")["main"]()
    assert list(tmp_path.iterdir()) == [], "it leaves nothing behind"


@pytest.mark.parametrize("notebook", sorted((EXAMPLES / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_runs_from_top_to_bottom(notebook: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    content = json.loads(notebook.read_text())
    scope: dict[str, Any] = {}
    for cell in content["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [], "notebooks are kept without outputs"
            exec(compile("".join(cell["source"]), notebook.name, "exec"), scope)
    import matplotlib.pyplot as plt

    plt.close("all")


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
