"""Random motions: within their bounds and speeds, smooth, the same for a seed."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.rigs import load_rig
from sim_core.rigs.motion import Experiment, compile_experiment
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.rigs.yamlfile import validate

RIG = load_rig("card_press")
START = RIG.end_effectors["finger"].start.position()
BOUNDS_M, BOUNDS_DEG = np.array([0.004, 0.0, 0.002]), np.array([3.0, 8.0, 0.0])
CENTRE = {"position_m": [0.01, 0.0, -0.003], "rpy_deg": [0.0, 20.0, 0.0]}


def run(**changes: Any) -> PoseTrajectory:
    motion = {
        "type": "random",
        "duration_s": 40.0,
        "bounds_m": BOUNDS_M.tolist(),
        "bounds_deg": BOUNDS_DEG.tolist(),
        "speed_m_s": 0.02,
        "speed_deg_s": 40.0,
        "seed": 5,
        **changes,
    }
    data = {"name": "test", "command_rate_hz": 500.0, "motions": {"finger": [motion]}}
    return compile_experiment(validate(Experiment, data, "test.yaml"), RIG)["finger"]


def test_it_stays_within_bounds_and_uses_most_of_them() -> None:
    path = run(centre=CENTRE)
    inside = path.times > 3.0  # it has come to the centre
    shifts = np.abs(path.positions[inside] - START - CENTRE["position_m"])
    turns = Rotation.from_quat(path.quaternions[inside]) * Rotation.from_euler("y", 20.0, degrees=True).inv()
    angles = np.abs(np.rad2deg(turns.as_rotvec()))
    for reached, bounds in ((shifts.max(axis=0), BOUNDS_M), (angles.max(axis=0), BOUNDS_DEG)):
        assert np.all(reached <= bounds + 1e-9)
        assert np.all(reached >= 0.6 * bounds)


def test_speeds_stay_below_the_highest_and_are_no_small_part_of_it() -> None:
    linear, angular = run(bounds_deg=[0.0, 0.0, 0.0]).speeds()
    assert 0.2 * 0.02 < linear.max() < 0.02
    linear, angular = run(speed_m_s=1.0).speeds()
    assert 0.2 * 40.0 < np.rad2deg(angular.max()) < 40.0


def test_it_is_smooth_and_begins_and_ends_at_rest_at_the_centre() -> None:
    path = run()
    dt = path.times[1] - path.times[0]
    jerk = np.diff(path.positions, n=3, axis=0) / dt**3
    # The third derivative of a cubic spline has a bound, whatever the step: 8 times the bound over the span cubed.
    span = 2.0 * max(np.linalg.norm(BOUNDS_M) / 0.02, np.linalg.norm(BOUNDS_DEG) / 40.0)
    assert np.abs(jerk).max() < 8.0 * BOUNDS_M.max() / span**3
    for end in (0, -1):
        np.testing.assert_allclose(path.positions[end], START, atol=1e-12)
        np.testing.assert_allclose(np.abs(path.quaternions[end]), [0, 0, 0, 1], atol=1e-12)
    linear, _ = path.speeds()
    assert linear[[0, -1]].max() < 1e-4 * linear.max()


def test_a_seed_gives_the_same_motion_bit_by_bit_and_another_one_another() -> None:
    one, same, other = run(), run(), run(seed=6)
    assert one.positions.tobytes() == same.positions.tobytes()
    assert one.quaternions.tobytes() == same.quaternions.tobytes()
    assert np.abs(one.positions - other.positions).max() > 1e-3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"bounds_m": [0.0, 0.0, 0.0], "bounds_deg": [0.0, 0.0, 0.0]}, "all 0"),
        ({"duration_s": 0.5}, "too short"),
        ({"bounds_deg": [170.0, 170.0, 0.0]}, "more than 180"),
        ({"bounds_m": [0.01, -0.01, 0.0]}, "bounds_m"),
    ],
)
def test_motions_that_cannot_be_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        run(**changes)


def test_the_duration_that_is_asked_for_is_enough() -> None:
    with pytest.raises(ConfigError) as caught:
        run(duration_s=0.5)
    shortest = float(str(caught.value).split("at least ")[1].split(",")[0])
    assert run(duration_s=shortest).duration == pytest.approx(shortest, abs=0.01)
