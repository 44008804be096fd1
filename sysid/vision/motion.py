"""What a marker pattern did as a whole, and how well poses explain it: a check that tracks are right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_core.errors import RecordingError
from sysid.vision.check import signed_areas, triangles_of
from sysid.vision.field import Points


@dataclass(frozen=True)
class PatternMotion:
    """Motion of the whole pattern against its reference, one row a frame; NaN where nothing was found."""

    displacement_px: NDArray[np.float64]
    """Mean displacement of the markers [px], shape ``(n, 2)``."""
    rotation_rad: NDArray[np.float64]
    """Rotation around the contact [rad], positive from ``u`` to ``v`` (clockwise to the eye), ``(n,)``."""
    expansion: NDArray[np.float64]
    """Mean relative growth of area, shape ``(n,)``."""
    contact_px: NDArray[np.float64]
    """Centre of the stretched markers in the reference [px], shape ``(n, 2)``: where the skin is pressed."""

    def table(self) -> NDArray[np.float64]:
        """Return columns displacement u, v, rotation, expansion, contact u, v, shape ``(n, 6)``."""
        parts = [self.displacement_px, self.rotation_rad[:, None], self.expansion[:, None], self.contact_px]
        return np.concatenate(parts, axis=1)


MOTION_NAMES = ("displacement_u", "displacement_v", "rotation", "expansion", "contact_u", "contact_v")


def pattern_motion(reference: Points, uv: NDArray[np.float64]) -> PatternMotion:
    """Summarise the displacements of markers ``uv`` ``(n, m, 2)`` from ``reference`` ``(m, 2)``, both [px].

    Lost markers (NaN) are left out. Displacement is the mean of all markers; rotation that of the markers
    within 0.4 pattern radii of the contact, because the rim of a skin is held and does not turn.
    """
    frames = len(uv)
    shift, turn = np.full((frames, 2), np.nan), np.full(frames, np.nan)
    growth, contact = np.full(frames, np.nan), np.full((frames, 2), np.nan)
    corners = triangles_of(reference)
    area = signed_areas(reference, corners)
    middle = reference[corners].mean(axis=1)
    centre = reference.mean(axis=0)
    reach = 0.4 * float(np.linalg.norm(reference - centre, axis=1).max())
    for k, frame in enumerate(uv):
        seen = np.isfinite(frame[:, 0])
        whole = seen[corners].all(axis=1)
        if seen.sum() < 4 or whole.sum() < 2:
            continue
        shift[k] = (frame - reference)[seen].mean(axis=0)
        stretch = signed_areas(frame, corners[whole]) / area[whole] - 1.0
        growth[k] = float(np.average(stretch, weights=np.abs(area[whole])))
        weight = np.clip(stretch, 0.0, None) * np.abs(area[whole])
        if weight.sum() > 0.0:
            contact[k] = weight @ middle[whole] / weight.sum()
        around = contact[k] if np.isfinite(contact[k, 0]) else centre
        near = seen & (np.linalg.norm(reference - around, axis=1) < reach)
        if near.sum() >= 4:
            arm = reference[near] - reference[near].mean(axis=0)
            moved = (frame - reference)[near] - (frame - reference)[near].mean(axis=0)
            swing = arm[:, 0] * moved[:, 1] - arm[:, 1] * moved[:, 0]
            turn[k] = float(swing.sum() / (arm**2).sum())
    return PatternMotion(shift, turn, growth, contact)


@dataclass(frozen=True)
class PoseCheck:
    """How well the poses explain the motion of the pattern on frames that were not used for the fit."""

    r_squared: dict[str, float]
    """Explained part of the variance on held-out frames for each motion: 1 is all, 0 is none."""
    coefficients: dict[str, dict[str, float]]
    """Slope of each motion for each pose component: px, rad or 1 for each m or rad."""
    frames: tuple[int, int]
    """Frames fitted and frames held out."""


POSE_NAMES = ("x", "y", "z", "rx", "ry", "rz")


def explain_by_poses(
    motion: PatternMotion,
    poses: NDArray[np.float64],
    held_out: NDArray[np.bool_],
    *,
    depth: int | None = None,
) -> PoseCheck:
    """Fit the motion by least squares as a linear function of the poses, and test it on held-out frames.

    Main arguments: ``poses`` are x, y, z [m] and three small angles [rad], shape ``(n, 6)``; ``held_out``
    marks the test frames, ``(n,)``. Other arguments: ``depth`` is the column of ``poses`` that says how
    deep the press is; its products with the others are then regressors too, since a light press slips and
    passes on less of a slide than a deep one.
    """
    usable = np.isfinite(poses).all(axis=1)
    mean = poses[usable].mean(axis=0) if usable.any() else np.zeros(6)
    regressors = [np.ones(len(poses)), *(poses - mean).T]
    if depth is not None:
        regressors += [(poses - mean)[:, depth] * (poses - mean)[:, k] for k in range(6)]
    basis = np.stack(regressors, axis=1)
    if min(np.sum(usable & ~held_out), np.sum(usable & held_out)) < 2 * basis.shape[1]:
        raise RecordingError(
            f"{int(usable.sum())} frames with poses are too few to fit and test {basis.shape[1]} numbers.",
            "Leave the pose check out, or give a longer recording.",
        )
    scale = np.maximum(np.abs(basis[usable]).max(axis=0), 1e-12)
    r_squared, coefficients = {}, {}
    for name, values in zip(MOTION_NAMES, motion.table().T, strict=True):
        fit = usable & ~held_out & np.isfinite(values)
        test = usable & held_out & np.isfinite(values)
        slope = np.linalg.lstsq(basis[fit] / scale, values[fit], rcond=1e-9)[0] / scale
        missed = np.sum((values[test] - basis[test] @ slope) ** 2)
        r_squared[name] = float(1.0 - missed / max(np.sum((values[test] - values[test].mean()) ** 2), 1e-30))
        coefficients[name] = dict(zip(POSE_NAMES, map(float, slope[1:7]), strict=True))
    return PoseCheck(r_squared, coefficients, (int((usable & ~held_out).sum()), int((usable & held_out).sum())))


@dataclass(frozen=True)
class SlideSign:
    """Which way a pad went along a plate, seen from its own markers."""

    alignment: float
    """Cosine between the pads' motion that the images show and the labelled one, -1..1."""
    twist: float
    """Rotation of the pad that the images show per labelled rotation; its sign matters, its size is slip."""
    upright: bool
    """True when the image is not mirrored for a camera that looks along positive depth."""
    roll_rad: float
    """Where the pad's x points in an upright image: angle from ``u`` towards ``v``."""

    def __str__(self) -> str:
        """Say it in words."""
        slide = "plus" if self.alignment > 0.0 else "minus"
        twist = "plus" if self.twist > 0.0 else "minus"
        sure = "clear" if abs(self.alignment) > 0.9 else "not clear"
        return (
            f"the pad slid by {slide} the labelled slide (alignment {self.alignment:+.3f}, {sure}) "
            f"and turned by {twist} the labelled twist (slope {self.twist:+.2f})"
        )


def slide_sign(check: PoseCheck) -> SlideSign:
    """Tell the sense of labelled slides x, y and twist rz of a domed pad pressed along +z on a flat plate.

    The camera's orientation is not known, but the labelled tilts rx, ry show it: the pad touches where its
    dome points into the plate, at ``(-ry, rx)`` times its radius in its own frame. With ``C`` that map into
    the image, markers held by the plate move by ``-C s`` when the pad slides by ``s``, and turn by minus
    the twist when ``det C > 0``.
    """
    slopes = check.coefficients
    camera = np.array([[-slopes[name]["ry"], slopes[name]["rx"]] for name in ("contact_u", "contact_v")])
    markers = np.array([[slopes[name][axis] for axis in "xy"] for name in ("displacement_u", "displacement_v")])
    size = max(float(np.linalg.norm(camera) * np.linalg.norm(markers)), 1e-30)
    upright = bool(np.linalg.det(camera) > 0.0)
    twist = -slopes["rotation"]["rz"] * (1.0 if upright else -1.0)
    roll = float(np.arctan2(camera[1, 0] - camera[0, 1], camera[0, 0] + camera[1, 1]))
    return SlideSign(float(-np.sum(camera * markers) / size), twist, upright, roll)
