"""A strip clamped in a hand above a table: what is drawn, how it is moved, what it does, what the operator knows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from sysid.proof.truths.arm import RIGID, ArmFaults, through
from sysid.proof.truths.camera import Pinhole, look_at
from sysid.proof.truths.noise import NoiseLevels, nasty
from sysid.proof.truths.paths import Path
from sysid.proof.truths.rod import Rod, RodShape
from sysid.proof.truths.rod_laws import Bending, Table
from sysid.proof.truths.sensors import Clean

Array = np.ndarray

STOCKS = {
    "polyester film": (3.2e9, 4.8e9, 1370.0),
    "polypropylene sheet": (1.2e9, 1.9e9, 905.0),
    "thin card": (1.6e9, 2.6e9, 720.0),
}
"""Young's modulus from, to [Pa] and density [kg/m^3]."""

NAME = "strip_on_a_table"
DAMPING_RATIO = 0.015
COLUMNS, ROWS = 13, 2
STEP_S = 1e-3
KINDS = {
    "full": {
        "rec_01": "tilt",
        "rec_02": "shake",
        "rec_03": "slide",
        "rec_04": "press",
        "rec_05": "rub",
        "rec_06": "swing",
    },
    "fast": {"rec_01": "swing", "rec_02": "rub", "rec_03": "swing", "rec_04": "rub"},
}
HELD_OUT = {"full": ("rec_05", "rec_06"), "fast": ("rec_03", "rec_04")}


@dataclass(frozen=True)
class StripEffects:
    """What may be concealed in the strip, its contact and the air; the defaults conceal nothing.

    ``yield_per_m``, ``hardening``, ``branches`` (share, time constant), ``softening_per_m``, ``rest_per_m`` (curvature
    at rest), ``damping_factor``: see :class:`Bending`. ``jump``: factor of the stiffness beyond half the length;
    ``taper``: relative change of thickness from clamp to end. ``air``: drag coefficient; ``cushion``: see :class:`Rod`;
    ``tilt_rad``: of gravity about y; ``excess``: static over kinetic friction, less one.
    """

    yield_per_m: float = math.inf
    hardening: float = 0.2
    branches: tuple[tuple[float, float], ...] = ()
    softening_per_m: float = math.inf
    rest_per_m: float = 0.0
    damping_factor: float = 1.0
    jump: float = 1.0
    taper: float = 0.0
    air: float = 0.0
    cushion: float = 0.0
    tilt_rad: float = 0.0
    excess: float = 0.0


NOTHING = StripEffects()


@dataclass(frozen=True)
class Strip:
    """One strip on its stand. SI units; ``guess``: E, density and friction as the operator wrote them down."""

    stock: str
    length: float
    width: float
    thickness: float
    modulus: float
    density: float
    friction: float
    guess: dict[str, float]
    height: float
    camera: Pinhole
    levels: NoiseLevels

    @property
    def bending(self) -> float:
        """E w h^3 / 12 [N m^2]."""
        return self.modulus * self.width * self.thickness**3 / 12

    @property
    def mass_per_m(self) -> float:
        """Mass per length [kg/m]."""
        return self.density * self.width * self.thickness

    @property
    def frequency(self) -> float:
        """First natural frequency [Hz] of the cantilever."""
        return 1.875104**2 / (2 * math.pi * self.length**2) * math.sqrt(self.bending / self.mass_per_m)

    @property
    def markers(self) -> tuple[Array, Array]:
        """Arc lengths and places across [m], one of each a marker."""
        s = (np.arange(COLUMNS) + 0.75) / COLUMNS * self.length
        y = np.linspace(-0.4, 0.4, ROWS) * self.width
        return np.tile(s, ROWS), np.repeat(y, COLUMNS)


def draw_strip(rng: np.random.Generator) -> Strip:
    """A strip whose first frequency lies between 3 and 6 Hz."""
    stock = str(rng.choice(sorted(STOCKS)))
    low, high, density = STOCKS[stock]
    length, width, modulus = rng.uniform(0.10, 0.14), rng.uniform(0.02, 0.032), rng.uniform(low, high)
    density *= rng.uniform(0.97, 1.03)
    wanted = rng.uniform(3.2, 5.5)
    thickness = wanted * 2 * math.pi * length**2 / 1.875104**2 / math.sqrt(modulus / 12 / density)
    friction = rng.uniform(0.2, 0.4)
    length, width, thickness = round(length, 4), round(width, 4), round(thickness, 6)
    guess = {
        "E_pa": _digits(modulus * rng.uniform(0.75, 1.3)),
        "density_kg_m3": _digits(density * (1.0 + 0.04 * rng.uniform(-1, 1))),
        "friction": _digits(friction * rng.uniform(0.75, 1.3), 3),
    }
    weight = density * width * thickness * length * 9.81
    at = np.array([rng.uniform(-0.1, 0.05), -rng.uniform(0.5, 0.56), rng.uniform(0.28, 0.36)])
    towards = np.array([0.4 * length, 0.0, 0.16])
    camera = Pinhole(1050.0, (640.0, 480.0), (1280, 960), at, look_at(at, towards, np.array([0.0, 0.0, 1.0])))
    levels = nasty(0.04 * weight * rng.uniform(0.8, 1.5), 0.02, rng.uniform(0.08, 0.14))
    return Strip(
        stock, length, width, thickness, modulus, density, friction, guess, round(2.4 * length, 4), camera, levels
    )


def draw_path(rng: np.random.Generator, strip: Strip, kind: str) -> Path:
    """Path (x, z, angle) of the hand in one recording. Contact is made slowly and at a shallow angle, since the peak of
    an impact lasts a few milliseconds and depends on what no operator knows of a table."""
    if kind in ("slide", "rub", "press"):
        return _touching(rng, strip, kind)
    f1 = strip.frequency
    path = Path((0.0, strip.height, 0.0)).wait(rng.uniform(0.6, 0.8))
    if kind in ("tilt", "swing"):
        for sign in rng.permutation([1.0, -1.0])[: 2 if kind == "tilt" else 1]:
            tilt = float(sign) * rng.uniform(0.6, 1.1)
            path.move((0.0, 0.0, tilt), rng.uniform(0.7, 1.0)).wait(0.6).move((0.0, 0.0, -tilt), 0.8).wait(0.4)
    if kind in ("shake", "swing"):
        for _ in range(2 if kind == "shake" else 1):
            up = (0.0, rng.uniform(0.008, 0.014), 0.0) if rng.random() < 0.5 else (0.0, 0.0, rng.uniform(0.06, 0.12))
            path.shake(up, rng.uniform(0.4, 0.75) * f1, rng.uniform(1.2, 1.6)).wait(rng.uniform(0.4, 0.6))
    return path.wait(0.3)


def _touching(rng: np.random.Generator, strip: Strip, kind: str) -> Path:
    """Lower the end of the strip onto the table at about 8 mm/s, press, slide to and fro, go up, perhaps again."""
    angle, gap, depth = -rng.uniform(0.15, 0.45), rng.uniform(0.002, 0.004), rng.uniform(0.05, 0.12) * strip.length
    path = Path((0.0, hanging(strip, angle) + gap, angle)).wait(rng.uniform(0.6, 0.8))
    for _ in range(2 if kind == "press" else 1):
        down = gap + depth
        path.move((0.0, -down, 0.0), down / rng.uniform(0.007, 0.009)).wait(rng.uniform(0.3, 0.5))
        if kind != "press":
            way = rng.uniform(0.015, 0.03)
            for speed in rng.uniform(0.015, 0.05, 1 if kind == "rub" else 2):
                path.move((way, 0.0, 0.0), 1.5 * way / speed).wait(0.2)
                path.move((-way, 0.0, 0.0), 1.5 * way / speed).wait(0.2)
        path.move((0.0, down, 0.0), down / rng.uniform(0.012, 0.02)).wait(0.4)
    return path


def hanging(strip: Strip, angle: float) -> float:
    """How far below the hand the lowest point of the resting strip is [m]."""
    rod = StripTruth(strip).rod(lambda t: np.array([0.0, 0.0, angle]), touches=False)
    return -float(rod.settle().position[:, 1].min())


@dataclass
class StripTruth:
    """Simulates the recordings of one strip in their order: what yielded stays so."""

    strip: Strip
    effects: StripEffects = NOTHING
    arm: ArmFaults = RIGID
    elements: int = 60
    step_s: float = STEP_S
    _plastic: Array | None = None

    def run(self, path: Path) -> Clean:
        """One recording."""
        hand, measured = through(path, self.arm)
        rod = self.rod(hand)
        if self._plastic is not None:
            rod.bending.plastic = self._plastic
        states = [rod.settle()]
        count = round(path.end_s / self.step_s)
        t = self.step_s * np.arange(count + 1)
        states += [rod.step(float(at), self.step_s) for at in t[1:]]
        self._plastic = rod.bending.plastic
        angle = hand(t)[:, 2]
        force, moment = np.array([s.force for s in states]), np.array([s.moment for s in states])
        wrench = np.zeros((len(t), 6))
        wrench[:, 0] = np.cos(angle) * force[:, 0] + np.sin(angle) * force[:, 1]
        wrench[:, 2] = -np.sin(angle) * force[:, 0] + np.cos(angle) * force[:, 1]
        wrench[:, 4] = -moment
        markers = self._markers(np.array([s.position for s in states]))
        return Clean(t, wrench, markers, lambda at: poses(path(at)), lambda at: poses(measured(at)))

    def rod(self, hand: Callable[[float], Array], *, touches: bool = True) -> Rod:
        """The rod of this strip in the hand; ``touches``: above the table."""
        s, e = self.strip, self.effects
        thick: Callable[[Array], Array] = lambda u: 1.0 + e.taper * (u - 0.5)  # noqa: E731
        shape = RodShape(
            s.length, s.width,
            lambda u: s.mass_per_m * thick(u),
            lambda u: s.bending * thick(u) ** 3 * np.where(u > 0.5, e.jump, 1.0),
            self.elements,
        )  # fmt: skip
        damping = e.damping_factor * DAMPING_RATIO / (math.pi * s.frequency)
        gravity = (9.81 * math.sin(e.tilt_rad), -9.81 * math.cos(e.tilt_rad))
        table = Table(s.friction, e.excess) if touches else None

        def bending(stiffness: Array) -> Bending:
            return Bending(
                stiffness, damping, e.rest_per_m, e.yield_per_m, e.hardening, e.branches, e.softening_per_m
            )  # fmt: skip

        return Rod(shape, bending, hand, gravity=gravity, table=table, air=e.air, cushion=e.cushion)

    def _markers(self, nodes: Array) -> Array:
        """Places of the markers in the base frame [m], on cubic pieces between the nodes."""
        s, y = self.strip.markers
        along = CubicSpline(np.linspace(0.0, self.strip.length, nodes.shape[1]), nodes, axis=1)(s)
        return np.stack([along[..., 0], np.broadcast_to(y, along.shape[:2]), along[..., 1]], axis=-1)


def poses(coordinates: Array) -> tuple[Array, Array]:
    """Positions and quaternions of the hand's frame: x along the strip, y across, from (x, z, angle)."""
    x, z, angle = np.moveaxis(np.asarray(coordinates), -1, 0)
    zero = np.zeros_like(x)
    position = np.stack([x, zero, z], axis=-1)
    return position, np.stack([zero, -np.sin(angle / 2), zero, np.cos(angle / 2)], axis=-1)


def rig(strip: Strip, name: str, *, values: dict[str, float] | None = None) -> dict[str, Any]:
    """The rig file. ``values``: E, density and friction, by default the operator's guess."""
    v = values or strip.guess
    cells = 16
    behind = strip.length / cells
    s, y = strip.markers
    frequency = strip.frequency
    camera = strip.camera
    return {
        "name": name,
        "description": "A strip clamped in a gripper that tilts, shakes, lowers and slides it on a table.",
        "gravity_m_s2": [0.0, 0.0, -9.81],
        "solver": {"dt_s": 0.005, "inertia": True, "integrator": "bdf2"},
        "bodies": {
            "strip": {
                "type": "sheet",
                "shape": {
                    "type": "rectangle",
                    "length_m": strip.length + behind,
                    "width_m": strip.width,
                    "cells": [cells + 1, 1],
                    "pattern": "crossed",
                },
                "pose": {"position_m": [0.5 * (strip.length - behind), 0.0, strip.height]},
                "material": {
                    "E_pa": v["E_pa"],
                    "nu": 0.0,
                    "thickness_m": strip.thickness,
                    "density_kg_m3": v["density_kg_m3"],
                    "stiffness_damping_s": _digits(DAMPING_RATIO / (math.pi * frequency)),
                },
            },
            "table": {"type": "rigid", "shape": {"type": "plane"}, "pose": {"position_m": [0.0, 0.0, 0.0]}},
        },
        "clamps": [
            {
                "name": "jaws",
                "body": "strip",
                "region": {"x_m": [-0.5 * (strip.length + behind), -0.5 * (strip.length - behind)]},
                "mount": "gripper",
            }
        ],
        "end_effectors": {
            "gripper": {
                "start": {"position_m": [0.0, 0.0, strip.height]},
                "offset_sd_m": [0.0002] * 3,
                "offset_sd_deg": [0.1] * 3,
                "topics": {"target_pose": "target_pose", "current_pose": "current_pose"},
            }
        },
        "contacts": [{"between": ["strip", "table"], "friction": v["friction"]}],
        "sensors": {
            "wrist": {"type": "wrench", "on": "gripper", "frame_id": "ee_frame", "rate_hz": 100.0, "topic": "wrench"}
        },
        "cameras": {
            "outside": {
                "model": "pinhole",
                "width_px": camera.size[0],
                "height_px": camera.size[1],
                "fx_px": camera.focal,
                "fy_px": camera.focal,
                "cx_px": camera.centre[0],
                "cy_px": camera.centre[1],
                "pose": {
                    "position_m": [float(v) for v in camera.position],
                    "quaternion_xyzw": [float(v) for v in quaternion(camera.rotation)],
                },
                "rate_hz": 30.0,
                "frame_id": "camera_optical_frame",
                "topics": {"marker_tracks": "marker_tracks", "camera_info": "camera_info"},
                "sees": [
                    {
                        "body": "strip",
                        "points": {
                            "positions_m": [
                                [float(a - 0.5 * (strip.length - behind)), float(b), 0.0]
                                for a, b in zip(s, y, strict=True)
                            ],
                            "ids": list(range(len(s))),
                        },
                    }
                ],
            }
        },
    }


def setup(strip: Strip, recordings: list[str]) -> dict[str, Any]:
    """What the operator wrote down."""
    s, y = strip.markers
    return {
        "description": (
            f"A flat strip of {strip.stock} is clamped along one short edge in a gripper and hangs free above a table, "
            "the plane z = 0. ee_frame: origin at the middle of the clamp line, x along the strip as it leaves the "
            "clamp, y along the width. All motion is in the x-z plane of base_link, z up. The wrench is what acts on "
            "the sensor, about the origin of ee_frame in its axes, tared, the mean over 10 ms around its stamp. The "
            "strip was clamped once; the recordings follow each other in this order."
        ),
        "recordings": recordings,
        "gravity": [0.0, 0.0, -9.81],
        "sheet": {
            "free_length_m": strip.length,
            "width_m": strip.width,
            "thickness_m": strip.thickness,
            "young_modulus_pa": {"guess": strip.guess["E_pa"], "within": "30 %"},
            "density_kg_m3": {"weighed": strip.guess["density_kg_m3"], "within": "4 %"},
            "poisson_ratio": 0.0,
            "damping_ratio_first_mode": {"rough": DAMPING_RATIO},
        },
        "table": {"height_m": 0.0, "friction": {"guess": strip.guess["friction"], "within": "30 %"}},
        "markers": {"s_m": s.round(6).tolist(), "y_m": y.round(6).tolist(), "id": "place in these lists"},
    }


def marker_count(strip: Strip) -> int:
    """Number of markers."""
    return len(strip.markers[0])


def quaternion(rotation: Array) -> Array:
    """Quaternion x y z w of a rotation matrix."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat())


def _digits(value: float, digits: int = 4) -> float:
    return float(f"{value:.{digits}g}")
