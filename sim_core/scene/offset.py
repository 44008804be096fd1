"""Where end effectors really are: a constant offset in their own frame against the nominal poses
(:class:`sim_core.rigs.pose_offset.Displaced`).

A mount that was measured wrongly, a tool that is clamped askew, and a calibration of the hand that is off are of this
form.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.energies.linearised import skew
from sim_core.rigs import Rig
from sim_core.rigs.schema import EndEffector
from sim_core.scene.scene import Frame

SMALL_ANGLE = 1e-2
"""Angle [rad] below which (a - sin a) / a^3 comes from its series: the next term is 2e-12 of it there."""


def with_offsets(rig: Rig, frames: Mapping[str, Frame]) -> dict[str, Frame]:
    """True frames of mounts from the nominal ones. One without an offset is the very same object."""
    return {
        name: f if name not in rig.end_effectors or not rig.end_effectors[name].offset().any()
        else rig.end_effectors[name].truly(*f)
        for name, f in frames.items()
    }  # fmt: skip


def offset_motion(effector: EndEffector) -> np.ndarray:
    """Motion of the true frame in its own axes, translation [m] and turn [rad], by the offset, ``(6, 6)``:

    exp(-phi) d rho,    J(phi) d phi,    J = 1 - (1 - cos a) / a^2 [phi]x + (a - sin a) / a^3 [phi]x^2,  a = |phi|

    (right Jacobian of SO(3); Sola, Deray & Atchuthan, A micro Lie theory, arXiv:1812.01537, eq. 143).
    """
    phi = effector.offset()[3:]
    a, cross = float(np.linalg.norm(phi)), skew(phi[None])[0]
    second = 0.5 * np.sinc(0.5 * a / np.pi) ** 2
    third = (a - np.sin(a)) / a**3 if a > SMALL_ANGLE else 1.0 / 6.0 - a**2 / 120.0
    out = np.zeros((6, 6))
    out[:3, :3] = Rotation.from_rotvec(-phi).as_matrix()
    out[3:, 3:] = np.eye(3) - second * cross + third * cross @ cross
    return out
