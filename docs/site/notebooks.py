"""Executes notebooks of the examples and stores what they put out (``make notebooks``).

Each runs in its folder, as a reader opens it. With its outputs a digest of its code is stored, so that a test finds
outputs that are not of the code as it stands. Arguments: the notebooks; all of them without.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples" / "notebooks"
DIGEST = "executed_code_sha256"
"""Key in the metadata of a notebook."""
LONGEST_S = 3600
"""Time that one cell may take [s]."""


def code_digest(notebook: dict[str, Any]) -> str:
    """Digest of the code of a notebook."""
    cells = ["".join(c["source"]) for c in notebook["cells"] if c["cell_type"] == "code"]
    return hashlib.sha256(json.dumps(cells).encode()).hexdigest()


def paths_in(notebook: dict[str, Any]) -> list[str]:
    """Texts of outputs that name a place on this machine."""
    places = {str(ROOT), str(Path.home()), tempfile.gettempdir(), sys.prefix}
    found = []
    for cell in notebook["cells"]:
        for output in cell.get("outputs", []):
            texts = [output.get("text", ""), *(v for k, v in output.get("data", {}).items() if k.startswith("text/"))]
            found += [text for text in map("".join, texts) if any(place in text for place in places)]
    return found


def executed(path: Path) -> dict[str, Any]:
    """The notebook with its outputs. Raises where a cell fails, or an output names a place on this machine."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=LONGEST_S,
        kernel_name="python3",
        record_timing=False,
        resources={"metadata": {"path": str(path.parent)}},
    )
    client.execute()
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = [o for o in cell.outputs if o.get("name") != "stderr"]
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    found: dict[str, Any] = json.loads(nbformat.writes(notebook))
    found["metadata"][DIGEST] = code_digest(found)
    named = paths_in(found)
    if named:
        raise ValueError(f"{path.name}: an output names a place on this machine: {named[0][:200]}")
    return found


def main(paths: list[Path]) -> int:
    """Execute and store. Returns 2 for what is no notebook, before any is executed."""
    for path in paths:
        if not path.is_file() or path.suffix != ".ipynb":
            known = ", ".join(sorted(p.name for p in FOLDER.glob("*.ipynb")))
            print(f"error: {path} is no notebook. Name files that end with .ipynb, as those of {FOLDER.name}: {known}.",
                  file=sys.stderr)  # fmt: skip
            return 2
    for path in paths or sorted(FOLDER.glob("*.ipynb")):
        started = time.monotonic()
        path.write_text(json.dumps(executed(path), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(f"{path.name}: {time.monotonic() - started:.0f} s, {path.stat().st_size / 1e3:.0f} kB", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(list(map(Path, sys.argv[1:]))))
