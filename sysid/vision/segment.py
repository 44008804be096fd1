"""From a camera image to a mask of marker pixels: binary images, and dots on a grey or coloured ground."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sim_core.errors import RecordingError

Image = NDArray[np.uint8]

_SCALES_PX = (3.0, 4.5, 6.5, 9.5, 14.0, 20.0, 29.0, 42.0)
"""Dot diameters [px] tried when the size is not known."""


@dataclass(frozen=True)
class Segmentation:
    """Marker pixels of one image."""

    mask: Image
    """255 on marker pixels, 0 elsewhere, shape ``(height, width)``."""
    weight: NDArray[np.float32]
    """Weight of each pixel in a centroid, shape ``(height, width)``; 1 on a binary image, contrast else."""
    binary: bool
    """True when the image itself was black and white."""
    contrast: float
    """Strength of the dots over the noise of the ground; infinite for a binary image."""


def to_grey(image: NDArray[np.generic]) -> Image:
    """Return an 8-bit grey image of shape ``(height, width)``; 16-bit and float images are rescaled."""
    array = np.asarray(image)
    if array.ndim not in (2, 3) or array.size == 0:
        raise RecordingError(
            f"An image has shape {array.shape}, expected (height, width) or (height, width, channels).",
            "Check the image topic and its encoding.",
        )
    if array.dtype != np.uint8:
        values = np.nan_to_num(array.astype(np.float64))
        low, high = float(values.min()), float(values.max())
        array = ((values - low) * (255.0 / max(high - low, 1e-12))).astype(np.uint8)
    if array.ndim == 3:
        if array.shape[2] == 1:
            array = array[:, :, 0]
        else:
            array = cv2.cvtColor(np.ascontiguousarray(array[:, :, :3]), cv2.COLOR_RGB2GRAY)
    return np.ascontiguousarray(array)


def is_binary(grey: Image) -> bool:
    """Tell whether at least 98 % of the pixels sit at the two ends of the range, also along the rims of what is drawn:
    of smooth dots on an even ground, few as they are, the pixels between the ends are those of the rims."""
    low, high = int(grey.min()), int(grey.max())
    if high - low < 32:
        return False
    margin = 0.1 * (high - low)
    between = (grey > low + margin) & (grey < high - margin)
    if np.mean(between) > 0.02:
        return False
    bright = (grey > 0.5 * (low + high)).astype(np.uint8)
    rim = cv2.morphologyEx(bright, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    return bool(np.count_nonzero(between & rim) <= 0.02 * np.count_nonzero(rim))


def segment(grey: Image, *, polarity: str, diameter_px: float | None) -> Segmentation:
    """Separate dots from ground.

    ``polarity`` is ``bright``, ``dark`` or ``auto``; auto takes the colour that covers less of a binary
    image, and the stronger dots of a grey one. ``diameter_px`` is the dot size [px], None to estimate it.
    """
    if is_binary(grey):
        threshold = 0.5 * (float(grey.min()) + float(grey.max()))
        bright = grey > threshold
        if polarity == "dark" or (polarity == "auto" and bright.mean() > 0.5):
            bright = ~bright
        mask = bright.astype(np.uint8) * 255
        return Segmentation(mask, np.ones(grey.shape, np.float32), True, float("inf"))
    return _segment_grey(grey, polarity, diameter_px)


def _segment_grey(grey: Image, polarity: str, diameter_px: float | None) -> Segmentation:
    image = grey.astype(np.float32)
    signs = {"bright": (1.0,), "dark": (-1.0,), "auto": (-1.0, 1.0)}[polarity]
    scales = _SCALES_PX if diameter_px is None else (diameter_px,)
    best: tuple[float, NDArray[np.float32], float] | None = None
    for diameter in scales:
        if diameter > 0.2 * min(grey.shape):
            continue
        for sign in signs:
            response = _blob_response(image, diameter) * np.float32(sign)
            strength = float(np.mean(np.sort(response, axis=None)[-max(20, response.size // 100) :]))
            if best is None or strength > best[0]:
                best = (strength, response, diameter)
    if best is None:
        return Segmentation(np.zeros_like(grey), np.ones(grey.shape, np.float32), False, 0.0)
    _, response, diameter = best
    sign = 1.0 if float(np.corrcoef(response.ravel()[::7], image.ravel()[::7])[0, 1]) >= 0 else -1.0
    if polarity != "auto":
        sign = signs[0]
    size = 2 * round(1.5 * diameter) + 1
    ground = cv2.medianBlur(grey, size) if size <= 255 else cv2.blur(grey, (size, size))
    over = np.float32(sign) * (cv2.GaussianBlur(image, (0, 0), 0.8) - ground.astype(np.float32))
    noise = 1.4826 * float(np.median(np.abs(response - np.median(response)))) + 1e-6
    level = _dot_level(over, response, diameter)
    beyond = np.clip(over - max(0.5 * level, 4.0), 0.0, None)
    mask = (beyond > 0.0).astype(np.uint8) * 255
    return Segmentation(mask, beyond, False, float(response.max()) / noise)


def _blob_response(image: NDArray[np.float32], diameter: float) -> NDArray[np.float32]:
    """Return a difference of Gaussians matched to a disc of this diameter, positive on bright discs."""
    sigma = diameter / (2.0 * np.sqrt(2.0))
    wide = cv2.GaussianBlur(image, (0, 0), 1.6 * sigma)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma) - wide, dtype=np.float32)


def _dot_level(over: NDArray[np.float32], response: NDArray[np.float32], diameter: float) -> float:
    """Return the median contrast [grey levels] at the local peaks of the blob response."""
    reach = 2 * round(0.5 * diameter) + 1
    peaks = response >= cv2.dilate(response, np.ones((reach, reach), np.uint8))
    strong = peaks & (response > 0.4 * np.percentile(response[peaks], 98))
    return float(np.median(over[strong])) if strong.any() else 255.0
