"""Sealing: a digest that is public before the run proves afterwards that the truth was not changed.

``sealed.json.sha256`` holds SHA256(salt || truth) with the truth as canonical JSON; ``sealed/truth.json``
holds salt and truth.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from sim_core.errors import ConfigError

SEAL_FILE = "sealed.json.sha256"
SEALED_FOLDER = "sealed"
TRUTH_FILE = "truth.json"


def digest_of(truth: dict[str, Any], salt: str) -> str:
    """Hexadecimal SHA256 of the salt and the canonical JSON of the truth."""
    text = json.dumps(truth, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256((salt + text).encode()).hexdigest()


def file_digest(path: Path) -> str:
    """Hexadecimal SHA256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_seal(folder: Path, truth: dict[str, Any], *, salt: str) -> str:
    """Write the truth and its digest; the digest is returned."""
    digest = digest_of(truth, salt)
    (folder / SEAL_FILE).write_text(digest + "\n")
    sealed = folder / SEALED_FOLDER
    sealed.mkdir()
    (sealed / TRUTH_FILE).write_text(json.dumps({"salt": salt, "truth": truth}, indent=2, allow_nan=False) + "\n")
    return digest


def open_seal(folder: Path) -> dict[str, Any]:
    """The truth, if it is the one that was sealed. Raises ``ConfigError`` otherwise."""
    seal, truth = folder / SEAL_FILE, folder / SEALED_FOLDER / TRUTH_FILE
    for path in (seal, truth):
        if not path.is_file():
            raise ConfigError(f"{path} does not exist.", "Make cases with 'thinshell prove make --out DIR'.")
    held = json.loads(truth.read_text())
    if digest_of(held["truth"], held["salt"]) != seal.read_text().strip():
        raise ConfigError(
            f"{truth} is not what was sealed: its digest differs from {seal.name}.",
            "Nothing is scored against a changed truth; make new cases.",
        )
    return dict(held["truth"])
