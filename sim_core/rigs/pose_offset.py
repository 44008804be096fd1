"""Where something really is, seen from where it is said to be: a constant shift and turn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from sim_core.rigs.fields import FloatArray, Strict, of_length

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

OFFSETS = ("offset_x_m", "offset_y_m", "offset_z_m", "offset_rx_deg", "offset_ry_deg", "offset_rz_deg")
"""Shift and turn of an end effector, or of a camera, against its poses, in the order of :meth:`Displaced.offset`."""

Shift = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-0.1, le=0.1)]
Turn = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-45.0, le=45.0)]
_ShiftSd = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=0.1)]
_TurnSd = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=45.0)]
ShiftSds = Annotated[tuple[_ShiftSd, _ShiftSd, _ShiftSd], of_length(3)]
TurnSds = Annotated[tuple[_TurnSd, _TurnSd, _TurnSd], of_length(3)]


class Displaced(Strict):
    """Something whose stated pose has a constant error. With the nominal pose (p, R), a shift rho and a rotation
    vector phi, both in its own axes,

        T_true = T_nominal * (rho, exp phi):    p_true = p + R rho,    R_true = R exp(phi)
    """

    offset_x_m: Shift = Field(default=0.0, description="shift of the true pose along x")
    offset_y_m: Shift = Field(default=0.0, description="shift of the true pose along y")
    offset_z_m: Shift = Field(default=0.0, description="shift of the true pose along z")
    offset_rx_deg: Turn = Field(default=0.0, description="turn of the true pose, after the shift, about x")
    offset_ry_deg: Turn = Field(default=0.0, description="turn of the true pose, after the shift, about y")
    offset_rz_deg: Turn = Field(default=0.0, description="turn of the true pose, after the shift, about z")

    def offset(self) -> FloatArray:
        """Shift [m] and rotation vector [rad] of the true pose in the nominal one, ``(6,)``."""
        turn = np.deg2rad([self.offset_rx_deg, self.offset_ry_deg, self.offset_rz_deg])
        return np.array([self.offset_x_m, self.offset_y_m, self.offset_z_m, *turn])

    def truly(self, origin: FloatArray, rotation: Rotation) -> tuple[FloatArray, Rotation]:
        """The true pose from the nominal one: origin [m] ``(3,)`` and rotation. Without an offset these are the
        very same objects."""
        offset = self.offset()
        if not offset.any():
            return origin, rotation
        from scipy.spatial.transform import Rotation

        return origin + rotation.apply(offset[:3]), rotation * Rotation.from_rotvec(offset[3:])
