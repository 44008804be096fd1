"""A digest of what a rig says, so that a file made for it can name it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from sim_core.errors import ConfigError
from sim_core.rigs.schema import Rig


def rig_sha256(rig: Rig) -> str:
    """SHA-256, as 64 hexadecimal digits, of everything in a rig that is not a default, except its description.

    Mesh files count by their content, so that the digest is the same on every machine. Raises ``ConfigError`` where
    one of them cannot be read.
    """
    said = rig.model_dump(mode="json", exclude_defaults=True, exclude={"description"})
    for body in said["bodies"].values():
        shape = body.get("shape")
        if isinstance(shape, dict) and "file" in shape:
            shape["file"] = _content(Path(shape["file"]))
    return hashlib.sha256(_canonical(said).encode()).hexdigest()


def _content(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(
            f"The mesh file {path} cannot be read: {error.strerror}.", "Check the path in the rig."
        ) from None


def _canonical(said: Any) -> str:
    return json.dumps(said, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
