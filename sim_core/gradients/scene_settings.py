"""What a rollout depends on that can be changed in a scene: a tape is of use as long as that is as it was."""

from __future__ import annotations

from typing import Any

from sim_core.errors import ConfigError
from sim_core.scene.scene import Scene


class SceneSettings:
    """How a scene is set now."""

    def __init__(self, scene: Scene) -> None:
        self._was = _set_to(scene)

    def check(self, scene: Scene) -> None:
        """Raise ``ConfigError`` if it is set otherwise."""
        for what, now in _set_to(scene).items():
            if now != self._was[what]:
                raise ConfigError(
                    f"The scene was given {what} since the rollout was recorded.",
                    "Record it again, or take its gradient before.",
                )


def _set_to(scene: Scene) -> dict[str, Any]:
    """By the words for a change of it."""
    system = scene.system
    return {
        "another shape at rest": system,
        "another rig": scene.rig,
        "other fields": scene.fields.changes,
        "other loads": system.loads.tobytes(),
        "other gravity": system.gravity.tobytes(),
    }
