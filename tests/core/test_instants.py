"""A pinhole without distortion against OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
from strip_over_table import strip_rig

from sim_core.sensing.camera import is_plain, project, project_slopes


def test_a_plain_pinhole_images_as_opencv_does():
    camera = strip_rig().cameras["side"]
    assert is_plain(camera)
    points = np.random.default_rng(1).uniform([-0.2, -0.1, 0.2], [0.2, 0.1, 0.6], (50, 3))
    zero = np.zeros(3)
    expected, slopes = cv2.projectPoints(points, zero, zero, camera.matrix(), np.zeros(5))
    np.testing.assert_allclose(project(camera, points, beyond=True), expected.reshape(-1, 2), atol=1e-10)
    np.testing.assert_allclose(project_slopes(camera, points), slopes[:, 3:6].reshape(-1, 2, 3), atol=1e-9)
    behind = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])
    assert np.isnan(project(camera, behind, beyond=True)).all()
