"""Intrinsics of a camera: its scale and its principal point are not those of its calibration.

f' = (1 + s) f  (an orthographic camera: metres a pixel / (1 + s)),    c' = c + dc
"""

from __future__ import annotations

from sim_core.effects.base import EffectParameter, Nuisance, Values
from sim_core.effects.hooks import RigMap
from sim_core.effects.scopes import CAMERAS
from sim_core.rigs import OrthographicCamera, Rig


class CameraIntrinsics(RigMap):
    """A camera whose lens was refocused, or whose calibration is of another one."""

    name = "camera_intrinsics"
    title = "the camera's scale is off"
    words = "The focal length and the principal point of the camera are not those of its calibration."
    signature = "All motion in the picture is too large or too small by the same share, in every direction."
    source = "Hartley & Zisserman, Multiple View Geometry, 2nd ed., sec. 6.1"
    slot = "camera"
    follows = "sensor"
    passive = True
    scope = CAMERAS
    twins = ("camera_pose", "camera_distortion")
    separated_by = "A motion of known size across the picture without contact."
    parameters = (
        EffectParameter("scale", "-", -0.5, 1.0, (0.02,), 0.0, False, 0.02, "share by which the picture is larger"),
        EffectParameter("cx_px", "px", -1e3, 1e3, (2.0,), 0.0, False, 5.0, "shift of the principal point in u"),
        EffectParameter("cy_px", "px", -1e3, 1e3, (2.0,), 0.0, False, 5.0, "shift of the principal point in v"),
    )
    example = {"scale": 0.02, "cx_px": 3.0, "cy_px": -2.0}

    def nuisances(self, rig: Rig) -> tuple[Nuisance, ...]:
        """Focal lengths together (the scale of an orthographic camera), and the principal point. Where a camera counts
        from one of the markers, its centre has no part in the readings."""
        found = []
        for name, camera in rig.cameras.items():
            counted = False
            if isinstance(camera, OrthographicCamera):
                found.append(Nuisance("camera", name, f"{name}.scale_m_per_px", camera.scale_sd, ("scale",)))
                counted = camera.origin_id is not None
            else:
                tied = (f"{name}.fy_px",)
                found.append(Nuisance("camera", name, f"{name}.fx_px", camera.scale_sd, ("scale",), tied))
            if not counted:
                centre = ("cx_px", "cy_px")
                found += [Nuisance("camera", name, f"{name}.{c}", camera.centre_sd_px, (c,)) for c in centre]
        return tuple(found)

    def amend_rig(self, rig: Rig, targets: tuple[str, ...], values: Values) -> Rig:
        if self.vanishes(values):
            return rig
        changed, grown = dict(rig.cameras), 1.0 + values["scale"]
        for name in targets:
            camera = changed[name]
            update = {c: getattr(camera, c) + values[c] for c in ("cx_px", "cy_px")}
            if isinstance(camera, OrthographicCamera):
                update["scale_m_per_px"] = camera.scale_m_per_px / grown
            else:
                update |= {"fx_px": grown * camera.fx_px, "fy_px": grown * camera.fy_px}
            changed[name] = camera.model_copy(update=update)
        return rig.model_copy(update={"cameras": changed})
