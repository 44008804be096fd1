"""What may be concealed on each stand: effects with random amplitudes, in the library of the diagnosis or outside it.

A name that the registry of effects knows means the same law, or a law that this effect describes, with the parameters
of the same meaning; a name outside it has the slot in which a diagnosis should place it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sysid.proof.truths.arm import ArmFaults
from sysid.proof.truths.ball import BallLaws
from sysid.proof.truths.camera import Pinhole
from sysid.proof.truths.gel import Pad
from sysid.proof.truths.sensors import ClockFaults, WrenchFaults
from sysid.proof.truths.strip import Strip, StripEffects

Array = np.ndarray


@dataclass(frozen=True)
class Concealed:
    """One effect. ``slot``: sheet, gel, contact, robot, wrench sensor, camera, clock or air; ``parameters``: what is
    sealed; the other fields: what changes in the truth."""

    name: str
    slot: str
    parameters: dict[str, float]
    strip: dict[str, Any] = field(default_factory=dict)
    ball: dict[str, Any] = field(default_factory=dict)
    arm: dict[str, Any] = field(default_factory=dict)
    wrench: dict[str, Any] = field(default_factory=dict)
    clocks: dict[str, Any] = field(default_factory=dict)
    camera: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Changes:
    """All that is concealed in a case, as the parts of the truth take it."""

    strip: StripEffects
    ball: BallLaws
    arm: ArmFaults
    wrench: WrenchFaults
    clocks: ClockFaults
    camera: Pinhole


Draw = Callable[[np.random.Generator, Any], Concealed]


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _weight(stand: Strip | Pad) -> float:
    """A typical force of the stand [N]."""
    if isinstance(stand, Strip):
        return stand.mass_per_m * stand.length * 9.81
    return float(1.7 * stand.modulus / (1 - stand.poisson**2) * math.sqrt(stand.radius) * stand.depth**1.5)


def _plasticity(rng: np.random.Generator, strip: Strip) -> Concealed:
    own = 0.5 * strip.mass_per_m * 9.81 * strip.length**2 / strip.bending
    limit, hardening = own * rng.uniform(0.55, 0.9), rng.uniform(0.1, 0.4)
    return Concealed(
        "bending_plasticity", "sheet", {"yield_curvature_per_m": limit, "hardening_ratio": hardening},
        strip={"yield_per_m": limit, "hardening": hardening},
    )  # fmt: skip


def _creep(rng: np.random.Generator, strip: Strip) -> Concealed:
    share, tau = rng.uniform(0.15, 0.5), _log(rng, 0.1, 1.5)
    return Concealed(
        "viscoelastic_sheet", "sheet", {"share": share, "tau_s": tau}, strip={"branches": ((share, tau),)}
    )  # fmt: skip


def _drag(rng: np.random.Generator, strip: Strip) -> Concealed:
    c = rng.uniform(1.0, 2.5)
    return Concealed("air_drag", "air", {"drag_coefficient": c}, strip={"air": c})


def _sticking(rng: np.random.Generator, stand: Strip | Pad) -> Concealed:
    excess = rng.uniform(0.25, 0.8)
    change = {"excess": excess}
    return Concealed("static_friction", "contact", change, strip=change, ball=change)


def _tilted(rng: np.random.Generator, strip: Strip) -> Concealed:
    tilt = _sign(rng) * rng.uniform(0.03, 0.1)
    # Gravity turned about y by the angle b has (g sin b) along -x: see the sign in StripTruth.
    return Concealed("gravity_direction", "robot", {"tilt_y_rad": -tilt}, strip={"tilt_rad": tilt})


def _mounted(rng: np.random.Generator, stand: Strip | Pad) -> Concealed:
    if isinstance(stand, Strip):
        turn = _sign(rng) * rng.uniform(0.015, 0.04)
        parameters = {"ry_deg": -math.degrees(turn)}
        return Concealed("tool_offset", "robot", parameters, arm={"offset": (0.0, 0.0, turn)})
    shift = _sign(rng) * rng.uniform(0.2, 0.35) * stand.depth
    side = _sign(rng) * rng.uniform(3e-4, 8e-4)
    return Concealed("tool_offset", "robot", {"x_m": side, "z_m": shift}, arm={"offset": (side, 0.0, shift)})


def _yielding(rng: np.random.Generator, pad: Pad) -> Concealed:
    c = rng.uniform(0.12, 0.35) * pad.depth / _weight(pad)
    rows = ((c, 0.0, 0.0), (0.0, c, 0.0), (0.0, 0.0, c))
    return Concealed(
        "end_effector_compliance", "robot", {"compliance_m_per_n": c}, arm={"compliance": rows}
    )  # fmt: skip


def _offset(rng: np.random.Generator, stand: Strip | Pad) -> Concealed:
    drifts = rng.random() < 0.5
    size = _weight(stand) * rng.uniform(0.08, 0.25)
    way = rng.standard_normal(3) * ([1.0, 0.0, 1.0] if isinstance(stand, Strip) else [1.0, 1.0, 1.0])
    way *= size / np.linalg.norm(way)
    words = "drift_{}_n_per_s" if drifts else "bias_{}_n"
    parameters = {words.format(a): float(v) / (4.0 if drifts else 1.0) for a, v in zip("xyz", way, strict=True)}
    six = np.r_[list(parameters.values()), np.zeros(3)]
    return Concealed("wrench_offset", "wrench sensor", parameters, wrench={"drift" if drifts else "bias": six})


def _filtered(rng: np.random.Generator, stand: Strip | Pad) -> Concealed:
    tau = _log(rng, 0.03, 0.12)
    return Concealed("wrench_low_pass", "wrench sensor", {"tau_s": tau}, wrench={"filter_s": tau})


def _mixed(rng: np.random.Generator, stand: Strip | Pad) -> Concealed:
    share = _sign(rng) * rng.uniform(0.06, 0.15)
    matrix = np.eye(6)
    matrix[0, 2] = share
    return Concealed("wrench_crosstalk", "wrench sensor", {"x_by_z": share}, wrench={"matrix": matrix})


def _late(rng: np.random.Generator, stand: Strip | Pad) -> Concealed:
    stream = str(rng.choice(["wrench_s", "vision_s"]))
    late = _sign(rng) * _log(rng, 0.02, 0.08)
    return Concealed("stream_delay", "clock", {stream: late}, clocks={stream: late})


def _distorted(rng: np.random.Generator, stand: Strip | Pad) -> Concealed:
    k1 = _sign(rng) * rng.uniform(0.03, 0.1)
    return Concealed("camera_distortion", "camera", {"k1": k1}, camera={"distortion": (k1, 0.0, 0.0, 0.0, 0.0)})


def _rolling(rng: np.random.Generator, stand: Strip | Pad) -> Concealed:
    readout = rng.uniform(0.02, 0.033)
    return Concealed(
        "rolling_shutter", "camera", {"readout_s": readout}, camera={"line_s": readout / stand.camera.size[1]}
    )  # fmt: skip


def _relaxing(rng: np.random.Generator, pad: Pad) -> Concealed:
    share, tau = rng.uniform(0.08, 0.35), _log(rng, 0.1, 1.2)
    return Concealed("gel_relaxation", "gel", {"share": share, "tau_s": tau}, ball={"branches": ((share, tau),)})


def _sticky(rng: np.random.Generator, pad: Pad) -> Concealed:
    work = rng.uniform(0.04, 0.12) * _weight(pad) / (math.pi * pad.radius)
    reach = rng.uniform(0.15, 0.3) * pad.depth
    return Concealed(
        "contact_adhesion", "contact", {"work_j_m2": work, "range_m": reach},
        ball={"work_j_m2": work, "range_m": reach},
    )  # fmt: skip


def _softening(rng: np.random.Generator, strip: Strip) -> Concealed:
    own = 0.5 * strip.mass_per_m * 9.81 * strip.length**2 / strip.bending
    scale = own * rng.uniform(0.6, 1.2)
    return Concealed("moment_softening", "sheet", {"scale_per_m": scale}, strip={"softening_per_m": scale})


def _cushion(rng: np.random.Generator, strip: Strip) -> Concealed:
    c = 1.8e-5 * strip.width**2 * rng.uniform(0.6, 1.5)
    return Concealed("air_cushion", "air", {"factor_n_s_m": c}, strip={"cushion": c})


def _jump(rng: np.random.Generator, strip: Strip) -> Concealed:
    factor = rng.uniform(0.4, 0.7) if rng.random() < 0.5 else rng.uniform(1.5, 2.2)
    return Concealed("stiffness_jump", "sheet", {"factor": factor}, strip={"jump": factor})


def _played(rng: np.random.Generator, stand: Strip | Pad) -> Concealed:
    if isinstance(stand, Strip):
        width = (0.0, 0.0, rng.uniform(0.02, 0.05))
    else:
        play = rng.uniform(0.3, 0.6) * stand.friction * _weight(stand) / (8 * stand.layer.shear * stand.radius**0.5)
        width = (play / stand.depth**0.5, play / stand.depth**0.5, 0.0)
    return Concealed("backlash", "robot", {"width": max(width)}, arm={"play": width})


def _lagging(rng: np.random.Generator, stand: Strip | Pad) -> Concealed:
    lag = rng.uniform(0.03, 0.08)
    return Concealed("unreported_lag", "robot", {"lag_s": lag}, arm={"lag_s": lag, "echo": True})


def _stiffening(rng: np.random.Generator, pad: Pad) -> Concealed:
    rise = rng.uniform(0.3, 0.8) * pad.thickness / pad.depth
    return Concealed("depth_stiffening", "gel", {"rise": rise}, ball={"stiffening": rise})


def _fading(rng: np.random.Generator, pad: Pad) -> Concealed:
    fade = rng.uniform(0.2, 0.4)
    at = 0.3 * _weight(pad) / (math.pi * pad.radius * pad.depth)
    return Concealed("load_dependent_friction", "contact", {"power": fade}, ball={"fade": fade, "at_pa": at})


def _soft(rng: np.random.Generator, pad: Pad) -> Concealed:
    spot = (*rng.uniform(-1e-3, 1e-3, 2), rng.uniform(1e-3, 2e-3))
    soft = rng.uniform(0.15, 0.4)
    return Concealed("soft_spot", "gel", {"share": soft}, ball={"soft": soft, "spot": spot})


LIBRARY: dict[str, dict[str, Draw]] = {
    "strip": {
        "bending_plasticity": _plasticity,
        "viscoelastic_sheet": _creep,
        "air_drag": _drag,
        "static_friction": _sticking,
        "gravity_direction": _tilted,
        "tool_offset": _mounted,
        "wrench_offset": _offset,
        "wrench_low_pass": _filtered,
        "wrench_crosstalk": _mixed,
        "stream_delay": _late,
        "camera_distortion": _distorted,
        "rolling_shutter": _rolling,
    },
    "gel": {
        "gel_relaxation": _relaxing,
        "static_friction": _sticking,
        "contact_adhesion": _sticky,
        "end_effector_compliance": _yielding,
        "tool_offset": _mounted,
        "wrench_offset": _offset,
        "wrench_low_pass": _filtered,
        "wrench_crosstalk": _mixed,
        "stream_delay": _late,
        "camera_distortion": _distorted,
    },
}
"""Effects that the registry knows by the same name."""

OUTSIDE: dict[str, dict[str, Draw]] = {
    "strip": {
        "moment_softening": _softening,
        "air_cushion": _cushion,
        "stiffness_jump": _jump,
        "backlash": _played,
        "unreported_lag": _lagging,
    },
    "gel": {
        "depth_stiffening": _stiffening,
        "load_dependent_friction": _fading,
        "soft_spot": _soft,
        "backlash": _played,
        "unreported_lag": _lagging,
    },
}
"""What the registry did not know when this was written, with the slot where it acts."""


def draw(rng: np.random.Generator, stand: Strip | Pad, name: str) -> Concealed:
    """An effect with random amplitude for a stand."""
    kind = "strip" if isinstance(stand, Strip) else "gel"
    return {**LIBRARY[kind], **OUTSIDE[kind]}[name](rng, stand)


def changes(stand: Strip | Pad, concealed: list[Concealed]) -> Changes:
    """All concealed effects together."""

    def merged(part: str) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for c in concealed:
            found.update(getattr(c, part))
        return found

    friction = BallLaws(stand.friction)
    return Changes(
        StripEffects(**merged("strip")) if isinstance(stand, Strip) else StripEffects(),
        replace(friction, **merged("ball")) if isinstance(stand, Pad) else friction,
        ArmFaults(**merged("arm")),
        WrenchFaults(**merged("wrench")),
        ClockFaults(**merged("clocks")),
        replace(stand.camera, **merged("camera")),
    )
