"""Where the points of a sensor are on its body."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.rigs import Gel, Points, Sheet, marker_positions, seen_points
from sim_core.rigs.observers import Sight

SHEET = Sheet.model_validate(
    {
        "type": "sheet",
        "shape": {"type": "rectangle", "length_m": 0.1, "width_m": 0.04, "cells": [5, 2]},
        "material": {"preset": "paper_80gsm"},
    }
)
PLATE = SHEET.model_copy(
    update={
        "shape": Sheet.model_validate(
            {
                "type": "sheet",
                "shape": {
                    "type": "outline",
                    "polygon_m": [[-1, -1], [1, -1], [1, 1], [-1, 1]],
                    "holes_m": [[[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]],
                    "edge_m": 0.2,
                },
                "material": {"preset": "paper_80gsm"},
            }
        ).shape
    }
)
MATERIAL = {"E_pa": 1e5, "nu": 0.4, "density_kg_m3": 1000}
BLOCK = Gel.model_validate(
    {
        "type": "gel",
        "shape": {"type": "block", "size_m": [0.02, 0.01, 0.004], "cells": [2, 2, 1]},
        "material": MATERIAL,
    }
)
DOME = Gel.model_validate(
    {
        "type": "gel",
        "shape": {"type": "dome", "radius_m": 0.02, "cavity_radius_m": 0.018, "cells": [4, 2, 1]},
        "material": MATERIAL,
    }
)


def test_a_grid_on_a_sheet_counts_row_by_row_in_the_middle_of_its_cells() -> None:
    positions, ids = marker_positions(Points(grid=(2, 3)), SHEET)
    np.testing.assert_array_equal(ids, range(6))
    np.testing.assert_allclose(positions[:, 0], [-0.025] * 3 + [0.025] * 3)
    np.testing.assert_allclose(positions[:3, 1], [-0.04 / 3, 0, 0.04 / 3], atol=1e-15)
    assert not positions[:, 2].any()


def test_a_margin_places_the_outermost_points() -> None:
    positions, _ = marker_positions(Points(grid=(2, 2), margin_m=0.005), SHEET)
    np.testing.assert_allclose(positions[[0, -1], :2], [[-0.045, -0.015], [0.045, 0.015]])
    with pytest.raises(ConfigError, match=r"margin_m is 0\.05"):
        marker_positions(Points(grid=(2, 2), margin_m=0.05), SHEET)


@pytest.mark.parametrize(
    ("face", "axis", "value"),
    [("top", 2, 0.002), ("bottom", 2, -0.002), ("x_min", 0, -0.01), ("y_max", 1, 0.005)],
)
def test_faces_of_a_block(face: str, axis: int, value: float) -> None:
    positions, _ = marker_positions(Points(face=face, grid=(3, 3)), BLOCK)
    np.testing.assert_allclose(positions[:, axis], value)
    np.testing.assert_allclose(positions.mean(axis=0)[[a for a in range(3) if a != axis]], 0.0, atol=1e-15)


@pytest.mark.parametrize(("face", "radius"), [("outer", 0.02), ("inner", 0.018)])
def test_rings_on_a_dome_lie_on_its_skin(face: str, radius: float) -> None:
    positions, _ = marker_positions(Points(face=face, grid=(4, 8)), DOME)
    np.testing.assert_allclose(np.linalg.norm(positions, axis=1), radius)
    assert (positions[:, 2] > 0.0).all()


def test_points_in_a_hole_are_left_out_and_ids_stay() -> None:
    positions, ids = marker_positions(Points(grid=(4, 4)), PLATE)
    assert len(positions) == 12
    assert set(range(16)) - set(ids.tolist()) == {5, 6, 9, 10}


def test_a_camera_numbers_its_bodies_one_after_the_other() -> None:
    sees = (
        Sight(body="card", points=Points(grid=(2, 2))),
        Sight(body="gel", points=Points(positions_m=((0.0, 0.0, 0.0),))),
    )
    seen = seen_points(sees, {"card": SHEET, "gel": BLOCK})
    assert [list(ids) for _, _, ids in seen] == [[0, 1, 2, 3], [4]]
