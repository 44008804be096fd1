"""A camera that does not stand where the rig says: readings, derivatives, and fits that allow for it."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from strip import START, TRUTH, pulled, strip_rig

from sim_core.rigs import Rig, parse_rig, with_parameters
from sim_core.rigs.motion import Experiment
from sim_core.rigs.pose_offset import OFFSETS
from sim_core.scene import build_scene
from sim_core.simulate import simulate
from sysid.fit import FitOptions, fit_runs
from sysid.gradients import check_gradients
from sysid.model.parallel_predictor import ParallelPredictor

PRESS = Experiment.model_validate(
    {"name": "press", "motions": {"finger": [{"type": "press", "depth_m": 0.006, "speed_m_s": 0.05}]}}
)
ASKEW = dict(zip(OFFSETS, (2e-3, -1e-3, 3e-3, 0.5, -0.8, 1.5), strict=True))


def off(rig: Rig, camera: str, **offset: float) -> Rig:
    return with_parameters(rig, {f"{camera}.{key}": value for key, value in offset.items()})


def test_an_offset_is_a_shift_and_a_turn_in_the_camera_s_own_frame(small_rig: Any, visit: Any) -> None:
    """As if the pose itself said so."""
    rig = small_rig()
    pose = rig.cameras["side"].pose
    shift, turn = np.array(list(ASKEW.values())[:3]), Rotation.from_rotvec(list(ASKEW.values())[3:], degrees=True)
    data = copy.deepcopy(rig.model_dump(exclude_none=True))
    data["cameras"]["side"]["pose"] = {
        "position_m": (pose.position() + pose.rotation().apply(shift)).tolist(),
        "quaternion_xyzw": (pose.rotation() * turn).as_quat().tolist(),
    }
    moved, stated, plain = (
        simulate(build_scene(r), visit([0.0], [[0.0, 0.0, 0.0]]), np.zeros(1)).outputs["side"]
        for r in (parse_rig(data, "moved"), off(rig, "side", **ASKEW), rig)
    )
    np.testing.assert_allclose(stated, moved, atol=1e-9)
    assert np.nanmax(np.abs(stated - plain)) > 5.0


@pytest.mark.parametrize("offset", [{}, ASKEW])
def test_derivatives_by_where_a_camera_stands_match_differences(small_rig: Any, offset: dict[str, float]) -> None:
    """Of the offsets themselves, and of what bends the card before a camera that stands askew."""
    rig = off(small_rig(), "side", **offset)
    names = [*(f"side.{key}" for key in OFFSETS), "card.E"]
    passed, text = check_gradients(rig, PRESS, names, steps=(1e-2, 1e-3, 1e-4), until_s=0.1)
    assert passed, text


@pytest.mark.parametrize("stated", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_fit_allows_for_a_camera_that_was_not_measured_exactly(
    workers: ParallelPredictor, tmp_path: Path, stated: bool
) -> None:
    """The camera has slipped by a millimetre and half a degree; the rig says that it may have, or not."""
    rig = strip_rig()
    (camera,) = rig.cameras
    run = pulled(rig, {**TRUTH, f"{camera}.offset_y_m": 1e-3, f"{camera}.offset_rz_deg": 0.5}, tmp_path / "bag")
    data = with_parameters(rig, START).model_dump(exclude_none=True)
    if stated:
        data["cameras"][camera] |= {"offset_sd_m": (1e-3,) * 3, "offset_sd_deg": (0.5,) * 3}
    options = FitOptions(nuisance=("camera",), intervals="quadratic")
    result, _ = fit_runs(parse_rig(data, "start"), [run], list(TRUTH), options, engine=workers)
    found = {n.name: n for n in result.nuisances}
    assert (f"{camera}.offset_rz_deg" in found) == stated
    if stated:
        assert result.reduced_chi2 < 1.1
        assert all(e.ci95[0] <= TRUTH[e.name] <= e.ci95[1] for e in result.estimates)
        turn = found[f"{camera}.offset_rz_deg"]
        assert turn.far and abs(turn.value - 0.5) < 4.0 * turn.sd
        assert any(r.startswith(f"The camera {camera} is turned by") for r in result.remarks)
    else:
        assert result.unexplained and not any("into the rig" in said for said in result.remarks)
