"""What a rig file may say, and how everything else is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.materials.presets import PRESETS
from sim_core.rigs import Rig, load_rig, parse_rig, rig_to_yaml
from sim_core.rigs.load import names_in
from sim_core.rigs.yamlfile import parse_mapping

Edit = Callable[[dict[str, Any]], object]


def raw() -> dict[str, Any]:
    """The card rig as plain data, lists instead of tuples."""
    return parse_mapping(rig_to_yaml(load_rig("card_press")), "card_press")


@pytest.mark.parametrize("name", names_in("rigs"))
def test_rigs_of_the_package_survive_a_round_trip(name: str) -> None:
    rig = load_rig(name)
    assert rig.name == name
    assert rig.description
    assert parse_rig(parse_mapping(rig_to_yaml(rig), name), name) == rig


def test_preset_is_filled_in_and_overridden() -> None:
    data = raw()
    data["bodies"]["card"]["material"] = {"preset": "card_200gsm", "E_pa": 1.5e9}
    material = parse_rig(data, "test").bodies["card"].material
    assert material.E_pa == 1.5e9
    assert material.thickness_m == PRESETS["card_200gsm"].thickness_m


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_presets_are_valid_and_cited(name: str) -> None:
    preset = PRESETS[name]
    assert len(preset.source) > 20
    data = raw()
    data["bodies"]["gel"]["material"] = {"preset": name}
    if preset.thickness_m is not None:
        data["bodies"]["card"]["material"] = {"preset": name}
    parse_rig(data, "test")


def test_a_material_that_is_no_sheet_needs_a_thickness() -> None:
    data = raw()
    data["bodies"]["card"]["material"] = {"preset": "ecoflex_00_30"}
    with pytest.raises(ConfigError, match=r"card\.material\.thickness_m is missing"):
        parse_rig(data, "test")


def test_a_rig_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        load_rig("card_press").name = "other"


def test_poses_agree_with_hand_calculation() -> None:
    data = raw()
    data["end_effectors"]["finger"]["start"] = {"position_m": [1, 2, 3], "rpy_deg": [90, 0, 90]}
    pose = parse_rig(data, "test").end_effectors["finger"].start
    # Roll takes y to z; yaw about the fixed z then takes x to y.
    np.testing.assert_allclose(pose.matrix() @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-12)
    np.testing.assert_allclose(pose.matrix() @ [0, 1, 0, 1], [1, 2, 4, 1], atol=1e-12)
    data["end_effectors"]["finger"]["start"] = {
        "position_m": [1, 2, 3],
        "quaternion_xyzw": list(pose.quaternion()),
    }
    again = parse_rig(data, "test").end_effectors["finger"].start
    np.testing.assert_allclose(again.matrix(), pose.matrix(), atol=1e-12)


def card(data: dict[str, Any]) -> dict[str, Any]:
    return data["bodies"]["card"]


FAULTS: dict[str, tuple[Edit, str]] = {
    "unit of another size": (
        lambda d: card(d)["material"].update(thickness_mm=0.2),
        r"thickness_mm is not a key .* write thickness_m: 0\.0002",
    ),
    "unit left out": (lambda d: card(d)["material"].update(thickness=2e-4), r"Write thickness_m"),
    "modulus in MPa": (lambda d: card(d)["material"].update(E_MPa=2000), r"write E_pa: 2e\+09"),
    "misspelt key": (lambda d: card(d).update(materal={}), r"Did you mean 'material'\?"),
    "misspelt top key": (lambda d: d.update(gravity=[0, 0, -9.81]), r"Write gravity_m_s2"),
    "number as text": (lambda d: card(d)["material"].update(E_pa="2e9 Pa"), r"not a number.*without a unit"),
    "truth value as number": (lambda d: card(d)["material"].update(E_pa=True), r"not a number"),
    "not a number": (lambda d: card(d)["material"].update(nu=float("nan")), r"not a finite number"),
    "above its bound": (lambda d: card(d)["material"].update(nu=0.7), r"is 0\.7, but must be at most 0\.5"),
    "length in mm": (lambda d: card(d)["shape"].update(length_m=100.0), r"at most 10.*unit is m"),
    "thickness in mm": (lambda d: card(d)["material"].update(thickness_m=0.2), r"at most 0\.02.*unit is m"),
    "unknown kind": (lambda d: card(d).update(type="shet"), r"Did you mean 'sheet'"),
    "kind left out": (lambda d: card(d).pop("type"), r"bodies\.card\.type is missing"),
    "half a number of cells": (
        lambda d: card(d)["shape"].update(cells=[1.5, 2]),
        r"cells\[0\].*whole number",
    ),
    "too few numbers": (lambda d: card(d)["shape"].update(cells=[20]), r"list of 2"),
    "a number for a body": (lambda d: d["bodies"].update(card=3), r"bodies\.card is 3, not a mapping"),
    "no bodies": (lambda d: d.update(bodies={}), r"bodies"),
    "bad name": (lambda d: d["bodies"].update({"My Card": card(d)}), r"small letters"),
    "name taken": (lambda d: d["bodies"].update(finger=card(d)), r"taken"),
    "unknown preset": (
        lambda d: card(d).update(material={"preset": "paper"}),
        r"preset 'paper'.*paper_80gsm",
    ),
    "two orientations": (
        lambda d: card(d).update(pose={"rpy_deg": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 1]}),
        r"both rpy_deg and quaternion_xyzw",
    ),
    "long quaternion": (lambda d: card(d).update(pose={"quaternion_xyzw": [1, 0, 0, 1]}), r"length 1\.41421"),
    "mount unknown": (lambda d: d["bodies"]["gel"].update(mount="fingr"), r"Did you mean 'finger'"),
    "bond without mount": (lambda d: d["bodies"]["gel"].pop("mount"), r"bonded but no mount"),
    "no such face": (lambda d: d["bodies"]["gel"].update(bonded="left"), r"no face of a block"),
    "clamp off the body": (
        lambda d: d["clamps"][0].update(region={"x_m": [-50, -45]}),
        r"misses 'card': it reaches from -0\.05 to 0\.05",
    ),
    "clamp upside down": (lambda d: d["clamps"][0].update(region={"x_m": [0, -0.05]}), r"\[lower, upper\]"),
    "contact with nobody": (
        lambda d: d["contacts"][0].update(between=["gel", "crad"]),
        r"Did you mean 'card'",
    ),
    "contact of one": (lambda d: d["contacts"][0].update(between=["gel"]), r"list of 2"),
    "contact listed twice": (
        lambda d: d["contacts"].append({"between": ["card", "gel"]}),
        r"a second time",
    ),
    "sensor on nothing": (lambda d: d["sensors"]["wrench_gel"].update(on="vise"), r"Did you mean 'vice'"),
    "grid without face": (
        lambda d: d["sensors"]["gel_markers"].update(points={"grid": [5, 5]}),
        r"face is missing",
    ),
    "grid and list": (
        lambda d: d["sensors"]["gel_markers"].update(points={"grid": [5, 5], "positions_m": [[0, 0, 0]]}),
        r"either grid or positions_m",
    ),
    "marker off the body": (
        lambda d: d["cameras"]["outside"]["sees"][0].update(points={"positions_m": [[50, 0, 0]]}),
        r"outside of 'card'",
    ),
    "a topic twice": (
        lambda d: d["sensors"]["gel_markers"].update(topic="tactile/left/wrench"),
        r"which is also sensors\.wrench_gel\.topic",
    ),
    "topic with a space": (
        lambda d: d["sensors"]["gel_markers"].update(topic="my markers"),
        r"as ROS names do",
    ),
    "lens of the wrong kind": (lambda d: d["cameras"]["outside"].update(distortion=[0.1]), r"list of 5"),
    "camera sees a rigid body": (
        lambda d: (
            d["bodies"].update(ball={"type": "rigid", "shape": {"type": "sphere", "radius_m": 0.01}}),
            d["cameras"]["outside"]["sees"][0].update(body="ball"),
        ),
        r"no such sheet, gel or affine body",
    ),
    "dome without a wall": (
        lambda d: d["bodies"]["gel"].update(
            shape={"type": "dome", "radius_m": 0.01, "cavity_radius_m": 0.02, "cells": [4, 2, 1]},
            bonded="base",
        ),
        r"must be less than radius_m",
    ),
    "outline without area": (
        lambda d: card(d).update(shape={"type": "outline", "polygon_m": [[0, 0], [1, 1], [2, 2]], "edge_m": 0.1}),
        r"encloses no area",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_rig_is_refused_with_a_remedy(fault: str) -> None:
    edit, pattern = FAULTS[fault]
    data = raw()
    edit(data)
    with pytest.raises(ConfigError, match=pattern) as caught:
        parse_rig(data, "my_rig.yaml")
    assert caught.value.problem.startswith("my_rig.yaml: ")
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


YAML_FAULTS = {
    "empty": ("", r"is empty"),
    "comment only": ("# nothing\n", r"is empty"),
    "a list": ("- 1\n- 2\n", r"not a mapping"),
    "a word": ("hello\n", r"not a mapping"),
    "key twice": ("a: 1\nb: 2\na: 3\n", r"line 3.*'a' is given twice"),
    "nested key twice": ("a:\n  b: 1\n  b: 1\n", r"line 3.*given twice"),
    "tab": ("a:\n\tb: 1\n", r"line 2.*tab"),
    "open bracket": ("a: [1, 2\nb: 3\n", r"line 2"),
    "python object": ("a: !!python/object/apply:os.system ['true']\n", r"could not determine a constructor"),
    "control character": ("a: \x07\n", r"is not YAML"),
}


@pytest.mark.parametrize("fault", YAML_FAULTS)
def test_faulty_yaml_is_refused(fault: str, tmp_path: Path) -> None:
    text, pattern = YAML_FAULTS[fault]
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=pattern) as caught:
        load_rig(path)
    assert str(path) in str(caught.value)


def test_numbers_are_read_as_yaml_1_2_does() -> None:
    data = parse_mapping("a: 1e6\nb: 010\nc: on\nd: -1.5e-3\ne: 2024-01-01\nf: 12:30\ng: .5\nh: ~\n", "text")
    assert data == {
        "a": 1e6,
        "b": 10,
        "c": "on",
        "d": -1.5e-3,
        "e": "2024-01-01",
        "f": "12:30",
        "g": 0.5,
        "h": None,
    }


def test_missing_file_names_a_similar_one(tmp_path: Path) -> None:
    (tmp_path / "my_rig.yaml").write_text("a: 1\n")
    with pytest.raises(ConfigError, match=r"does not exist\. Did you mean 'my_rig.yaml'"):
        load_rig(tmp_path / "my_rigg.yaml")


def test_overlay_changes_values_and_switches_effects_on(tmp_path: Path) -> None:
    path = tmp_path / "soft.yaml"
    path.write_text(
        "overlay_of: card_press\nname: soft\nparameters: {card.E: 1.0e9}\n"
        "effects: {air_drag: {drag_coefficient: 0.5}}\n"
    )
    second = tmp_path / "softer.yaml"
    second.write_text("overlay_of: soft\nparameters: {gel.E: 1.0e5}\n")
    rig: Rig = load_rig(second)
    assert rig.name == "soft"
    assert rig.bodies["card"].material.E_pa == 1e9
    assert rig.bodies["gel"].material.E_pa == 1e5
    assert rig.effects == {"air_drag": {"drag_coefficient": 0.5}}


def test_overlays_in_a_circle_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("overlay_of: b\n")
    (tmp_path / "b.yaml").write_text("overlay_of: a.yaml\n")
    with pytest.raises(ConfigError, match="circle"):
        load_rig(tmp_path / "a.yaml")
