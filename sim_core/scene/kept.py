"""Scenes that are kept, to be used again for rigs that differ from those before in numbers alone."""

from __future__ import annotations

from sim_core.effects import amended
from sim_core.rigs import Rig
from sim_core.rigs.pose_offset import OFFSETS
from sim_core.scene.scene import Scene, build_scene

MOST = 12
"""Scenes that are kept; the one that was built first goes."""


class KeptScenes:
    """Scenes by what they are built from."""

    def __init__(self) -> None:
        self._scenes: dict[object, Scene] = {}

    def of(self, rig: Rig, refine: int = 1) -> Scene:
        """A scene for the rig, with its numbers; the next one that is asked for may be the same with others.
        ``refine``: factor on cells in each direction."""
        key = (built_from(rig), refine)
        if key not in self._scenes:
            if len(self._scenes) >= MOST:
                self._scenes.pop(next(iter(self._scenes)))
            self._scenes[key] = build_scene(rig, refine)
        scene = self._scenes[key]
        scene.use(rig)
        return scene


def built_from(rig: Rig) -> object:
    """Everything of a rig that a scene is built from and that a change of values does not reach."""
    rig = amended(rig)
    data = rig.model_dump()
    for body in data["bodies"].values():
        material = body.pop("material", None)
        if material is not None and "thickness_m" in material:
            body["thickness_m"] = material["thickness_m"]
    for effector in data["end_effectors"].values():
        for key in OFFSETS:
            effector.pop(key)
    for load, given in zip(rig.loads, data["loads"], strict=True):
        given.pop(load.number)
    for contact in data["contacts"]:
        contact.pop("friction")
        contact.pop("stiffness_pa_per_m")
        contact.pop("standoff_m")
    for camera in data["cameras"].values():
        for sight in camera["sees"]:
            if sight["points"]["placed"] == "first_frame":
                sight["points"].pop("positions_m")
    active = tuple(
        (name, tuple(sorted((k, v == 0.0) for k, v in given.items()))) for name, given in rig.effects.items()
    )
    return repr((data["bodies"], data["clamps"], data["loads"], data["end_effectors"], data["contacts"], active,
                 data["sensors"].keys(), data["cameras"].keys(), data["solver"]["inertia"],
                 data["solver"]["integrator"],
                 [s.get("points") for s in data["sensors"].values()],
                 [c["sees"] for c in data["cameras"].values()]))  # fmt: skip
