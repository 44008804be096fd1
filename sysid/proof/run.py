"""Diagnose the cases blind: each in a process of its own that sees a copy of its case folder and nothing else.

Writes ``answers/case_XX/`` (what ``thinshell diagnose`` writes, and ``run.json``: time and exit), then
``answers.json`` with what every diagnosis says (:mod:`sysid.proof.answer`) and its digest, and its own digest
``answers.json.sha256``. Seal, truth, diagnoses and score are small and can be kept without the recordings.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

import sysid
from sim_core.errors import ConfigError
from sysid.progress.callback import Progress, silent
from sysid.progress.terminal import share_of_line
from sysid.proof.answer import read_answer
from sysid.proof.seal import SEAL_FILE, file_digest

ANSWERS_FILE = "answers.json"
ANSWERS_FOLDER = "answers"
DIAGNOSIS_FILE = "diagnosis.json"
RUN_FILE = "run.json"
TIME_LIMIT_S = 3600.0


def case_folders(folder: Path) -> list[Path]:
    """The cases in order. Raises ``ConfigError`` when there are none."""
    found = sorted(p for p in folder.glob("case_*") if (p / "case.yaml").is_file())
    if not found:
        raise ConfigError(f"{folder} holds no cases.", "Make some with 'thinshell prove make --out DIR'.")
    return found


def run_cases(folder: Path, *, on_progress: Progress | None = None) -> str:
    """Diagnose all cases that have no answer yet; errors are recorded and tried again by the next call."""
    cases = case_folders(folder)
    diagnoses = folder / ANSWERS_FOLDER
    tell = on_progress or silent
    missing = [case for case in cases if not (diagnoses / case.name / DIAGNOSIS_FILE).is_file()]
    for k, case in enumerate(missing):

        def report(share: float, at: int = k, name: str = case.name) -> None:
            tell((at + share) / len(missing), name)

        report(0.0)
        _diagnose(case, diagnoses / case.name, report)
    index: dict[str, Any] = {
        "seal": _seal(folder),
        "cases": {case.name: _entry(diagnoses / case.name) for case in cases},
    }
    path = folder / ANSWERS_FILE
    path.write_text(json.dumps(index, indent=2) + "\n")
    digest = file_digest(path)
    (folder / f"{ANSWERS_FILE}.sha256").write_text(digest + "\n")
    failed = [name for name, entry in index["cases"].items() if entry["error"]]
    lines = [f"{len(cases) - len(failed)} of {len(cases)} cases diagnosed, listed in {path}", f"SHA256: {digest}"]
    lines += [f"{name}: {index['cases'][name]['error']}" for name in failed]
    return "\n".join(lines)


def _diagnose(case: Path, answer: Path, report: Callable[[float], None]) -> None:
    """Run the diagnosis of one case and keep what it wrote. ``report``: takes the share of it that is done."""
    with tempfile.TemporaryDirectory(prefix="case_") as temporary:
        here = Path(temporary)
        shutil.copytree(case, here / "case")
        command = [sys.executable, "-m", "sysid", "diagnose", *_arguments(here / "case"), "--out", "answer"]
        started = time.monotonic()
        code, output = _followed(command, here, report)
        seconds = time.monotonic() - started
        written = here / "answer"
        error = ""
        if code != 0 or not (written / DIAGNOSIS_FILE).is_file():
            error = output.strip()[-2000:] or f"exit {code}"
            shutil.rmtree(written, ignore_errors=True)
        written.mkdir(exist_ok=True)
        (written / RUN_FILE).write_text(json.dumps({"seconds": round(seconds, 2), "exit": code, "error": error}) + "\n")
        if answer.exists():
            shutil.rmtree(answer)
        answer.parent.mkdir(exist_ok=True)
        partial = answer.with_name(answer.name + ".partial")
        shutil.rmtree(partial, ignore_errors=True)
        shutil.copytree(written, partial)
        partial.rename(answer)


def _followed(command: Sequence[str], folder: Path, report: Callable[[float], None]) -> tuple[int, str]:
    """Exit code and output of a command that says how far it is, which is reported."""
    lines: list[str] = []
    with subprocess.Popen(
        command, cwd=folder, env=_environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as child:
        overdue = threading.Timer(TIME_LIMIT_S, child.kill)
        overdue.start()
        try:
            for line in child.stdout or ():
                lines.append(line)
                share = share_of_line(line)
                if share is not None:
                    report(share)
            code = child.wait()
        except BaseException:
            child.kill()
            raise
        finally:
            timely = overdue.is_alive()
            overdue.cancel()
    return (code, "".join(lines)) if timely else (-1, f"not finished after {TIME_LIMIT_S:g} s")


def _arguments(case: Path) -> list[str]:
    """Rig and recordings of a case, as the command line takes them from the folder above it."""
    roles = yaml.safe_load((case / "case.yaml").read_text())
    words = [f"case/{name}" for name in ("rig.yaml", *roles["training"])]
    for name in roles["held_out"]:
        words += ["--held-out", f"case/{name}"]
    return words


def _environment() -> dict[str, str]:
    """The environment with this very package first on the path."""
    root = str(Path(sysid.__file__).resolve().parent.parent)
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def _seal(folder: Path) -> str:
    path = folder / SEAL_FILE
    return path.read_text().strip() if path.is_file() else ""


def _entry(answer: Path) -> dict[str, Any]:
    """What is known of one answer: its digest, what it says, time, error."""
    run = json.loads((answer / RUN_FILE).read_text())
    entry: dict[str, Any] = {"seconds": run["seconds"], "error": run["error"]}
    path = answer / DIAGNOSIS_FILE
    if path.is_file():
        entry["sha256"] = file_digest(path)
        entry["answer"] = asdict(read_answer(path))
    return entry
