"""Surfaces that go through each other where they start, and surfaces that only touch."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.contact.intersection_check import cross
from sim_core.contact.samples import triangle_edges
from sim_core.geometry.sheets import rectangle


def upright(cells: int, lift: float) -> bool:
    """A flat sheet and one that stands in it, moved up by ``lift`` of its height."""
    flat, stood = rectangle(0.04, 0.04, (4, 4)), rectangle(0.02, 0.02, (cells, cells))
    standing = stood.nodes[:, [0, 2, 1]] + [0.0013, 0.0, lift * 0.02]
    x = np.vstack([flat.nodes, standing])
    triangles = stood.triangles + len(flat.nodes)
    ways = (triangle_edges(triangles, x)[0], flat.triangles), (triangle_edges(flat.triangles, x)[0], triangles)
    return any(cross(x, *way) for way in ways)


@pytest.mark.parametrize("cells", [2, 3, 4])
def test_a_sheet_that_stands_through_another_is_seen_wherever_its_nodes_are(cells: int) -> None:
    assert upright(cells, 0.0)
    assert upright(cells, 0.3)


@pytest.mark.parametrize("cells", [2, 3])
@pytest.mark.parametrize("lift", [0.5, 0.6])
def test_a_sheet_that_stands_on_another_does_not_go_through_it(cells: int, lift: float) -> None:
    assert not upright(cells, lift)
