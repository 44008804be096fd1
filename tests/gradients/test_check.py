"""What ``check-gradients`` says: figures, words, exit code."""

from __future__ import annotations

import json

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.gradients import tangent
from sim_core.rigs.motion import Experiment
from sysid.gradients import check_gradients, compare

EXPERIMENT = Experiment.model_validate(
    {
        "name": "short",
        "motions": {"finger": [{"type": "slide", "by_m": [0.0, 0.0, -0.004], "speed_m_s": 0.02, "hold_s": 0.1}]},
    }
)


def check(rig, names, steps=(1e-3, 1e-4)):
    passed, text = check_gradients(rig, EXPERIMENT, names, steps=steps, as_json=True)
    return passed, json.loads(text)["rows"]


def test_forward_adjoint_and_differences_agree(small_rig):
    offsets = {f"{kind}_{axis}_{unit}": 0.01 for axis in "xyz" for kind, unit in (("bias", "n"), ("drift", "n_per_s"))}
    rig = small_rig(effects={"wrench_offset": offsets})
    names = [
        "card.E",
        "gel-card.friction",
        "side.fx",
        "side.latency",
        "gravity.z",
        "effects.wrench_offset.drift_x_n_per_s",
    ]
    passed, rows = check(rig, names)
    judged = [r for r in rows if r["verdict"] == "agrees"]
    assert passed, [(r["parameter"], r["channel"], r["best"], r["reason"]) for r in rows if r["verdict"] == "differs"]
    assert {r["parameter"] for r in judged} == {r["parameter"] for r in rows}
    assert max(r["best"] for r in judged) < 1e-4
    assert max(r["adjoint"] for r in judged) < 1e-8


def test_a_parameter_without_effect_is_named(small_rig):
    passed, text = check_gradients(small_rig(), EXPERIMENT, ["gel-post.friction"], steps=(1e-3,))
    assert passed
    assert "contacts.gel-post.friction has no effect on any reading in this experiment." in text


def test_a_wrong_derivative_is_named(small_rig, monkeypatch):
    """The parameter, its value, the error, the bound, and a reason."""
    plain = tangent.slopes

    def wrong(scene, along):
        keys, table = plain(scene, along)
        return keys, 1.01 * table

    monkeypatch.setattr(tangent, "slopes", wrong)
    passed, text = check_gradients(small_rig(), EXPERIMENT, ["card.E"], steps=(1e-3,))
    assert not passed
    line = next(line for line in text.splitlines() if line.startswith("card.E_pa = 2e+09 in side"))
    assert "9.9e-03" in line and "above 0.0001" in line and "Probably" in line


def test_errors_across_a_jump_grow_as_steps_shrink():
    """One of a jump is proportional to 1 / step, that of a wrong derivative does not change, round-off is within the
    bound somewhere."""
    steps = (1e-2, 1e-4, 1e-6)
    assert compare._jumps(steps, (0.8, 8.0, 800.0), 1e-4)
    assert not compare._jumps(steps, (0.3, 0.3, 0.3), 1e-4)
    assert not compare._jumps(steps, (1e-6, 1e-5, 1e-3), 1e-4)


def test_a_parameter_at_its_bound_is_stepped_to_one_side_in_second_order():
    """Of the derivative of a parabola nothing is lost, on either side or in the middle."""
    for value, lower, upper in ((0.0, 0.0, 9.0), (9.0, 0.0, 9.0), (4.0, 0.0, 9.0)):
        a, b = compare._away(value, 0.1, lower, upper)
        assert lower <= value + a <= upper and lower <= value + b <= upper
        base, first, second = (np.array([3.0 + 2.0 * d + 5.0 * d**2]) for d in (0.0, a, b))
        assert compare._slope(base, first, second, a, b) == pytest.approx([2.0])


def test_bad_input_is_an_error(small_rig):
    with pytest.raises(ConfigError, match="no value"):
        check_gradients(small_rig(), EXPERIMENT, ["gel-card.stiffness_pa_per_m"])
    blind = small_rig().model_copy(update={"sensors": {}, "cameras": {}})
    with pytest.raises(ConfigError, match="nothing that is measured"):
        check_gradients(blind, EXPERIMENT, ["card.E"])
