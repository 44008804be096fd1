"""One value of every effect that shows on the small rig."""

from __future__ import annotations

TYPICAL: dict[str, dict[str, float]] = {
    "gel_relaxation": {"share": 0.3, "tau_s": 0.2},
    "sheet_orthotropy": {"modulus_ratio": 2.0, "grain_angle_rad": 0.4},
    "bending_plasticity": {"yield_curvature_per_m": 1.0, "hardening_ratio": 0.2},
    "air_drag": {"drag_coefficient": 1.0},
    "static_friction": {"excess": 0.5},
    "end_effector_compliance": {"compliance_m_per_n": 2e-4},
    "wrench_offset": {
        **{name.format(a): 0.1 for name in ("bias_{}_n", "torque_bias_{}_nm") for a in "xyz"},
        **{name.format(a): 0.05 for name in ("drift_{}_n_per_s", "torque_drift_{}_nm_per_s") for a in "xyz"},
    },
    "stream_delay": {"wrench_s": 0.03, "vision_s": 0.05},
    "camera_distortion": {"k1": 0.1, "k2": -0.05},
    "command_lag": {"delay_s": 0.015, "tau_s": 0.03},
    "tool_offset": {"x_m": 3e-4, "y_m": -2e-4, "z_m": -4e-4, "rx_deg": 0.4, "ry_deg": -0.3, "rz_deg": 0.2},
    "camera_pose": {"x_m": 1e-3, "y_m": -2e-3, "z_m": 3e-3, "rx_deg": 0.3, "ry_deg": -0.2, "rz_deg": 0.4},
    "camera_intrinsics": {"scale": 0.02, "cx_px": 3.0, "cy_px": -2.0},
    "gravity_direction": {"tilt_x_rad": 0.05, "tilt_y_rad": -0.1},
    "contact_adhesion": {"work_j_m2": 0.5, "range_m": 2e-4},
}
