"""Keep a scored shard with the code: seal, truth, diagnoses and score, a few kilobytes a case."""

from __future__ import annotations

import shutil
from pathlib import Path

from sim_core.errors import ConfigError
from sysid.proof.run import ANSWERS_FILE
from sysid.proof.score import SCORE_FILE
from sysid.proof.seal import SEAL_FILE, SEALED_FOLDER, TRUTH_FILE, open_seal

KEPT = (SEAL_FILE, f"{SEALED_FOLDER}/{TRUTH_FILE}", ANSWERS_FILE, f"{ANSWERS_FILE}.sha256", SCORE_FILE)
"""Files of a shard from which ``thinshell prove score`` gives the same table again."""


def keep_shard(folder: Path, out: Path) -> str:
    """Copy what is kept of ``folder`` to ``out``; the returned text says what. Raises ``ConfigError`` where the shard
    is not scored or its truth is not the one that was sealed."""
    open_seal(folder)
    for name in KEPT:
        if not (folder / name).is_file():
            raise ConfigError(f"{folder / name} does not exist.", "Run and score the cases first.")
    for name in KEPT:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(folder / name, out / name)
    size = sum((out / name).stat().st_size for name in KEPT)
    return f"{out}: seal, truth, diagnoses and score, {size / 1024:.0f} KiB."
