"""Pose of a camera: it stands elsewhere than its calibration says, by a constant shift and turn in its own frame.

T_true = T_nominal * (rho, exp phi)    (:class:`sim_core.rigs.pose_offset.Displaced`)
"""

from __future__ import annotations

from sim_core.effects.base import EffectParameter, Nuisance, Values
from sim_core.effects.hooks import RigMap
from sim_core.effects.scopes import CAMERAS
from sim_core.rigs import Rig
from sim_core.rigs.pose_offset import OFFSETS

OWN = ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")


class CameraPose(RigMap):
    """A camera that was knocked, or calibrated badly."""

    name = "camera_pose"
    title = "the camera stands elsewhere"
    words = "The camera is not where its extrinsic calibration says, by a constant shift and turn in its own frame."
    signature = "All tracks are off by nearly the same number of pixels, with and without contact."
    source = "Hartley & Zisserman, Multiple View Geometry, 2nd ed., sec. 6.1"
    slot = "camera"
    follows = "session"
    passive = True
    scope = CAMERAS
    twins = ("tool_offset", "camera_intrinsics")
    separated_by = "A second camera, or the same motion with the tool unmounted and remounted."
    parameters = (
        *(EffectParameter(f"{a}_m", "m", -0.1, 0.1, (1e-3,), 0.0, False, 3e-3, f"shift along {a}") for a in "xyz"),
        *(EffectParameter(f"r{a}_deg", "deg", -45.0, 45.0, (0.3,), 0.0, False, 1.0, f"turn about {a}") for a in "xyz"),
    )
    example = {"x_m": 0.001, "y_m": -0.002, "z_m": 0.003, "rx_deg": 0.3, "ry_deg": -0.2, "rz_deg": 0.4}

    def nuisances(self, rig: Rig) -> tuple[Nuisance, ...]:
        """As far as the rig says that the pose is not known."""
        return tuple(
            Nuisance("camera", name, f"{name}.{key}", sd, (own,))
            for name, known in rig.cameras.items()
            for key, own, sd in zip(OFFSETS, OWN, (*known.offset_sd_m, *known.offset_sd_deg), strict=True)
        )

    def amend_rig(self, rig: Rig, targets: tuple[str, ...], values: Values) -> Rig:
        if self.vanishes(values):
            return rig
        moved = dict(rig.cameras)
        for name in targets:
            before = moved[name]
            shifted = {key: getattr(before, key) + values[own] for key, own in zip(OFFSETS, OWN, strict=True)}
            moved[name] = before.model_copy(update=shifted)
        return rig.model_copy(update={"cameras": moved})
