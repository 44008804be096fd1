"""The channels of a recording as arrays. SI units; times in seconds since the recording's ``t0_ns``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

import numpy as np

from sysid.recording.arrays import Bools, Floats, Ints

StreamT = TypeVar("StreamT", bound="Stream")


@dataclass(frozen=True, kw_only=True)
class Stream:
    """What all channels have.

    Attributes:
        topic: the source topic.
        frame_id: the frame that the values are in.
        t: strictly increasing times [s], shape (n,).
        arrival: times of recording by the recorder's clock [s], shape (n,); None where they are not known.
    """

    _per_sample: ClassVar[tuple[str, ...]] = ("t", "arrival")

    topic: str
    frame_id: str
    t: Floats
    arrival: Floats | None = None

    def __len__(self) -> int:
        return len(self.t)

    def take(self: StreamT, which: Any) -> StreamT:
        """Return the samples selected by an index array or mask."""
        return replace(self, **{name: _pick(getattr(self, name), which) for name in self._per_sample})


def _pick(values: Any, which: Any) -> Any:
    return None if values is None else values[which]


@dataclass(frozen=True, kw_only=True)
class PoseStream(Stream):
    """Poses of an end effector in ``frame_id``.

    Attributes:
        position: [m], shape (n, 3).
        quaternion: unit, x y z w, without sign flips along the stream, shape (n, 4).
        stated_sd: standard deviations of position [m] and orientation [rad] that its messages state; None where they
            state none.
    """

    _per_sample: ClassVar[tuple[str, ...]] = ("t", "arrival", "position", "quaternion")

    position: Floats
    quaternion: Floats
    stated_sd: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class WrenchStream(Stream):
    """Wrench acting on the sensor, about the origin of ``frame_id``.

    Attributes:
        force: [N], NaN where not measured, shape (n, 3).
        torque: [N m], NaN where not measured, shape (n, 3).
        mask: which of the six components are finite, force first, shape (n, 6).
    """

    _per_sample: ClassVar[tuple[str, ...]] = ("t", "arrival", "force", "torque", "mask")

    force: Floats
    torque: Floats
    mask: Bools


@dataclass(frozen=True, kw_only=True)
class MarkerStream(Stream):
    """Three-dimensional markers in ``frame_id``.

    Attributes:
        ids: the markers seen at any time, increasing, shape (m,).
        position: current position [m], NaN where a marker is missing, shape (n, m, 3).
        displacement: from rest [m], NaN where missing, shape (n, m, 3); None when the topic has none.
        force: nodal, on the sensor [N], NaN where missing, shape (n, m, 3); None when the topic has none.
    """

    _per_sample: ClassVar[tuple[str, ...]] = ("t", "arrival", "position", "displacement", "force")

    ids: Ints
    position: Floats
    displacement: Floats | None
    force: Floats | None

    @property
    def rest(self) -> Floats | None:
        """Rest position [m], the mean over time of position minus displacement, shape (m, 3)."""
        if self.displacement is None:
            return None
        rest = self.position - self.displacement
        seen = np.isfinite(rest)
        count = seen.sum(axis=0)
        total: Floats = np.where(seen, rest, 0.0).sum(axis=0)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@dataclass(frozen=True)
class CameraInfo:
    """A calibrated camera, and which part of its sensor the recorded pictures show (REP 104).

    K, D, R, P, width and height are those of the whole sensor at full resolution, whatever was recorded; ``recorded``
    gives those of the pictures.

    Attributes:
        K: intrinsic matrix [px], shape (3, 3).
        D: distortion coefficients of ``model``, shape (k,).
        model: 'plumb_bob', 'rational_polynomial' or 'equidistant'.
        width: [px], 0 when not stated.
        height: [px], 0 when not stated.
        frame_id: optical frame.
        R: rotation of rectified pictures, shape (3, 3); zeros when not stated.
        P: projection into rectified pictures [px], shape (3, 4); zeros when not stated.
        binning: columns and rows of the sensor that are one of the picture, 1 for none.
        roi: window of the sensor that the pictures show [px]: first column, first row, width, height; width and height
            are 0 for the whole sensor.
    """

    K: Floats
    D: Floats
    model: str
    width: int
    height: int
    frame_id: str
    R: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    P: Floats = field(default_factory=lambda: np.zeros((3, 4)))
    binning: tuple[int, int] = (1, 1)
    roi: tuple[int, int, int, int] = (0, 0, 0, 0)

    def recorded(self, rectified: bool = False) -> CameraInfo:
        """The calibration of the pictures as recorded: binned, cut to the window, and without distortion where they
        are ``rectified``.

        Columns and rows are counted at the centres of pixels: binning by b moves u to (u + 1/2) / b - 1/2.
        """
        x, y, width, height = self.roi
        size = (width or self.width, height or self.height)
        b = np.array(self.binning, dtype=np.float64)
        to_recorded = np.array(
            [[1 / b[0], 0.0, (0.5 - x) / b[0] - 0.5], [0.0, 1 / b[1], (0.5 - y) / b[1] - 0.5], [0.0, 0.0, 1.0]]
        )
        P = to_recorded @ self.P
        return replace(
            self,
            K=P[:, :3] if rectified else to_recorded @ self.K,
            D=np.zeros_like(self.D) if rectified else self.D,
            P=P,
            width=size[0] // self.binning[0],
            height=size[1] // self.binning[1],
            binning=(1, 1),
            roi=(0, 0, 0, 0),
        )


@dataclass(frozen=True, kw_only=True)
class TrackStream(Stream):
    """Marker tracks in the image of a camera.

    Attributes:
        ids: the markers seen at any time, increasing, shape (m,).
        uv: column and row [px], NaN where a marker is lost, shape (n, m, 2).
        confidence: in 0..1, 0 where a marker is lost, shape (n, m).
        camera_info: None when the camera is not calibrated.
    """

    _per_sample: ClassVar[tuple[str, ...]] = ("t", "arrival", "uv", "confidence")

    ids: Ints
    uv: Floats
    confidence: Floats
    camera_info: CameraInfo | None
