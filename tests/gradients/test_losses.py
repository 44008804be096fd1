"""What a loss tells of its derivatives by the readings is checked before it is taken for them."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from test_tangent import PRESS

from sim_core.errors import ConfigError
from sim_core.gradients import Backward, Tape, directions, simulate_adjoint, simulate_tangent
from sim_core.gradients.losses import end_memory, in_sight, one_number
from sim_core.scene import build_scene
from sim_core.simulate import Trace, step_times
from sim_core.solve.step import State


def trace_of(readings: np.ndarray) -> Trace:
    return Trace(np.arange(len(readings)), {"load": readings, "camera": readings[:, :1]}, {}, {}, ())


READINGS = np.arange(12.0).reshape(4, 3)
HIDDEN = np.where(READINGS == 7.0, np.nan, READINGS)

WRONG = {
    "the last instant alone": ({"load": READINGS[-1]}, r"'load' of shape \(3,\), not \(4, 3\).*zeros_like"),
    "one number": ({"camera": np.float64(2.0)}, r"'camera' of shape \(\), not \(4, 1\)"),
    "one component": ({"load": READINGS[:, :1]}, r"'load' of shape \(4, 1\), not \(4, 3\)"),
    "another channel": ({"laod": READINGS}, "'laod', which the rollout does not have.*load, camera"),
    "no numbers": ({"load": np.nan * READINGS}, r"12 derivatives .* 'load' .* the first at \(0, 0\): nan"),
    "one infinite": ({"load": np.where(READINGS == 4.0, np.inf, 0.0)}, r"1 derivatives .* the first at \(1, 1\): inf"),
}


@pytest.mark.parametrize("case", WRONG)
def test_derivatives_that_are_not_one_for_each_reading_are_refused(case):
    given, words = WRONG[case]
    with pytest.raises(ConfigError, match=words):
        in_sight(trace_of(READINGS), given)


def test_what_is_out_of_sight_counts_as_zero_whatever_its_derivative():
    """As that of the square of a reading that is NaN."""
    found = in_sight(trace_of(HIDDEN), {"load": cast(np.ndarray, (2.0 * HIDDEN).tolist())})
    np.testing.assert_array_equal(found["load"], np.where(READINGS == 7.0, 0.0, 2.0 * READINGS))
    with pytest.raises(ConfigError, match=r"1 derivatives .* \(2, 2\): nan"):
        in_sight(trace_of(HIDDEN), {"load": np.where(READINGS == 8.0, np.nan, 2.0 * HIDDEN)})


@pytest.mark.parametrize("value", [np.nan, np.inf, READINGS**2, 2j, "2", None])
def test_a_loss_is_one_number(value):
    with pytest.raises(ConfigError, match="not one finite real number"):
        one_number(value)
    assert one_number(np.float32(2.0)) == 2.0 and one_number(3) == 3.0


def test_a_loss_on_the_last_instant_is_not_spread_over_all(small_rig, visit):
    rig, times = small_rig(), step_times(0.0, 0.06, 0.02)
    scene, along = build_scene(rig), directions(rig, ["gravity.z"])

    def last(trace: Trace) -> tuple[float, dict[str, np.ndarray]]:
        channel, readings = next(iter(trace.outputs.items()))
        return float(np.sum(readings[-1] ** 2)), {channel: 2.0 * readings[-1]}

    with pytest.raises(ConfigError, match="not one finite real number"):
        simulate_adjoint(scene, visit(*PRESS), times, lambda trace: (np.nan, {}), along)
    with pytest.raises(ConfigError, match="as its readings"):
        simulate_adjoint(scene, visit(*PRESS), times, last, along)
    tape = Tape(scene, visit(*PRESS), times)
    with pytest.raises(ConfigError, match="as its readings"):
        Backward(tape, along).gradient(*last(tape.trace))


def test_names_are_no_directions(small_rig, visit):
    """Said before the rollout."""
    scene, names = build_scene(small_rig()), ["gel.E_pa"]
    words = r"'gel.E_pa' is not a direction.*directions\(rig, names\)"
    with pytest.raises(ConfigError, match=words):
        simulate_adjoint(scene, visit(*PRESS), step_times(0.0, 0.06, 0.02), lambda trace: pytest.fail("late"), names)
    with pytest.raises(ConfigError, match=words):
        simulate_tangent(scene, visit(*PRESS), step_times(0.0, 0.06, 0.02), names)


def test_derivatives_by_what_the_end_remembers_are_put_where_it_is() -> None:
    end = State(
        0.1,
        np.zeros((1, 3)),
        np.zeros((1, 3)),
        {
            "sheet.bending": {"plastic_curvature": np.ones((2, 3)), "accumulated": np.ones(2)},
            "other": {"slip": np.ones(2)},
        },
    )
    by = np.arange(6.0).reshape(2, 3)
    found = end_memory(end, {"sheet.bending": {"plastic_curvature": by}})
    np.testing.assert_array_equal(found["sheet.bending"], [0, 1, 2, 3, 4, 5, 0, 0])
    np.testing.assert_array_equal(found["other"], [0, 0])


@pytest.mark.parametrize(
    ("term", "name", "values", "message"),
    [
        ("sheet.bending", "plastic_curvature", np.ones(3), r"of shape \(3,\).*That term has .*\(2, 3\)"),
        ("sheet.bending", "curvature", np.ones((2, 3)), r"'curvature' of the term 'sheet.bending'"),
        ("sheet.bend", "plastic_curvature", np.ones((2, 3)), r"Terms that have some: sheet.bending\."),
        ("sheet.bending", "plastic_curvature", np.full((2, 3), np.nan), "no finite derivatives"),
    ],
)
def test_derivatives_by_what_nothing_remembers_are_refused(
    term: str, name: str, values: np.ndarray, message: str
) -> None:
    end = State(0.1, np.zeros((1, 3)), np.zeros((1, 3)), {"sheet.bending": {"plastic_curvature": np.ones((2, 3))}})
    with pytest.raises(ConfigError, match=message):
        end_memory(end, {term: {name: values}})
