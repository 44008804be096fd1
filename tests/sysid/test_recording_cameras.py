"""Calibrations and images of a recording."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from recording_messages import (
    COMPRESSED,
    IDS,
    IMAGE,
    INFO,
    START,
    UV,
    Item,
    header,
    log_time,
    make,
    notes,
    poses,
    read,
    tracks,
)

from sim_core.errors import RecordingError


def info(stamp_ns: int, focal: float = 300.0, model: str = "plumb_bob", d: Any = (0.0,) * 5) -> Any:
    k = np.array([focal, 0, 16, 0, focal, 12, 0, 0, 1.0]) if focal else np.zeros(9)
    return make(
        INFO,
        header=header(stamp_ns, "optical"),
        height=24,
        width=32,
        distortion_model=model,
        d=np.array(d, dtype=np.float64),
        k=k,
        r=np.zeros(9),
        p=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def with_info(*messages: Any) -> list[Item]:
    found = [("/camera_info", INFO, log_time(k), message) for k, message in enumerate(messages)]
    return poses(6) + tracks({**UV, "id": IDS, "confidence": np.ones(3)}) + found


def test_fisheye_calibration(tmp_path: Path) -> None:
    recording = read(tmp_path, with_info(info(START, model="equidistant", d=(0.1, 0, 0, 0))))
    camera = recording.tracks["camera"].camera_info
    assert camera is not None and camera.model == "equidistant"
    np.testing.assert_array_equal(camera.K, [[300, 0, 16], [0, 300, 12], [0, 0, 1]])
    assert (camera.width, camera.height, camera.frame_id) == (32, 24, "optical")
    assert recording.notes == ()


def test_a_camera_that_is_not_calibrated(tmp_path: Path) -> None:
    recording = read(tmp_path, with_info(info(START, focal=0.0, model="", d=())))
    assert recording.tracks["camera"].camera_info is None
    assert "K is zero: the camera is not calibrated" in notes(recording)


@pytest.mark.parametrize(
    ("messages", "fault"),
    [
        ([info(START), info(START + 1, focal=310.0)], "calibration changes"),
        ([info(START, model="pinhole")], "model 'pinhole' is not known"),
        ([info(START, model="equidistant")], "5 distortion coefficients for equidistant"),
        ([info(START, focal=-300.0)], "focal lengths -300"),
    ],
)
def test_calibrations_that_cannot_be_used(tmp_path: Path, messages: list[Any], fault: str) -> None:
    with pytest.raises(RecordingError, match=fault):
        read(tmp_path, with_info(*messages))


GREY = np.arange(24 * 32, dtype=np.uint32).reshape(24, 32).astype(np.uint8)
COLOUR = np.stack([GREY, GREY // 2, 255 - GREY], axis=-1)


def raw_image(stamp_ns: int, pixels: Any, encoding: str, padding: int = 0) -> Any:
    rows = np.pad(pixels.reshape(len(pixels), -1), ((0, 0), (0, padding)))
    return make(
        IMAGE,
        header=header(stamp_ns, "optical"),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.reshape(-1),
    )


def images(make_one: Callable[[int], Any], topic: str = "/image", msgtype: str = IMAGE) -> list[Item]:
    return [(topic, msgtype, t, make_one(t)) for t in map(log_time, range(3))]


@pytest.mark.parametrize(
    ("encoding", "pixels", "expected"),
    [("mono8", GREY, GREY), ("rgb8", COLOUR, COLOUR), ("bgr8", COLOUR[..., ::-1], COLOUR)],
)
@pytest.mark.parametrize("padding", [0, 7])
def test_raw_images(tmp_path: Path, encoding: str, pixels: Any, expected: Any, padding: int) -> None:
    recording = read(tmp_path, poses() + images(lambda t: raw_image(t, pixels, encoding, padding)))
    found = list(recording.images["camera"])
    assert len(found) == 3
    for _, image in found:
        np.testing.assert_array_equal(image, expected)


def compressed(stamp_ns: int, data: bytes, fmt: str) -> Any:
    return make(COMPRESSED, header=header(stamp_ns, "optical"), format=fmt, data=np.frombuffer(data, dtype=np.uint8))


def test_raw_images_are_preferred_to_their_compressed_twins(tmp_path: Path) -> None:
    png = cv2.imencode(".png", GREY)[1].tobytes()
    items = images(lambda t: compressed(t, png, "png"), "/image/compressed", COMPRESSED)
    recording = read(tmp_path, poses() + items + images(lambda t: raw_image(t, GREY, "mono8")))
    assert recording.images["camera"].topic == "/image"
    assert "/image/compressed: not used: the raw image is in the recording" in notes(recording)


def test_images_are_read_on_demand_in_order_of_time(tmp_path: Path) -> None:
    stamps = {0: 0, 1: 2, 2: 1}
    items = [
        ("/image", IMAGE, log_time(k), raw_image(log_time(j), np.full((2, 2), k, np.uint8), "mono8"))
        for k, j in stamps.items()
    ]
    stream = read(tmp_path, poses() + items).images["camera"]
    assert [int(image[0, 0]) for _, image in stream] == [0, 2, 1]
    assert int(stream.image(1)[0, 0]) == 2


@pytest.mark.parametrize(
    ("message", "fault"),
    [
        (lambda t: raw_image(t, GREY, "bayer_rggb8"), "encoding 'bayer_rggb8'"),
        (lambda t: raw_image(t, GREY[:, :8], "rgb8"), "has 192 bytes where 24 rows of 8 bytes"),
    ],
)
def test_raw_images_that_cannot_be_used(tmp_path: Path, message: Any, fault: str) -> None:
    with pytest.raises(RecordingError, match=fault):
        read(tmp_path, poses() + images(message))


@pytest.mark.parametrize("data", [b"", b"no image at all", cv2.imencode(".png", GREY)[1].tobytes()[:20]])
def test_compressed_images_that_cannot_be_used(tmp_path: Path, data: bytes) -> None:
    items = images(lambda t: compressed(t, data, "png"), "/image/compressed", COMPRESSED)
    with pytest.raises(RecordingError, match="cannot be decoded"):
        read(tmp_path, poses() + items)


def test_sixteen_bit_images_are_refused(tmp_path: Path) -> None:
    png = cv2.imencode(".png", GREY.astype(np.uint16))[1].tobytes()
    items = images(lambda t: compressed(t, png, "png"), "/image/compressed", COMPRESSED)
    with pytest.raises(RecordingError, match="uint16 pixels"):
        read(tmp_path, poses() + items)
