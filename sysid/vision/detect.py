"""Detection of markers (pins, printed dots) in one image, with subpixel centroids."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from sim_core.errors import ConfigError
from sysid.vision.segment import Segmentation, segment, to_grey

POLARITIES = ("auto", "bright", "dark")


@dataclass(frozen=True)
class DetectionParameters:
    """What counts as a marker. All sizes are relative to the typical marker of the same image."""

    polarity: str = "auto"
    """``bright`` dots, ``dark`` dots, or ``auto``."""
    diameter_px: float | None = None
    """Typical marker diameter [px]; None estimates it from each image."""
    typical_area_px2: float | None = None
    """Area of the typical marker as it is segmented [px^2]; None: of its diameter, or estimated from each image."""
    min_area_ratio: float = 0.25
    """Smallest area kept, as a part of the typical area."""
    max_area_ratio: float = 1.65
    """Largest area of one marker; a larger blob is taken apart, as a multiple of the typical area."""
    max_merged: int = 6
    """A blob of more markers than this is not a group of markers, and is dropped."""
    max_elongation: float = 3.0
    """Largest ratio of a blob's axes."""
    min_solidity: float = 0.7
    """Smallest ratio of a single blob's area to the area of its convex hull."""
    min_contrast: float = 6.0
    """Smallest strength of the dots over the noise of the ground; grey images only."""
    min_markers: int = 6
    """Fewer dots of one size than this are specks, not a marker pattern; grey images only."""

    def __post_init__(self) -> None:
        """Reject values that cannot work."""
        if self.polarity not in POLARITIES:
            raise ConfigError(
                f"polarity is {self.polarity!r}, expected one of {', '.join(POLARITIES)}.",
                "Use auto unless bright and dark dots are both in the picture.",
            )
        if self.diameter_px is not None and not 2.0 <= self.diameter_px <= 200.0:
            raise ConfigError(
                f"diameter_px is {self.diameter_px}, expected 2 to 200 px.",
                "Leave it out to have it estimated from the image.",
            )
        if not 0.0 < self.min_area_ratio < 1.0 < self.max_area_ratio:
            raise ConfigError(
                f"min_area_ratio {self.min_area_ratio} and max_area_ratio {self.max_area_ratio} must lie "
                "on either side of 1.",
                "The defaults are 0.25 and 1.65.",
            )


@dataclass(frozen=True)
class Detections:
    """Markers found in one image; all arrays have one row a marker."""

    uv: NDArray[np.float64]
    """Centroids [px], ``u`` to the right and ``v`` down, pixel centres at integers, shape ``(n, 2)``."""
    area_px2: NDArray[np.float64]
    """Areas [px^2], shape ``(n,)``."""
    quality: NDArray[np.float64]
    """How much each blob looks like one whole marker, 0..1, shape ``(n,)``."""
    merged: NDArray[np.bool_]
    """True where the marker was cut out of a blob that touched others, shape ``(n,)``."""
    image_size: tuple[int, int]
    """Width and height [px]."""
    typical_area_px2: float
    """Area of the typical marker [px^2]; 0 when there is none."""
    note: str = field(default="")
    """Why nothing was found, in words; empty when all is well."""

    def __len__(self) -> int:
        """Return the number of markers."""
        return len(self.uv)

    @property
    def diameter_px(self) -> float:
        """Diameter of the typical marker [px]."""
        return 2.0 * float(np.sqrt(self.typical_area_px2 / np.pi))


def detect_markers(image: NDArray[np.generic], parameters: DetectionParameters | None = None) -> Detections:
    """Find the markers of one image.

    The image is grey ``(height, width)`` or RGB ``(height, width, 3)``. An image without markers gives an
    empty result whose ``note`` says why; it is no error, because a recording may have such frames.
    """
    parameters = parameters or DetectionParameters()
    grey = to_grey(image)
    size = (grey.shape[1], grey.shape[0])
    if int(grey.max()) - int(grey.min()) < 8:
        return _nothing(size, f"the image is uniform (grey {int(grey.min())} to {int(grey.max())})")
    found = segment(grey, polarity=parameters.polarity, diameter_px=parameters.diameter_px)
    if found.contrast < parameters.min_contrast:
        return _nothing(size, f"the strongest dots are {found.contrast:.1f} times the noise of the ground")
    count, labels, stats, _ = cv2.connectedComponentsWithStats(found.mask, connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA].astype(float)
    typical = parameters.typical_area_px2 or _typical_area(areas, parameters.diameter_px)
    if typical <= 0.0:
        return _nothing(size, "there is nothing larger than a speck")
    blobs: list[_Blob] = []
    for label in range(1, count):
        if areas[label - 1] < parameters.min_area_ratio * typical:
            continue
        left, top, width, height = (int(value) for value in stats[label, :4])
        inside = labels[top : top + height, left : left + width] == label
        blobs.extend(_blobs_of(inside, (left, top), found, typical, parameters))
    if not blobs:
        return _nothing(size, "no blob has the size and shape of a marker")
    if not found.binary:
        alike = sum(0.5 < blob.area / typical < 2.0 for blob in blobs)
        if alike < parameters.min_markers:
            return _nothing(size, f"only {alike} dots of one size: specks, not a marker pattern")
    return Detections(
        uv=np.array([blob.uv for blob in blobs]),
        area_px2=np.array([blob.area for blob in blobs]),
        quality=np.array([blob.quality for blob in blobs]),
        merged=np.array([blob.merged for blob in blobs]),
        image_size=size,
        typical_area_px2=typical,
    )


@dataclass(frozen=True)
class _Blob:
    uv: tuple[float, float]
    area: float
    quality: float
    merged: bool
    solidity: float


def _nothing(size: tuple[int, int], note: str) -> Detections:
    empty = np.zeros(0)
    return Detections(np.zeros((0, 2)), empty, empty.copy(), np.zeros(0, bool), size, 0.0, note)


def _typical_area(areas: NDArray[np.float64], diameter_px: float | None) -> float:
    """Return the area [px^2] around which most marker pixels are found.

    Specks are many but hold few pixels, and glare holds many pixels in few blobs; so the weight of a blob
    is its area, limited to ten times the median of the blobs that are more than specks.
    """
    if diameter_px is not None:
        return float(np.pi * diameter_px**2 / 4.0)
    solid = np.sort(areas[areas >= 5.0])
    if solid.size == 0:
        return 0.0
    upper = solid[solid >= 0.3 * np.percentile(solid, 90)]
    weight = np.minimum(upper, np.median(upper) * 1.5)
    return float(upper[np.searchsorted(np.cumsum(weight), 0.5 * weight.sum())])


def _blobs_of(
    inside: NDArray[np.bool_],
    origin: tuple[int, int],
    found: Segmentation,
    typical: float,
    parameters: DetectionParameters,
) -> list[_Blob]:
    """Return the markers of one connected component: one, several when pins touch, or none.

    ``inside`` is the component in its bounding box, ``origin`` the box's left and top pixel.
    """
    if inside.sum() > parameters.max_merged * typical:
        return []
    blob = _measure(inside, origin, found, typical, parameters)
    if blob is not None and blob.area <= parameters.max_area_ratio * typical and blob.solidity >= 0.87:
        return [blob]
    blobs = [
        _measure(part, origin, found, typical, parameters, merged=len(parts) > 1)
        for trimmed in _trim(inside, typical, parameters.min_area_ratio)
        if (parts := _take_apart(trimmed, typical))
        for part in parts
        if part.sum() >= parameters.min_area_ratio * typical
    ]
    return [blob for blob in blobs if blob is not None and blob.area <= 2.0 * typical]


def _trim(inside: NDArray[np.bool_], typical: float, min_area_ratio: float) -> list[NDArray[np.bool_]]:
    """Cut off streaks and bridges thinner than about 0.4 marker diameters, and return what is left."""
    width = 2 * int(0.2 * np.sqrt(4.0 * typical / np.pi)) + 1
    if width < 3:
        return [inside]
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    padded = np.pad(inside.astype(np.uint8), width)
    opened = cv2.morphologyEx(padded, cv2.MORPH_OPEN, kernel)[width:-width, width:-width]
    count, labels = cv2.connectedComponents(opened, connectivity=4)
    pieces = [labels == label for label in range(1, count)]
    return [piece for piece in pieces if piece.sum() >= min_area_ratio * typical]


def _take_apart(inside: NDArray[np.bool_], typical: float) -> list[NDArray[np.bool_]]:
    """Split touching markers.

    Each peak of the distance transform is the centre of a disc; pixels go to the disc of least power
    ``|p - c|^2 - r^2``, so that the cut between two overlapping discs is the chord through their neck.
    """
    depth = cv2.distanceTransform(np.pad(inside.astype(np.uint8), 1), cv2.DIST_L2, 5)
    smooth = cv2.GaussianBlur(depth, (0, 0), 1.0)
    radius = float(np.sqrt(typical / np.pi))
    reach = 2 * round(0.8 * radius) + 1
    summit = (smooth >= cv2.dilate(smooth, np.ones((reach, reach), np.uint8)) - 1e-6) & (smooth > 0.4 * radius)
    count, _, _, centres = cv2.connectedComponentsWithStats(summit.astype(np.uint8), connectivity=8)
    if count <= 2:
        return [inside]
    centres = centres[1:] - 1.0
    columns = np.clip(np.rint(centres[:, 0]).astype(int), 0, inside.shape[1] - 1)
    rows = np.clip(np.rint(centres[:, 1]).astype(int), 0, inside.shape[0] - 1)
    radii = np.maximum(depth[rows + 1, columns + 1], 1.0)
    v, u = np.mgrid[: inside.shape[0], : inside.shape[1]]
    power = (u[..., None] - centres[:, 0]) ** 2 + (v[..., None] - centres[:, 1]) ** 2 - radii**2
    owner = np.argmin(power, axis=2)
    return [inside & (owner == index) for index in range(count - 1)]


def _measure(
    inside: NDArray[np.bool_],
    origin: tuple[int, int],
    found: Segmentation,
    typical: float,
    parameters: DetectionParameters,
    *,
    merged: bool = False,
) -> _Blob | None:
    """Return centroid and quality of one blob, or None when its shape is not that of a marker."""
    (left, top), (height, width) = origin, inside.shape
    weight = np.where(inside, found.weight[top : top + height, left : left + width], np.float32(0.0))
    shape = cv2.moments(inside.astype(np.uint8), binaryImage=True)
    area = shape["m00"]
    # Principal moments, those of the pixels themselves included.
    mean = (shape["mu20"] + shape["mu02"]) / (2.0 * area) + 1.0 / 12.0
    apart = math.hypot((shape["mu20"] - shape["mu02"]) / 2.0, shape["mu11"]) / area
    elongation = math.sqrt((mean + apart) / (mean - apart))
    rows, columns = np.nonzero(inside)
    hull = cv2.convexHull(np.stack([columns, rows], axis=1).astype(np.int32))
    solidity = min(1.0, area / (cv2.contourArea(hull) + 0.5 * cv2.arcLength(hull, True) + 1.0))
    if elongation > parameters.max_elongation or solidity < parameters.min_solidity:
        return None
    centre = cv2.moments(weight)
    uv = (centre["m10"] / centre["m00"] + left, centre["m01"] / centre["m00"] + top)
    log_ratio = math.log(area / typical)
    quality = float(math.exp(-((log_ratio / 0.9) ** 2)) * min(1.0, 1.6 / elongation) * min(1.0, solidity / 0.87))
    image_height, image_width = found.mask.shape
    at_border = left == 0 or top == 0 or left + width == image_width or top + height == image_height
    if merged:
        quality *= 0.5
    if at_border:
        quality *= 0.5
    return _Blob(uv, area, quality, merged, solidity)
