"""Rigs and motions that are made wrong on purpose are reported, each for what it is; those that ship are not."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from sim_core.preflight import review
from sim_core.rigs import Rig, load_rig, parse_rig
from sim_core.rigs.load import config_folder, names_in
from sim_core.rigs.motion import Experiment, compile_experiment, load_experiment
from sim_core.rigs.yamlfile import read_mapping


def raw(name: str) -> dict[str, Any]:
    return read_mapping(config_folder() / "rigs" / f"{name}.yaml")


def kinds(rig: Rig, motion: Experiment | None = None) -> list[str]:
    poses = None if motion is None else compile_experiment(motion, rig)
    return [finding.kind for finding in review(rig, poses)]


def slide(by: list[float]) -> Experiment:
    return Experiment.model_validate({"name": "slide", "motions": {"finger": [{"type": "slide", "by_m": by}]}})


@pytest.mark.parametrize("name", names_in("rigs"))
def test_no_rig_that_ships_looks_wrong(name: str) -> None:
    assert review(load_rig(name)) == []


@pytest.mark.parametrize(("rig", "experiment"), [
    ("gel_sensor", "press_twist"), ("card_press", "press_post"), ("card_press", "press_far"), ("lifting", "lift"),
    ("push_block", "push"), ("forming", "form"), ("bouncing", "fall"),
])  # fmt: skip
def test_no_experiment_that_ships_looks_wrong(rig: str, experiment: str) -> None:
    chosen = load_rig(rig)
    assert review(chosen, compile_experiment(load_experiment(experiment), chosen)) == []


def test_a_slide_in_air_is_reported_with_how_near_it_comes() -> None:
    rig = load_rig("gel_sensor")
    poses = compile_experiment(slide([0.01, 0.0, -0.0004]), rig)
    (finding,) = review(rig, poses)
    assert finding.kind == "no contact"
    assert "gel and block come within 0.6 mm" in finding.problem


@pytest.mark.parametrize(("depth", "found"), [(0.00095, ["no contact"]), (0.00105, [])])
def test_a_press_that_just_touches_is_not_reported(depth: float, found: list[str]) -> None:
    assert kinds(load_rig("gel_sensor"), slide([0.0, 0.0, -depth])) == found


def test_a_sheet_that_may_droop_to_what_it_is_to_touch_is_not_reported() -> None:
    data = raw("card_press")
    data["contacts"] = data["contacts"][:1]
    data["end_effectors"]["finger"]["start"]["position_m"] = [0.03, 0.0, 0.09]
    assert kinds(parse_rig(data, "droop"), slide([0.001, 0.0, 0.0])) == []


def test_a_gel_that_is_bonded_towards_the_object_is_reported() -> None:
    data = raw("gel_sensor")
    data["bodies"]["gel"]["bonded"] = "top"
    data["cameras"] = {}
    (finding,) = review(parse_rig(data, "upside"))
    assert finding.kind == "bonded face"
    assert "points at block" in finding.problem


def test_a_gel_that_is_turned_towards_the_finger_is_reported() -> None:
    data = raw("gel_sensor")
    data["bodies"]["gel"]["pose"]["rpy_deg"] = [0.0, 0.0, 0.0]
    assert "bonded face" in kinds(parse_rig(data, "turned"))


def test_a_camera_that_looks_away_is_reported_with_where_the_markers_are() -> None:
    data = raw("gel_sensor")
    data["cameras"]["inside"]["pose"]["rpy_deg"] = [0.0, 0.0, 0.0]
    (finding,) = review(parse_rig(data, "away"))
    assert finding.kind == "camera blind"
    assert "behind it" in finding.problem and "49 markers" in finding.problem


def test_a_camera_that_looks_aside_is_reported_by_how_much() -> None:
    data = raw("gel_sensor")
    data["cameras"]["inside"]["pose"]["rpy_deg"] = [180.0, 60.0, 0.0]
    (finding,) = review(parse_rig(data, "aside"))
    assert finding.kind == "camera blind"
    assert "60 deg off its axis" in finding.problem


def test_markers_outside_of_the_picture_are_counted() -> None:
    data = raw("gel_sensor")
    data["cameras"]["inside"] |= {"fx_px": 1900.0, "fy_px": 1900.0}
    (finding,) = review(parse_rig(data, "zoomed"))
    assert finding.kind == "markers outside"
    # 30 mm before the camera the picture reaches 5.0 mm to the sides and 3.8 mm up and down; the outermost of the seven
    # rows and columns are at 5.1 mm, the next at 3.4 mm: 5 x 5 are left.
    assert finding.problem.startswith("24 of the 49 markers")


def test_markers_that_leave_the_picture_of_a_fixed_camera_are_reported() -> None:
    data = raw("gel_sensor")
    data["cameras"]["inside"] |= {"mount": "world", "pose": {"position_m": [0.0, 0.0, 0.031], "rpy_deg": [180, 0, 0.0]}}
    data["cameras"]["inside"]["pose"]["rpy_deg"] = [180.0, 0.0, 0.0]
    rig = parse_rig(data, "fixed")
    assert "markers outside" not in kinds(rig, slide([0.0, 0.0, -0.0015]))
    assert "markers outside" in kinds(rig, slide([0.02, 0.0, -0.0015]))


def test_markers_behind_a_rigid_body_are_reported() -> None:
    data = raw("card_press")
    data["cameras"]["outside"]["pose"] = {"position_m": [0.30, 0.0, 0.03], "rpy_deg": [-90.0, 0.0, 90.0]}
    found = review(parse_rig(data, "behind"))
    assert [f.kind for f in found] == ["markers hidden"]
    assert "post stands before them" in found[0].problem


def test_markers_on_the_glued_face_are_reported() -> None:
    data = raw("gel_sensor")
    data["cameras"]["inside"]["sees"][0]["points"]["face"] = "bottom"
    found = review(parse_rig(data, "glued"))
    assert any(f.kind == "markers hidden" and "glued to finger" in f.problem for f in found)


def test_markers_on_the_far_side_for_a_camera_outside_are_reported() -> None:
    data = raw("gel_sensor")
    data["cameras"]["inside"]["mount"] = "world"
    found = review(parse_rig(data, "far"))
    assert any(f.kind == "markers hidden" and "far side of gel" in f.problem for f in found)


@pytest.mark.parametrize("declared", [True, False])
def test_a_gel_in_a_rigid_body_is_reported_with_its_depth(declared: bool) -> None:
    data = raw("gel_sensor")
    data["end_effectors"]["finger"]["start"]["position_m"] = [0.0, 0.0, 0.0035]
    if not declared:
        data["contacts"] = []
    found = [f for f in review(parse_rig(data, "sunk")) if f.kind == "bodies overlap"]
    assert len(found) == 1
    assert "by 0.5 mm" in found[0].problem
    assert ("no contact is declared" in found[0].problem) is not declared


def test_a_sheet_through_a_gel_is_reported() -> None:
    data = raw("card_press")
    data["end_effectors"]["finger"]["start"]["position_m"] = [0.03, 0.0, 0.052]
    assert kinds(parse_rig(data, "through")) == ["bodies overlap"]


def test_a_block_within_a_gel_is_reported() -> None:
    data = raw("gel_sensor")
    inner = {"type": "affine", "shape": {"type": "box", "size_m": [0.001] * 3}, "material": {"density_kg_m3": 1000.0},
             "pose": {"position_m": [0.0, 0.0, 0.003]}}  # fmt: skip
    wrong = copy.deepcopy(data)
    wrong["bodies"]["bead"] = inner
    assert "bodies overlap" in kinds(parse_rig(wrong, "within"))
