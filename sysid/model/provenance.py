"""Where a result comes from: inputs by their digest, versions, settings, seed, command."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from importlib import metadata
from typing import Any

from sim_core.rigs import Rig, rig_to_yaml
from sim_core.settings import values
from sysid.observations.observations import Run
from sysid.settings import all_settings

_PACKAGES = ("numpy", "scipy", "rosbags", "mcap", "opencv-python-headless")


def provenance(
    rig: Rig,
    runs: list[Run],
    held_out: list[Run],
    seed: int | None = None,
    options: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """What is needed to do it again; ``seed``: None where nothing is random; ``options``: as they were chosen."""
    versions = {}
    for package in ("thinshell_ros", *_PACKAGES):
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "rig": rig_to_yaml(rig),
        "bags": [
            {
                "path": run.path,
                "sha256": list(run.sha256),
                "held_out": role,
                "notes": list(run.notes),
                **({} if run.until is None else {"window_s": [run.since, run.until]}),
            }
            for role, group in ((False, runs), (True, held_out))
            for run in group
        ],
        "versions": {"python": platform.python_version(), **versions},
        "machine": f"{platform.system()} {platform.machine()}",
        **({} if seed is None else {"seed": seed}),
        **({} if options is None else {"options": dict(options)}),
        "settings": {room: values(settings) for room, settings in all_settings().items()},
        "command": " ".join(["thinshell", *sys.argv[1:]]),
    }
