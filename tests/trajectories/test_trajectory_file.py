"""Trajectory files: what is written is read back, and what is no trajectory is refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.rigs import Rig, config_folder, load_rig, with_parameters
from sim_core.rigs.digest import rig_sha256
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.rigs.yamlfile import validate
from sim_core.trajectories import (
    EffectorPath,
    Limits,
    MarkerPrediction,
    Passage,
    Prediction,
    Trajectory,
    WrenchPrediction,
    make_trajectory,
    parse_trajectory,
    read_trajectory,
    rollout,
    write_csv,
    write_trajectory,
)

LEAST = {
    "format": "thinshell_trajectory",
    "version": 1,
    "units": "SI",
    "quaternion_order": "xyzw",
    "times_s": [0.0, 0.5],
    "end_effectors": {
        "hand": {
            "frame_id": "base_link",
            "positions_m": [[0.0, 0.0, 0.1], [0.0, 0.0, 0.2]],
            "quaternions_xyzw": [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]],
        }
    },
}
"""The least that a file has to say."""


def changed(path: str, value: Any) -> dict[str, Any]:
    """The least file with one value changed, or taken out where it is None."""
    data: dict[str, Any] = json.loads(json.dumps(LEAST))
    *parents, last = path.split(".")
    here = data
    for key in parents:
        here = here.setdefault(key, {})
    if value is None:
        del here[last]
    else:
        here[last] = value
    return data


def arrays_of(value: Any, where: str = "") -> dict[str, Any]:
    """All values of a trajectory by their place."""
    if hasattr(type(value), "model_fields"):
        value = dict(value)
    if isinstance(value, dict):
        return {k: v for key, item in value.items() for k, v in arrays_of(item, f"{where}.{key}").items()}
    return {where: value}


def assert_same(first: Trajectory, second: Trajectory) -> None:
    one, other = arrays_of(first), arrays_of(second)
    assert one.keys() == other.keys()
    for key, value in one.items():
        np.testing.assert_array_equal(value, other[key], err_msg=key)


numbers = st.floats(-10.0, 10.0, allow_subnormal=False)


@st.composite
def trajectories(draw: st.DrawFn) -> Trajectory:
    """Any trajectory of one to three end effectors, with or without a gripper and predictions."""
    count = draw(st.integers(2, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    steps = draw(st.lists(st.floats(1e-4, 10.0), min_size=count - 1, max_size=count - 1))
    data: dict[str, Any] = {"times_s": np.concatenate([[0.0], np.cumsum(steps)]), "end_effectors": {}}
    for name in draw(st.sets(st.sampled_from(["left", "right", "hand"]), min_size=1)):
        data["end_effectors"][name] = {
            "frame_id": "base_link",
            "positions_m": draw(st.lists(st.lists(numbers, min_size=3, max_size=3), min_size=count, max_size=count)),
            "quaternions_xyzw": Rotation.random(count, rng).as_quat(),
            "gripper_closing_m": rng.random(count) if draw(st.booleans()) else None,
        }
    if draw(st.booleans()):
        wrench = {"frame_id": "pad", "forces_n": rng.random((count, 3)), "torques_nm": rng.random((count, 3))}
        if draw(st.booleans()):
            wrench["force_sds_n"] = rng.random((count, 3))
        markers = {"frame_id": "pad", "ids": [0, 7], "positions_m": rng.random((count, 2, 3))}
        data["predicted"] = {"wrenches": {"pad": wrench}, "markers": {"gel": markers}}
    limits = draw(st.sampled_from([{}, {"max_force_n": 3.5, "workspace_min_m": [0.0, -1.0, 0.0]}]))
    return validate(Trajectory, {**data, "name": draw(st.text()), "limits": limits}, "drawn")


@settings(max_examples=25, deadline=None)
@given(trajectory=trajectories())
def test_what_is_written_is_read_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, trajectory: Trajectory
) -> None:
    path = tmp_path_factory.mktemp("t") / "t.json"
    write_trajectory(path, trajectory)
    assert_same(read_trajectory(path), trajectory)
    assert not list(path.parent.glob(".*")), "nothing unfinished is left"


def test_the_least_file_is_read_and_has_the_meaning_that_the_keys_say() -> None:
    trajectory = parse_trajectory(json.dumps(LEAST), "t.json")
    position, quaternion = trajectory.poses()["hand"].at(0.5)
    assert position.tolist() == [0.0, 0.0, 0.2]
    np.testing.assert_allclose(np.abs(quaternion), [0.0, 0.0, 1.0, 0.0], atol=1e-15)
    assert trajectory.duration_s == 0.5
    assert trajectory.limits == Limits()


def test_the_example_of_the_documentation_is_a_trajectory_and_names_every_key() -> None:
    text = (Path(__file__).parents[2] / "docs" / "trajectories.md").read_text()
    example = text.split("```json\n")[1].split("```")[0]
    trajectory = parse_trajectory(example, "docs")
    assert trajectory.predicted.wrenches["wrench_gel"].forces_n[2].tolist() == [0.0, 0.0, -0.1]
    for part in (Trajectory, EffectorPath, Limits, Prediction, WrenchPrediction, MarkerPrediction, Passage):
        for key in set(part.model_fields) - {
            "end_effectors",
            "predicted",
            "rig",
            "limits",
            "provenance",
            "wrenches",
            "markers",
        }:
            assert f"{key}`" in text, f"{part.__name__}.{key}"


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (changed("format", "other"), 'no "format": "thinshell_trajectory"'),
        ([1, 2], "is no trajectory"),
        (changed("version", 3), "version 3 of the format, and this release reads versions up to 2"),
        (changed("version", "1"), "version is the text '1', not a whole number"),
        (changed("units", None), "units is missing"),
        (changed("units", "mm"), "units is the text 'mm'. Choose one of: 'SI'"),
        (changed("quaternion_order", "wxyz"), "Choose one of: 'xyzw'"),
        (changed("times_s", [0.0, 0.0]), r"times_s does not begin with 0 and increase .*\(row 1\)"),
        (changed("times_s", [0.1, 0.2]), r"does not begin with 0"),
        (changed("times_s", [0.0, 0.5, 1.0]), r"hand.positions_m has 2 rows, and there are 3 times"),
        (changed("times_s", None), "times_s is missing"),
        (changed("end_effectors", {}), "end_effectors is a mapping"),
        (changed("end_effectors.hand.positions_m", [[0, 0], [0, 0]]), "positions_m has the shape 2 x 2"),
        (changed("end_effectors.hand.positions_m", [[0, 0, 0], [0, 0]]), "positions_m is .* no array of numbers"),
        (changed("end_effectors.hand.positions_m", [["a", 0, 0]] * 2), "no array of numbers"),
        (changed("end_effectors.hand.positions_m", [["1", 0, 0]] * 2), "no array of numbers"),
        (changed("end_effectors.hand.positions_m", [[0, 0, 0], [0, 0, None]]), "no array of numbers"),
        (changed("end_effectors.hand.positions_m", [[0, 0, 0], [1e10, 0, 0]]), r"value above 1e\+09 in row 1"),
        (changed("end_effectors.hand.positions_m", [[0, 0, 0], [0, 0, 1e999]]), "not a finite number"),
        (changed("end_effectors.hand.positions_mm", [[0, 0, 0]]), "write positions_m"),
        (changed("end_effectors.hand.quaternions_xyzw", [[0, 0, 0, 1], [0, 0, 0, 2]]), "length 2 in row 1"),
        (changed("end_effectors.hand.gripper_closing_m", [0.0]), "gripper_closing_m has 1 rows"),
        (changed("limits", {"max_force_n": -1.0}), "limits.max_force_n is -1.0, but must be greater than 0"),
        (changed("limits", {"max_force": 1.0}), "Write max_force_n: this quantity is given in N"),
        (changed("limits", {"workspace_min_m": [0, 0, 0], "workspace_max_m": [0, 1, 1]}), "is not below"),
        (changed("rig", {"name": "r", "sha256": "12"}), "rig.sha256"),
        (changed("predicted.wrenches.pad", {"frame_id": "pad", "forces_n": [[0, 0, 0]] * 2}), "torques_nm is missing"),
        (
            changed("predicted.markers.pad", {"frame_id": "pad", "ids": [1], "positions_m": [[[0, 0, 0]] * 2] * 2}),
            "names 1 markers, and there are positions of 2",
        ),
        (
            changed(
                "predicted.markers.pad",
                {
                    "frame_id": "pad",
                    "ids": [1],
                    "positions_m": [[[0, 0, 0]]] * 2,
                    "position_sds_m": [[[0, 0, 0]], [[0, 0, -1e-3]]],
                },
            ),
            "position_sds_m is negative in row 1",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_its_place(data: Any, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as caught:
        parse_trajectory(json.dumps(data), "t.json")
    assert str(caught.value).startswith("t.json")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is not JSON"),
        (json.dumps(LEAST).encode()[:-30], "A file that was cut short ends so"),
        (b'{"a": 1, "a": 2}', "the key 'a' twice"),
        (b"\x93NUMPY\xff", "not a text file in UTF-8"),
        (b"[" * 100_000, "is not a trajectory"),
        (b'{"format": NaN}', "holds NaN"),
    ],
)
def test_a_file_that_is_no_trajectory_is_refused(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "t.json"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=said):
        read_trajectory(path)


def test_places_that_cannot_be_read_or_written_are_reported(tmp_path: Path) -> None:
    trajectory = parse_trajectory(json.dumps(LEAST), "t.json")
    with pytest.raises(ConfigError, match="does not exist"):
        read_trajectory(tmp_path / "none.json")
    with pytest.raises(ConfigError, match="is a folder"):
        read_trajectory(tmp_path)
    with pytest.raises(ConfigError, match="cannot be written"):
        write_trajectory(tmp_path / "none" / "t.json", trajectory)
    write_trajectory(tmp_path / "t.json", trajectory)
    with pytest.raises(ConfigError, match="already exists"):
        write_trajectory(tmp_path / "t.json", trajectory)


def test_a_table_has_the_poses(tmp_path: Path) -> None:
    trajectory = parse_trajectory(json.dumps(LEAST), "t.json")
    write_csv(tmp_path / "t.csv", trajectory, "hand")
    table = np.genfromtxt(tmp_path / "t.csv", delimiter=",", names=True)
    assert table.dtype.names == ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
    assert table["z_m"].tolist() == [0.1, 0.2]
    assert table["qz"].tolist() == [0.0, 1.0]
    with pytest.raises(ConfigError, match="It moves hand"):
        write_csv(tmp_path / "u.csv", trajectory, "foot")


def test_the_stricter_limit_counts_each_by_itself() -> None:
    first = Limits(max_force_n=3.0, workspace_min_m=(0.0, 0.0, 0.0), max_speed_m_s=1.0)
    second = Limits(max_force_n=2.0, workspace_min_m=(-1.0, 0.5, 0.0), max_torque_nm=1.0)
    both = first.stricter(second)
    assert both == second.stricter(first)
    assert (both.max_force_n, both.max_speed_m_s, both.max_torque_nm) == (2.0, 1.0, 1.0)
    assert both.workspace_min_m == (0.0, 0.5, 0.0)
    assert both.workspace_max_m is None


def test_the_digest_is_of_the_content(tmp_path: Path) -> None:
    rig = load_rig("mug_side")
    shutil.copytree(config_folder() / "meshes", tmp_path / "config" / "meshes")
    shutil.copytree(config_folder() / "rigs", tmp_path / "config" / "rigs")
    elsewhere = load_rig(tmp_path / "config" / "rigs" / "mug_side.yaml")
    assert rig_sha256(elsewhere) == rig_sha256(rig), "the place of its mesh does not count"
    assert rig_sha256(rig.model_copy(update={"description": "other words"})) == rig_sha256(rig)
    assert rig_sha256(rig.model_copy(update={"gravity_m_s2": (0.0, 0.0, -9.8)})) != rig_sha256(rig)
    mesh = next(p for p in (tmp_path / "config" / "meshes").glob("mug_side*"))
    mesh.write_text(mesh.read_text() + "\n# changed\n")
    assert rig_sha256(elsewhere) != rig_sha256(rig)
    mesh.unlink()
    with pytest.raises(ConfigError, match="cannot be read"):
        rig_sha256(elsewhere)


def test_a_rollout_becomes_the_prediction(
    small_rig: Callable[..., Rig], visit: Callable[..., dict[str, PoseTrajectory]]
) -> None:
    """Two rollouts of different cards: mean and standard deviation, on the time grid of the trajectory."""
    rig = small_rig()
    times = np.linspace(0.0, 0.2, 11)
    poses = visit(times.tolist(), np.outer(np.linspace(0.0, 1.0, 11), [0.0, 0.0, -0.004]).tolist())
    soft, stiff = (rollout(with_parameters(rig, {"card.E_pa": modulus}), poses) for modulus in (1e9, 4e9))
    trajectory = make_trajectory(rig, poses, traces=[soft, stiff])
    wrench = trajectory.predicted.wrenches["wrench"]
    first, second = (trace.at("wrench", times)[-1] for trace in (soft, stiff))
    assert np.linalg.norm(first - second) > 1e-3
    assert wrench.force_sds_n is not None
    np.testing.assert_allclose(wrench.forces_n[-1], (first + second)[:3] / 2, rtol=1e-12)
    np.testing.assert_allclose(wrench.force_sds_n[-1], np.abs(first - second)[:3] / np.sqrt(2.0), rtol=1e-9)
    assert trajectory.predicted.markers["markers"].positions_m.shape == (11, 9, 3)
    assert trajectory.rig is not None
    assert trajectory.rig.sha256 == rig_sha256(rig)
    with pytest.raises(ConfigError, match="no end effector 'toe'"):
        make_trajectory(rig, {"toe": poses["finger"]})
