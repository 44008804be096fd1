"""Searches of a rig with many cells are made with coarser ones, and its own are what they are measured against."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from sim_core.rigs import Gel, Rig, load_rig
from sim_core.rigs.gel_shapes import Block, Grading
from sim_core.rigs.regions import RefinedBox
from sysid.discretisation import coarser_cells
from sysid.discretisation.coarser_cells import coarsened
from sysid.discretisation.gel_extent import widened
from sysid.settings.discretisation import DISCRETISATION

PRESS = Path(__file__).parents[1] / "ros" / "data" / "press_gel.yaml"
TACTIP = Path(__file__).parents[2] / "config" / "rigs" / "tactip_cr.yaml"


def with_shape(**changes: Any) -> Rig:
    """The rig of a ball and a pad with another shape of the pad, checked as a user's is."""
    rig = load_rig(PRESS)
    body = cast(Gel, rig.bodies["pad"])
    shape = Block.model_validate({**body.shape.model_dump(), **changes})
    return rig.model_copy(update={"bodies": {**rig.bodies, "pad": body.model_copy(update={"shape": shape})}})


def pad(rig: Rig) -> Block:
    return cast(Block, cast(Gel, rig.bodies["pad"]).shape)


def search_up_to(nodes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(coarser_cells, "DISCRETISATION", replace(DISCRETISATION, searched_nodes=nodes))


def test_cells_are_halved_until_a_rollout_is_cheap_and_the_given_ones_come_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """(2 a + 1)(2 b + 1)(2 c + 1) - a b c nodes: 755 of 7 x 5 x 2 cells, 177 of 4 x 3 x 1."""
    rig = with_shape(cells=(7, 5, 2), graded=(Grading(towards="top", ratio=0.5).model_dump(),))
    search_up_to(755, monkeypatch)
    assert coarsened(rig) is None
    search_up_to(754, monkeypatch)
    found = coarsened(rig)
    assert found is not None and pad(found.rig).cells == (4, 3, 1)
    assert pad(found.rig).graded == pad(rig).graded
    back = found.given_cells(found.rig)
    assert back.rig == rig
    assert back.finer == pytest.approx(5.0 / 3.0), "the least of the three axes"
    assert "4 x 3 x 1" in back.notes[0] and "7 x 5 x 2" in back.notes[0]
    search_up_to(10, monkeypatch)
    found = coarsened(rig)
    assert found is not None and pad(found.rig).cells == (4, 3, 1), "one cell along an axis is the end"


def test_planes_of_symmetry_keep_even_numbers_and_boxes_get_longer_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    box = RefinedBox(x_m=(0.0, 0.002), y_m=(0.0, 0.002), z_m=(0.0, 0.002), edge_m=8e-4)
    rig = with_shape(cells=(10, 12, 4), symmetry=("x", "y"), refine=(box.model_dump(),))
    search_up_to(500, monkeypatch)
    found = coarsened(rig)
    assert found is not None
    shape = pad(found.rig)
    assert shape.cells[0] % 2 == 0 and shape.cells[1] % 2 == 0
    assert shape.refine[0].edge_m == pytest.approx(2.0**found.halvings * 8e-4)
    assert Block.model_validate(shape.model_dump()) == shape
    assert found.given_cells(found.rig).rig == rig


def test_cells_that_cannot_get_fewer_along_all_axes_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plane of symmetry needs two cells: with as many along an axis, nothing would tell the error of the mesh."""
    search_up_to(10, monkeypatch)
    assert coarsened(with_shape(cells=(2, 2, 4), symmetry=("x", "y"))) is None


def test_wider_pads_get_cells_as_fine_as_those_given(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = with_shape(cells=(8, 8, 4)).model_copy(update={"sensors": {}, "cameras": {}})
    search_up_to(1000, monkeypatch)
    found = coarsened(rig)
    assert found is not None and found.halvings == 1
    wide = widened(found.rig)
    assert wide is not None
    fine = found.given_cells(wide.rig)
    assert pad(fine.rig).size_m == pad(wide.rig).size_m
    assert pad(fine.rig).cells == tuple(2 * n for n in pad(wide.rig).cells) and fine.finer == 2.0


def test_domes_can_have_coarser_cells_and_rigs_with_sheets_stay(
    monkeypatch: pytest.MonkeyPatch, small_rig: Any
) -> None:
    search_up_to(1, monkeypatch)
    dome = load_rig(TACTIP)
    name = next(n for n, b in dome.bodies.items() if isinstance(b, Gel))
    body = cast(Gel, dome.bodies[name])
    fine = body.model_copy(update={"shape": body.shape.model_copy(update={"cells": (4, 2, 2)})})
    found = coarsened(dome.model_copy(update={"bodies": {**dome.bodies, name: fine}}))
    assert found is not None and cast(Gel, found.rig.bodies[name]).shape.cells == (2, 1, 1)  # type: ignore[union-attr]
    assert coarsened(dome) is None, "its wall has one cell"
    assert coarsened(small_rig()) is None


def test_the_rigs_that_come_with_the_project_are_searched_as_they_are() -> None:
    for path in sorted((Path(__file__).parents[2] / "config" / "rigs").glob("*.yaml")):
        assert coarsened(load_rig(path)) is None, path.name
