"""Loads in rig files: what is refused and how, and the names of their numbers."""

import copy

import pytest
from potentials import Look

from sim_core.errors import ConfigError
from sim_core.rigs import list_parameters, parse_rig, resolve_name, rig_to_yaml, with_parameters
from sim_core.rigs.yamlfile import parse_mapping
from sim_core.scene import build_scene
from sysid.model.parameters import fit_parameters

MATERIAL = {"E_pa": 1e6, "nu": 0.3, "density_kg_m3": 1000.0}
DATA = {
    "name": "loaded",
    "bodies": {
        "card": {
            "type": "sheet",
            "shape": {"type": "rectangle", "length_m": 0.1, "width_m": 0.02, "cells": [10, 2]},
            "material": {**MATERIAL, "thickness_m": 1e-3},
        },
        "pad": {
            "type": "gel",
            "shape": {"type": "block", "size_m": [0.02, 0.02, 0.01], "cells": [1, 1, 1]},
            "material": MATERIAL,
            "bonded": "bottom",
            "mount": "world",
        },
        "flag": {
            "type": "sheet",
            "shape": {"type": "outline", "polygon_m": [[-0.05, 0.0], [0.05, 0.0], [0.0, 0.05]], "edge_m": 0.03},
            "material": {**MATERIAL, "thickness_m": 1e-3},
        },
        "post": {"type": "rigid", "shape": {"type": "sphere", "radius_m": 0.01}},
        "ball": {
            "type": "affine",
            "shape": {"type": "sphere", "radius_m": 0.01},
            "material": {"density_kg_m3": 1000.0},
        },
    },
}
PULL = {"name": "pull", "type": "force", "body": "card", "region": {"x_m": [0.05, 0.05]}, "force_n": [1.0, 0.0, -2.0]}
GAS = {"name": "gas", "type": "pressure", "body": "card", "pressure_pa": 10.0}


def rig(*loads):
    return parse_rig({**copy.deepcopy(DATA), "loads": list(loads)}, "loaded")


@pytest.mark.parametrize(
    "load, words",
    [
        ({**PULL, "body": "crad"}, r"loads\[0\]\.body is 'crad', but the rig has no such sheet, gel .* 'card'"),
        ({**PULL, "body": "post"}, "no such sheet, gel or affine body"),
        ({**GAS, "body": "ball"}, "no such sheet or gel"),
        ({**PULL, "region": {"x_m": [0.06, 0.07]}}, r"region\.x_m is \[0\.06, 0\.07\], which misses 'card'"),
        ({**PULL, "name": "card"}, "name that is taken by one of the bodies"),
        ({**PULL, "force_mn": 3.0}, "force_mn is not a key"),
        ({**PULL, "face": "top"}, "is given for a sheet"),
        ({**GAS, "body": "pad", "face": "side"}, "no face of 'pad'. Choose one of: bottom, top"),
        ({**PULL, "times_s": [0.0, 1.0], "values": [1.0]}, "has 2 times and 1 values"),
        ({**PULL, "times_s": [0.0, 1.0, 1.0], "values": [1.0, 2.0, 3.0]}, "has 1 s after 1 s"),
        ({**PULL, "type": "moment"}, "moment"),
        ({**GAS, "pressure_pa": 1e12}, "pressure_pa"),
    ],
)
def test_what_is_wrong_is_named(load, words):
    with pytest.raises(ConfigError, match=words):
        rig(load)


INSIDE = {axis: [1e-4, 2e-4] for axis in ("x_m", "y_m", "z_m")}


@pytest.mark.parametrize(
    "load, words",
    [
        ({**GAS, "body": "flag", "region": {"x_m": [1e-3, 2e-3]}}, "gas holds no whole triangle of flag"),
        ({**PULL, "body": "pad", "region": {"z_m": [0.001, 0.002]}}, "pull holds no whole face of the surface of pad"),
        ({**PULL, "body": "ball", "region": INSIDE}, "pull holds no node of ball"),
    ],
)
def test_a_region_that_holds_nothing_is_refused(load, words):
    with pytest.raises(ConfigError, match=words):
        build_scene(rig(load))


def test_numbers_of_loads_are_parameters():
    given = rig(PULL, GAS, {"name": "bob", "type": "weight", "body": "ball", "mass_kg": 0.1})
    names = {p.name: (p.value, p.unit) for p in list_parameters(given)}
    assert names["pull.force_x_n"] == (1.0, "N")
    assert names["pull.force_z_n"] == (-2.0, "N")
    assert names["gas.pressure_pa"] == (10.0, "Pa")
    assert names["bob.mass_kg"] == (0.1, "kg")
    assert resolve_name(given, "pull.force_y") == "pull.force_y_n"
    changed = with_parameters(given, {"pull.force_y": 3.0, "gas.pressure": 20.0})
    assert changed.loads[0].force_n == (1.0, 3.0, -2.0)
    assert changed.loads[1].pressure_pa == 20.0


def test_numbers_of_loads_can_be_fitted():
    wind = {"name": "wind", "type": "traction", "body": "card", "traction_pa": [0.0, 1.0, 0.0]}
    given = rig(PULL, GAS, wind, {"name": "bob", "type": "weight", "body": "ball", "mass_kg": 0.1})
    own = [p.name for p in list_parameters(given) if p.name.split(".")[0] in ("pull", "gas", "wind", "bob")]
    assert [p.name for p in fit_parameters(given, own)] == own
    assert len(own) == 8


def test_a_rig_with_loads_survives_a_round_trip():
    given = rig({**PULL, "times_s": [0.0, 1.0], "values": [0.0, 2.0]}, GAS)
    assert parse_rig(parse_mapping(rig_to_yaml(given), "loaded"), "loaded") == given


def test_a_force_is_whole_however_the_region_is_meshed():
    """Over triangles, over the edges of a line, over a point; over quadratic faces and an affine body's surface."""
    regions = [("card", {"x_m": [0.02, 0.05]}), ("card", {"x_m": [0.05, 0.05]}),
               ("card", {"x_m": [0.05, 0.05], "y_m": [-0.01, -0.01]}), ("pad", {"z_m": [0.005, 0.005]}),
               ("ball", {})]  # fmt: skip
    for body, region in regions:
        scene = build_scene(rig({**PULL, "body": body, "region": region}))
        force = -Look(scene.system).exerted()  # at rest nothing else acts on the whole
        assert force.sum(axis=0) == pytest.approx([1.0, 0.0, -2.0], abs=1e-12)
