"""Constants of contact where a rig gives none: surfaces stay where they belong."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.scene.contact_constants import OF_EDGE, WIDEST_M, constants_of
from sim_core.simulate import Simulation

PAPER = {"E_pa": 3e9, "nu": 0.3, "density_kg_m3": 800.0}


def rig_of(contact: dict[str, Any], thickness: float = 1e-4, e_pa: float = 2e5) -> dict[str, Any]:
    """A block of gel on the table, a sheet above both."""
    return {
        "name": "stack",
        "bodies": {
            "table": {"type": "rigid", "shape": {"type": "plane"}},
            "gel": {
                "type": "gel",
                "shape": {"type": "block", "size_m": [0.02, 0.02, 0.01], "cells": [2, 2, 1]},
                "material": {"E_pa": e_pa, "nu": 0.4, "density_kg_m3": 1000.0},
                "pose": {"position_m": [0.0, 0.0, 0.05]},
                "bonded": "bottom",
                "mount": "world",
            },
            "sheet": {
                "type": "sheet",
                "shape": {"type": "rectangle", "length_m": 0.02, "width_m": 0.02, "cells": [2, 2]},
                "material": {**PAPER, "thickness_m": thickness},
                "pose": {"position_m": [0.0, 0.0, 0.1]},
            },
        },
        "contacts": [contact],
    }


def law(contact: dict[str, Any], refine: int = 1, **rig: Any) -> dict[str, float]:
    """Numbers of the first term of a contact."""
    scene = build_scene(parse_rig(rig_of(contact, **rig), "stack"), refine)
    return scene.values(scene.rig).terms[next(iter(scene.contacts.values()))[0].name]


def test_the_range_falls_with_the_cells_of_a_gel_and_its_stiffness_with_the_modulus() -> None:
    """Surface triangles have sides of half a cell: 5 mm, and the scale of pressure is a quarter of Young's modulus."""
    coarse, fine = (law({"between": ["gel", "table"]}, refine) for refine in (1, 2))
    assert coarse["range_m"] == pytest.approx(min(WIDEST_M, OF_EDGE * 5e-3))
    assert fine["range_m"] == pytest.approx(0.5 * coarse["range_m"])
    for modulus in (2e5, 1e6):
        found = law({"between": ["gel", "table"]}, e_pa=modulus)
        assert found["stiffness_pa_per_m"] * found["range_m"] == pytest.approx(0.25 * modulus)


def test_contact_of_a_foil_is_thin_compared_with_it() -> None:
    for thickness in (1e-5, 5e-5):
        found = law({"between": ["sheet", "table"]}, thickness=thickness)
        assert found["range_m"] == pytest.approx(0.3 * thickness)
        assert 0.0 < 0.5 * thickness - found["offset_m"] < found["range_m"]


def test_what_a_rig_gives_stands() -> None:
    given = law({"between": ["gel", "table"], "range_m": 2e-6, "stiffness_pa_per_m": 3e10})
    assert (given["range_m"], given["stiffness_pa_per_m"]) == (2e-6, 3e10)
    softer = law({"between": ["gel", "table"], "stiffness_pa_per_m": 1e6})
    assert softer["range_m"] == law({"between": ["gel", "table"]})["range_m"]
    wider = law({"between": ["gel", "table"], "range_m": 1e-4})
    assert wider["stiffness_pa_per_m"] * 1e-4 == pytest.approx(0.25 * 2e5)


def test_the_softer_of_two_gels_counts() -> None:
    data = rig_of({"between": ["gel", "other"]})
    data["bodies"]["other"] = {**data["bodies"]["gel"], "pose": {"position_m": [0.0, 0.0, 0.08]}}
    data["bodies"]["other"]["material"] = {"E_pa": 8e4, "nu": 0.4, "density_kg_m3": 1000.0}
    rig = parse_rig(data, "stack")
    found = constants_of(rig, rig.contacts[0], {"gel": 1e-3, "other": 2e-3})
    assert found.stiffness_pa_per_m * found.range_m == pytest.approx(0.25 * 8e4)
    assert found.range_m == pytest.approx(OF_EDGE * 1e-3)


def test_a_sheet_lies_on_the_table_at_half_its_thickness() -> None:
    """Within a tenth of the range, whatever its weight: 0.8 Pa of paper, and a thousand times that."""
    for gravity in (9.81, 9810.0):
        data = rig_of({"between": ["sheet", "table"]})
        data["gravity_m_s2"] = [0.0, 0.0, -gravity]
        data["solver"] = {"dt_s": 0.02}
        del data["bodies"]["gel"]
        data["bodies"]["sheet"]["pose"] = {"position_m": [0.0, 0.0, 5.3e-5]}
        simulation = Simulation(build_scene(parse_rig(data, "stack")))
        for _ in range(10):
            simulation.step({}, 0.02)
        height = simulation.state.x[simulation.scene.bodies["sheet"].nodes, 2]
        assert np.abs(height - 5e-5).max() < 0.1 * WIDEST_M + 1e-8
        forces, weight = simulation.contact_forces()["sheet-table"], PAPER["density_kg_m3"] * 1e-4 * 4e-4 * gravity
        borne = forces[simulation.scene.bodies["sheet"].nodes].sum(axis=0)
        np.testing.assert_allclose(borne, [0.0, 0.0, weight], rtol=1e-4, atol=1e-6 * weight)
        np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=1e-9 * weight)
