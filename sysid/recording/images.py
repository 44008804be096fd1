"""Images of a recording, decoded one at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sim_core.errors import RecordingError
from sysid.recording.arrays import Bytes
from sysid.recording.bag import MessageSet
from sysid.recording.message_types import COMPRESSED
from sysid.recording.messages import decode
from sysid.recording.streams import CameraInfo, Stream

_CHANNELS = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3}
_READABLE = "Record mono8, rgb8 or bgr8, or png or jpeg as a CompressedImage."


@dataclass(frozen=True, kw_only=True)
class ImageStream(Stream):
    """Images of a camera. The pixels stay in the recording's files until asked for.

    Iterating yields ``(t, image)``; an image is uint8 of shape (height, width) when grey, or
    (height, width, 3) in the order red, green, blue.

    Attributes:
        msgtype: type of the messages.
        source: where the messages are.
        camera_info: None when the camera is not calibrated.
    """

    _per_sample: ClassVar[tuple[str, ...]] = ("t", "arrival")

    msgtype: str
    source: MessageSet
    camera_info: CameraInfo | None

    def take(self, which: Any) -> ImageStream:
        """Return the images selected by an index array or mask."""
        return ImageStream(
            topic=self.topic,
            frame_id=self.frame_id,
            t=self.t[which],
            arrival=None if self.arrival is None else self.arrival[which],
            msgtype=self.msgtype,
            source=self.source.take(which),
            camera_info=self.camera_info,
        )

    def image(self, k: int) -> Bytes:
        """Decode the ``k``-th image."""
        ((_, image),) = self.take([k])
        return image

    def __iter__(self) -> Iterator[tuple[float, Bytes]]:
        for t, image in self.decoded():
            if isinstance(image, RecordingError):
                raise image
            yield t, image

    def decoded(self) -> Iterator[tuple[float, Bytes | RecordingError]]:
        """Yield the time of each image and the image, or what is wrong with it."""
        for t, data in zip(self.t.tolist(), self.source.payloads(), strict=True):
            try:
                yield t, pixels(decode(data, self.msgtype), self.msgtype == COMPRESSED)
            except ValueError as error:
                yield t, RecordingError(f"{self.topic}: the image at t={t:.6g} s {error}.", _READABLE)


def pixels(message: Any, compressed: bool) -> Bytes:
    """Pixels of an Image or a CompressedImage, as of :class:`ImageStream`. Raises ``ValueError`` with what is wrong."""
    return _compressed(message) if compressed else _raw(message)


def _compressed(message: Any) -> Bytes:
    import cv2

    data = np.asarray(message.data, dtype=np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    if image is None:
        raise ValueError(f"({data.size} bytes, format {message.format!r}) cannot be decoded")
    if image.dtype != np.uint8:
        raise ValueError(f"has {image.dtype} pixels, not uint8")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim == 3:
        code = cv2.COLOR_BGRA2RGB if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
        image = cv2.cvtColor(image, code)
    return np.ascontiguousarray(image, dtype=np.uint8)


def _raw(message: Any) -> Bytes:
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        raise ValueError(f"has the encoding {message.encoding!r}")
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, dtype=np.uint8)
    if step < width * channels or data.size < height * step:
        raise ValueError(f"has {data.size} bytes where {height} rows of {step} bytes are stated")
    rows = data[: height * step].reshape(height, step)[:, : width * channels]
    image = rows.reshape(height, width) if channels == 1 else rows.reshape(height, width, channels)
    return np.array(image if message.encoding != "bgr8" and message.encoding != "8UC3" else image[..., ::-1])
