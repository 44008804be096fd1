"""A soft pad under a rigid ball: what is drawn, how the ball is moved, what the layer does, what the operator knows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.fft import next_fast_len
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import map_coordinates

from sysid.proof.truths.arm import RIGID, ArmFaults, Motion, through
from sysid.proof.truths.ball import Ball, BallLaws
from sysid.proof.truths.camera import Pinhole
from sysid.proof.truths.layer import Layer, Surface
from sysid.proof.truths.noise import NoiseLevels, nasty
from sysid.proof.truths.paths import Path
from sysid.proof.truths.sensors import Clean

Array = np.ndarray

NAME = "gel_under_a_ball"
SIDE = 11
"""Markers along a side of their square."""

STEP_S, REST_STEP_S, OUTPUT_S = 0.025, 0.1, 0.005
"""Time steps while the ball moves and while it rests; what sensors read is interpolated to every ``OUTPUT_S``."""

KINDS = {
    "full": {"rec_01": "press", "rec_02": "slide", "rec_03": "slow press", "rec_04": "cross slide", "rec_05": "press"},
    "fast": {"rec_01": "press", "rec_02": "slide", "rec_03": "slide"},
}
HELD_OUT = {"full": ("rec_04", "rec_05"), "fast": ("rec_03",)}


@dataclass(frozen=True)
class Pad:
    """One pad, ball and camera. SI units; ``origin``: centre of the free surface in the base frame; ``guess``: E, nu
    and friction as the operator wrote them down; ``depth``: of a typical press."""

    thickness: float
    modulus: float
    poisson: float
    friction: float
    radius: float
    depth: float
    origin: Array
    guess: dict[str, float]
    camera: Pinhole
    pitch: float
    levels: NoiseLevels

    @property
    def layer(self) -> Layer:
        """The pad as an infinite layer."""
        return Layer(self.thickness, 0.5 * self.modulus / (1.0 + self.poisson), self.poisson)

    @property
    def markers(self) -> Array:
        """Places on the free surface from its centre [m], shape ``(m, 2)``, along x first."""
        line = (np.arange(SIDE) - 0.5 * (SIDE - 1)) * self.pitch
        return np.stack([np.tile(line, SIDE), np.repeat(line, SIDE)], axis=-1)


def draw_pad(rng: np.random.Generator) -> Pad:
    """A pad of 7 to 10 mm, pressed by 2 to 3.5 % of that, so that a linear layer is a fair truth."""
    thickness, radius = round(rng.uniform(7e-3, 10e-3), 5), round(rng.uniform(15e-3, 22e-3), 4)
    modulus, poisson = rng.uniform(1.2e5, 4e5), rng.uniform(0.42, 0.48)
    friction, depth = rng.uniform(0.2, 0.45), rng.uniform(0.022, 0.034) * thickness
    origin = np.array([rng.uniform(0.3, 0.5), rng.uniform(-0.1, 0.1), rng.uniform(0.05, 0.15)]).round(3)
    below = round(rng.uniform(0.016, 0.022), 4)
    camera = Pinhole(
        round(rng.uniform(700.0, 800.0), 1), (320.0, 240.0), (640, 480),
        origin - [0.0, 0.0, thickness + below], np.eye(3),
    )  # fmt: skip
    guess = {
        "E_pa": float(f"{modulus * rng.uniform(0.75, 1.3):.3g}"),
        "nu": round(poisson + rng.uniform(-0.02, 0.015), 3),
        "friction": round(friction * rng.uniform(0.75, 1.3), 3),
    }
    force = float(1.3 * 4 / 3 * modulus / (1 - poisson**2) * np.sqrt(radius) * depth**1.5)
    levels = nasty(0.008 * force * rng.uniform(0.8, 1.3), 0.005, rng.uniform(0.06, 0.1), pose_m=1e-6)
    return Pad(
        thickness, modulus, poisson, friction, radius, depth, origin, guess, camera,
        round(0.09 * thickness + 0.6e-3, 5), levels,
    )  # fmt: skip


def draw_path(rng: np.random.Generator, pad: Pad, kind: str) -> Path:
    """Path (x, y, z) of the lowest point of the ball from the centre of the free surface."""
    gap = 0.2 * pad.depth
    x, y = rng.uniform(-8e-4, 8e-4, 2)
    path = Path((x, y, gap)).wait(rng.uniform(0.6, 0.8))
    presses = {"press": (0.3, 0.6), "slow press": (1.2,), "slide": (0.4,), "cross slide": (0.5,)}[kind]
    for seconds in presses:
        down = gap + pad.depth * rng.uniform(0.75, 1.15)
        path.move((0.0, 0.0, -down), seconds * rng.uniform(0.8, 1.2)).wait(rng.uniform(0.4, 0.8))
        if "slide" in kind:
            way = rng.uniform(1.0e-3, 1.8e-3)
            turn = rng.uniform(0.0, 2 * np.pi) if kind == "cross slide" else rng.choice([0.0, np.pi])
            by = (way * np.cos(turn), way * np.sin(turn), 0.0)
            seconds = 1.9 * way / rng.uniform(2e-3, 4e-3)
            path.move(by, seconds).wait(0.3).move((-by[0], -by[1], 0.0), seconds).wait(0.3)
        path.move((0.0, 0.0, down), 0.4).wait(rng.uniform(0.4, 0.6))
    return path


@dataclass
class PadTruth:
    """Simulates recordings of one pad. ``pitch_share``: distance of the points as a share of the radius of contact of a
    typical press."""

    pad: Pad
    laws: BallLaws | None = None
    arm: ArmFaults = RIGID
    pitch_share: float = 0.12

    def _surface(self, where: Array) -> Surface:
        """A patch that the contact does not leave while the ball is at the places ``where``, ``(n, 3)``."""
        pad = self.pad
        pitch = self.pitch_share * np.sqrt(pad.radius * pad.depth)
        contact = 1.25 * np.sqrt(pad.radius * max(-where[:, 2].min(), pad.depth))
        points = next_fast_len(int(np.ceil((2 * contact + np.ptp(where[:, :2], axis=0).max()) / pitch)))
        period = 2 * next_fast_len(int(np.ceil(3.2 * pad.thickness / pitch + points / 2)), real=True)
        return Surface(pad.layer, points, pitch, period + points % 2)

    def run(self, path: Path) -> Clean:
        """One recording."""
        hand, measured = through(path, self.arm)
        rest_step = 0.5 * REST_STEP_S if self.laws and self.laws.branches else REST_STEP_S
        t = _times(hand, path.end_s, rest_step)
        where = hand(t)
        middle = np.append(0.5 * (where[:, :2].min(axis=0) + where[:, :2].max(axis=0)), 0.0)
        surface = self._surface(where)
        compliance = np.array(self.arm.compliance or np.zeros((3, 3)))
        ball = Ball(surface, self.pad.radius, self.laws or BallLaws(self.pad.friction), compliance)
        forces, moved = np.zeros((len(t), 6)), np.zeros((len(t), SIDE * SIDE, 3))
        area = surface.pitch**2
        places = np.stack([surface.x + middle[0], surface.y + middle[1]])
        for k, at in enumerate(where):
            traction = ball.step(at - middle, t[k] - t[k - 1] if k else OUTPUT_S)
            forces[k, :3] = traction.sum(axis=(1, 2)) * area
            forces[k, 3] = (places[1] * traction[2]).sum() * area
            forces[k, 4] = -(places[0] * traction[2]).sum() * area
            forces[k, 5] = (places[0] * traction[1] - places[1] * traction[0]).sum() * area
            if ball.pulled.any():
                moved[k] = self._at_markers(surface, surface.everywhere(ball.pulled), middle)
        fine = np.arange(round(path.end_s / OUTPUT_S) + 1) * OUTPUT_S
        rest = np.column_stack([self.pad.markers, np.zeros(SIDE * SIDE)]) + self.pad.origin
        markers = rest + PchipInterpolator(t, moved, axis=0)(np.minimum(fine, t[-1]))

        wrench = PchipInterpolator(t, forces, axis=0)(np.minimum(fine, t[-1]))
        return Clean(fine, wrench, markers, lambda at: self._poses(path(at)), lambda at: self._poses(measured(at)))

    def _poses(self, places: Array) -> tuple[Array, Array]:
        """Poses of the ball's lowest point in the base frame."""
        return self.pad.origin + places, np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(places), 4))

    def _at_markers(self, surface: Surface, moved: Array, middle: Array) -> Array:
        """Displacements of the markers [m], ``(m, 3)``, by cubic interpolation."""
        place = (self.pad.markers - middle[:2]) / surface.pitch + 0.5 * (surface.period - 1)
        return np.stack([map_coordinates(f, place.T, order=3, mode="grid-wrap") for f in moved], axis=-1)


def _times(hand: Motion, end: float, rest_step: float) -> Array:
    """Instants of the steps: dense while the hand moves, sparse while it rests."""
    t = [0.0]
    while t[-1] < end - 1e-9:
        moved = np.abs(hand(min(t[-1] + STEP_S, end)) - hand(t[-1])).max()
        t.append(min(t[-1] + (rest_step if moved < 1e-9 else STEP_S), end))
    return np.array(t)


def rig(pad: Pad, name: str, *, values: dict[str, float] | None = None) -> dict[str, Any]:
    """The rig file. ``values``: E, nu and friction, by default the operator's guess."""
    v = values or pad.guess
    size, h = 6.0 * pad.thickness, pad.thickness
    camera = pad.camera
    return {
        "name": name,
        "description": "A rigid ball is pressed on a bonded gel pad and slid over it; a camera looks from below.",
        "gravity_m_s2": [0.0, 0.0, 0.0],
        "solver": {"dt_s": 0.05, "inertia": False},
        "bodies": {
            "gel": {
                "type": "gel",
                "shape": {
                    "type": "block",
                    "size_m": [size, size, h],
                    "cells": [12, 12, 4],
                    "graded": [
                        {"towards": "x_middle", "ratio": 0.2},
                        {"towards": "y_middle", "ratio": 0.2},
                        {"towards": "top", "ratio": 0.4},
                    ],
                },
                "pose": {"position_m": [*pad.origin[:2].tolist(), float(pad.origin[2] - 0.5 * h)]},
                "material": {"E_pa": v["E_pa"], "nu": v["nu"], "density_kg_m3": 1000.0},
                "bonded": "bottom",
                "mount": "world",
            },
            "ball": {
                "type": "rigid",
                "shape": {"type": "sphere", "radius_m": pad.radius},
                "pose": {"position_m": [0.0, 0.0, pad.radius]},
                "mount": "hand",
            },
        },
        "end_effectors": {
            "hand": {
                "base_frame": "base_link",
                "start": {"position_m": [*pad.origin[:2].tolist(), float(pad.origin[2] + 0.002)]},
                "offset_sd_m": [0.00005] * 3,
                "topics": {"target_pose": "target_pose", "current_pose": "current_pose"},
            }
        },
        "contacts": [{"between": ["gel", "ball"], "friction": v["friction"], "range_m": 2e-6}],
        "sensors": {
            "wrench": {
                "type": "wrench",
                "on": "gel",
                "frame_id": "gel_frame",
                "pose": {"position_m": [0.0, 0.0, 0.5 * h]},
                "rate_hz": 100.0,
                "topic": "wrench",
            }
        },
        "cameras": {
            "below": {
                "model": "pinhole",
                "width_px": camera.size[0],
                "height_px": camera.size[1],
                "fx_px": camera.focal,
                "fy_px": camera.focal,
                "cx_px": camera.centre[0],
                "cy_px": camera.centre[1],
                "pose": {"position_m": [float(c) for c in camera.position]},
                "rate_hz": 30.0,
                "frame_id": "gel_camera_optical_frame",
                "topics": {"marker_tracks": "marker_tracks", "camera_info": "camera_info"},
                "sees": [
                    {
                        "body": "gel",
                        "points": {
                            "positions_m": [[float(a), float(b), 0.5 * h] for a, b in pad.markers],
                            "ids": list(range(SIDE * SIDE)),
                        },
                    }
                ],
            }
        },
    }


def setup(pad: Pad, recordings: list[str]) -> dict[str, Any]:
    """What the operator wrote down."""
    return {
        "description": (
            "A soft pad, wide compared with its thickness, is bonded to a rigid transparent plate; its top is free. A "
            "robot presses a polished ball on it and slides it; the frame of the end effector is at the lowest point "
            "of the ball, which does not turn. gel_frame: origin at the centre of the free surface, axes as base_link. "
            "The wrench is what acts on the gel, about the origin of gel_frame, the mean over 10 ms around its stamp. "
            "Refraction is taken out. The recordings follow each other in this order."
        ),
        "recordings": recordings,
        "gel": {
            "frame_in_base_m": pad.origin.tolist(),
            "thickness_m": pad.thickness,
            "lateral_size": "large",
            "young_modulus_pa": {"guess": pad.guess["E_pa"], "within": "30 %"},
            "poisson_ratio": {"guess": pad.guess["nu"], "within": "0.02"},
        },
        "ball": {"radius_m": pad.radius, "friction": {"guess": pad.guess["friction"], "within": "30 %"}},
        "markers": {"rows": SIDE, "columns": SIDE, "pitch_m": pad.pitch, "id": "row * columns + column, along x first"},
        "camera": {"focal_px": pad.camera.focal, "below_surface_m": float(pad.origin[2] - pad.camera.position[2])},
    }


def marker_count(pad: Pad) -> int:
    """Number of markers."""
    return len(pad.markers)
