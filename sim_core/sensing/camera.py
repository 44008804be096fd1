"""Projection of points in a camera's optical frame to pixels."""

from __future__ import annotations

import numpy as np

from sim_core.rigs import FisheyeCamera, OrthographicCamera, PinholeCamera

Camera = PinholeCamera | FisheyeCamera | OrthographicCamera


def project(camera: Camera, points: np.ndarray, beyond: bool = False) -> np.ndarray:
    """Pixels ``(n, 2)`` of points [m] ``(n, 3)`` in the optical frame; NaN where out of the picture, or, if asked for
    what is ``beyond`` its edges, behind the camera.

    Pinhole: OpenCV's model (ROS plumb_bob). Fisheye: OpenCV's equidistant model. A scaled
    orthographic camera has no picture edge.
    """
    if isinstance(camera, OrthographicCamera):
        return np.asarray(points[:, :2] / camera.scale_m_per_px + [camera.cx_px, camera.cy_px])
    pixels = _imaged(camera, points)
    hidden = points[:, 2] <= 0.0
    if not beyond:
        size = np.array([camera.width_px, camera.height_px])
        hidden |= ((pixels < 0.0) | (pixels > size - 1.0)).any(axis=1)
    return np.where(hidden[:, None], np.nan, pixels)


def _imaged(camera: PinholeCamera | FisheyeCamera, points: np.ndarray) -> np.ndarray:
    """Pixels ``(n, 2)`` of points, out of sight too."""
    if is_plain(camera):
        depth = np.where(points[:, 2] == 0.0, np.inf, points[:, 2])
        return np.asarray(points[:, :2] / depth[:, None] * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px])
    import cv2

    coefficients, zero = np.asarray(camera.distortion), np.zeros(3)
    if isinstance(camera, FisheyeCamera):
        pixels, _ = cv2.fisheye.projectPoints(points[:, None], zero, zero, camera.matrix(), coefficients)
    else:
        pixels, _ = cv2.projectPoints(points, zero, zero, camera.matrix(), coefficients)
    return np.asarray(pixels).reshape(-1, 2)


def is_plain(camera: Camera) -> bool:
    """Whether a camera is a pinhole without distortion: on its formula OpenCV spends thirty times as long."""
    return isinstance(camera, PinholeCamera) and not any(camera.distortion)


def project_slopes(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Derivatives of the pixels by the points [px/m], ``(n, 2, 3)``, wherever they are."""
    if isinstance(camera, OrthographicCamera):
        return np.broadcast_to(np.eye(2, 3) / camera.scale_m_per_px, (len(points), 2, 3))
    if is_plain(camera):
        scaled = np.array([camera.fx_px, camera.fy_px]) / points[:, 2:]
        found = np.zeros((len(points), 2, 3))
        found[:, 0, 0], found[:, 1, 1] = scaled.T
        found[:, :, 2] = -scaled * points[:, :2] / points[:, 2:]
        return found
    import cv2

    coefficients = np.asarray(camera.distortion)
    zero = np.zeros(3)
    # A motion of all points is a translation of the camera; OpenCV gives the derivatives by that.
    if isinstance(camera, FisheyeCamera):
        _, slopes = cv2.fisheye.projectPoints(points[:, None], zero, zero, camera.matrix(), coefficients)
        return np.asarray(slopes[:, 11:14]).reshape(-1, 2, 3)
    _, slopes = cv2.projectPoints(points, zero, zero, camera.matrix(), coefficients)
    return np.asarray(slopes[:, 3:6]).reshape(-1, 2, 3)
