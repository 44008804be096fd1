"""Bodies that start inside one another are reported with the depth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sim_core.contact.start_depth import distances, over_triangles
from sim_core.errors import ConfigError
from sim_core.rigs import parse_rig
from sim_core.scene import build_scene

CARD = {
    "type": "sheet",
    "shape": {"type": "rectangle", "length_m": 0.06, "width_m": 0.03, "cells": [6, 3], "pattern": "crossed"},
    "material": {"preset": "card_200gsm"},
}


def scene(**bodies: Any) -> Any:
    first, second = bodies
    return build_scene(
        parse_rig({"name": "two", "bodies": bodies, "contacts": [{"between": [first, second], "friction": 0.3}]}, "rig")
    )


def card(z: float, **more: Any) -> dict[str, Any]:
    return {**CARD, "pose": {"position_m": [0.0, 0.0, z], **more}}


def rigid(shape: dict[str, Any], z: float, **more: Any) -> dict[str, Any]:
    return {"type": "rigid", "shape": shape, "pose": {"position_m": [0.0, 0.0, z], **more}}


@pytest.mark.parametrize(
    ("shape", "z", "depth"),
    [
        ({"type": "plane"}, 0.002, "2.12 mm"),
        ({"type": "sphere", "radius_m": 0.01}, 0.0, "10.1 mm"),
        ({"type": "sphere", "radius_m": 0.003}, 0.0, "3.12 mm"),
        ({"type": "box", "size_m": [0.02, 0.02, 0.01]}, 0.0, "5.12 mm"),
        ({"type": "cylinder", "radius_m": 0.01, "length_m": 0.004}, 0.0, "2.12 mm"),
    ],
)
def test_a_sheet_that_starts_inside_is_refused(shape: dict[str, Any], z: float, depth: str) -> None:
    with pytest.raises(ConfigError, match=rf"card starts inside post, {depth} deep.*Move card or post"):
        scene(card=card(0.0), post=rigid(shape, z))


def test_what_only_touches_is_accepted() -> None:
    scene(card=card(0.0), post=rigid({"type": "sphere", "radius_m": 0.01}, -0.0101))
    scene(card=card(0.0), table=rigid({"type": "plane"}, -0.0001))


def test_sheets_in_the_same_place_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"a and b start in the same place: 0 mm apart"):
        scene(a=card(0.0), b=card(0.0))
    finer = {**card(0.0), "shape": {**CARD["shape"], "cells": [7, 4]}}
    with pytest.raises(ConfigError, match=r"start in the same place"):
        scene(a=card(0.0), b=finer)
    scene(a=card(0.0), b=card(0.0005))


def test_distances_to_shapes() -> None:
    """A box and a cylinder with rounded edges, inside, outside and next to a corner."""
    box = np.array([3.0, 0.02, 0.03, 0.04, 0.005])
    points = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.02, 0.03, 0.0]])
    corner = np.hypot(0.005, 0.005) - 0.005
    np.testing.assert_allclose(distances(points, box), [-0.02, 0.01, corner], atol=1e-15)
    drum = np.array([2.0, 0.02, 0.03, 0.0])
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, 0.0, 0.04], [0.023, 0.0, 0.034]])
    np.testing.assert_allclose(distances(points, drum), [-0.02, 0.03, 0.01, 0.005], atol=1e-15)


def test_distance_over_triangles() -> None:
    corners = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    assert over_triangles(np.array([[0.2, 0.2, -0.3], [5.0, 5.0, 0.0]]), corners) == pytest.approx(0.3)
    assert over_triangles(np.array([[0.9, 0.9, 0.1]]), corners) == np.inf
