"""What ``check-gradients`` says: figures, words, exit code."""

from __future__ import annotations

import dataclasses
import json
import pickle

import numpy as np
import pytest
from gradient_scenes import laid

from sim_core.errors import ConfigError
from sim_core.gradients import Backward, Tape, adjoint, directions, tangent
from sim_core.gradients.directions import RELATIVE_STEP
from sim_core.rigs import list_parameters, parse_rig, with_parameters
from sim_core.rigs.motion import Experiment, compile_experiment
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, simulate
from sysid.gradients import check_gradients, compare, differences
from sysid.gradients.beyond import StateGradients
from sysid.gradients.check import _as_text
from sysid.model.sensor_streams import predicted, predicted_back

EXPERIMENT = Experiment.model_validate(
    {
        "name": "short",
        "motions": {"finger": [{"type": "slide", "by_m": [0.0, 0.0, -0.004], "speed_m_s": 0.05, "hold_s": 0.06}]},
    }
)


@pytest.fixture(scope="module")
def stored():
    """Rollouts other than the one that is differentiated, by what they are of."""
    return {}


@pytest.fixture
def rolled_once(stored, monkeypatch):
    """Tests in which gradients are wrong compare them with the same rollouts."""

    def once(name):
        plain = getattr(StateGradients, name)

        def rolled(self, *given):
            key = name, pickle.dumps((self._rig.model_dump(), self._times, given))
            if key not in stored:
                stored[key] = plain(self, *given)
            return stored[key]

        monkeypatch.setattr(StateGradients, name, rolled)

    for name in ("_moved", "_begun", "_varied"):
        once(name)


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
    assert not passed
    assert "contacts.gel-post.friction has no effect on any reading in this experiment." in text
    assert text.endswith("Nothing could be judged: let the motion go on for longer, or name other parameters.")


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


@pytest.mark.parametrize("error", [1.5, 1.001, np.nan])
def test_a_derivative_that_is_wrong_both_ways_is_named(small_rig, monkeypatch, error):
    for module in (tangent, adjoint):

        def wrong(scene, along, plain=module.slopes):
            keys, table = plain(scene, along)
            return keys, error * table

        monkeypatch.setattr(module, "slopes", wrong)
    _, rows = check(small_rig(), ["card.E", "card.thickness"], steps=differences.STEPS)
    judged = {r["verdict"] for r in rows}
    assert judged == {"differs"}, [(r["channel"], r["verdict"], r["errors"]) for r in rows]


def test_a_parameter_that_is_taken_for_one_without_effect_is_named(small_rig, monkeypatch):
    """Whether it has one is seen in rollouts, not asked of what is checked."""
    for module in (tangent, adjoint):
        monkeypatch.setattr(module, "slopes", lambda scene, along: ([], np.zeros((0, len(along)))))
    _, rows = check(small_rig(), ["card.E"], steps=(1e-3,))
    assert {r["verdict"] for r in rows} == {"differs"}


def test_losses_on_streams_have_derivatives_by_delays_and_drifts(small_rig):
    """And by what acts on the rollout: against differences of whole rollouts."""
    offsets = {f"{kind}_{axis}_{unit}": 0.01 for axis in "xyz" for kind, unit in (("bias", "n"), ("drift", "n_per_s"))}
    rig = small_rig(effects={"wrench_offset": offsets})
    names = ["card.E", "wrench.latency", "side.latency", "effects.wrench_offset.drift_z_n_per_s"]
    poses, times = compile_experiment(EXPERIMENT, rig), np.arange(0.0, 0.25, 0.02)
    rng = np.random.default_rng(1)
    stamps = {c: rng.uniform(0.02, 0.22, 9) for c in ("wrench", "side")}

    def read(there):
        trace = simulate(build_scene(there), poses, times, settings=differences.TIGHT)
        return {c: predicted(trace, there, c, s) for c, s in stamps.items()}

    known = {p.name: p.value for p in list_parameters(rig)}
    along = directions(rig, names)
    weights = {c: rng.standard_normal(values.shape) for c, values in read(rig).items()}
    expected = []
    for d in along:
        step = 1e-5 * abs(known[d.name]) or 1e-6
        high, low = (read(with_parameters(rig, {d.name: known[d.name] + s})) for s in (step, -step))
        expected.append(sum(float((weights[c] * (high[c] - low[c])).sum()) for c in stamps) / (2.0 * step))
    tape = Tape(build_scene(rig), poses, times, differences.TIGHT)
    back = {c: predicted_back(tape.trace, rig, c, s, weights[c], along) for c, s in stamps.items()}
    gradient = Backward(tape, along).gradient(0.0, {c: by_trace for c, (by_trace, _) in back.items()}).parameters
    after = sum(by_parameters for _, by_parameters in back.values())
    for d, later, difference in zip(along, after, expected, strict=True):
        assert gradient[d.name] + later == pytest.approx(difference, rel=1e-5), d.name


FIVE = (1e-2, 1e-3, 1e-4, 1e-6, 1e-7)


def test_errors_across_a_jump_grow_as_steps_shrink():
    """One of a jump is proportional to 1 / step, that of a wrong derivative does not change, round-off is within the
    bound somewhere."""
    for steps in (differences.STEPS, (1e-2, 1e-4, 1e-6)):
        jump = [1e-3 / step for step in steps]
        assert differences.jumps(steps, jump, 1e-4)
        assert not differences.jumps(steps, [0.3] * len(steps), 1e-4)
        assert not differences.jumps(steps, [0.3 + 1e-9 / step for step in steps], 1e-4)
        assert not differences.jumps(steps, [1e-9 / step for step in steps], 1e-4)
    assert not differences.jumps((1e-3, 1e-4), (0.1, 1.0), 1e-4), "two could be anything"
    for several in ([1.0, 9.9, 2.2, 8.7, 2300.0], [1.3, 12.0, 0.97, 11.0, 2600.0], [1.2, 11.0, 38.0, 10.0, 7500.0]):
        assert differences.jumps(FIVE, several, 1e-4), "of a sheet that leaves its plane of symmetry"
    doubled = [1.0, 1.0, 1.0, 1.1, 12.0]
    said = differences.verdict(FIVE, doubled, np.full(5, 1e-9), 1e-4)
    assert said == "differs", "a wrong derivative, and round-off"


def test_a_parameter_at_its_bound_is_stepped_to_one_side_in_second_order():
    """Of the derivative of a parabola nothing is lost, on either side or in the middle."""
    for value, lower, upper in ((0.0, 0.0, 9.0), (9.0, 0.0, 9.0), (4.0, 0.0, 9.0)):
        a, b = differences.away_of(value, 0.1, lower, upper)
        assert lower <= value + a <= upper and lower <= value + b <= upper
        base, first, second = (np.array([3.0 + 2.0 * d + 5.0 * d**2]) for d in (0.0, a, b))
        assert differences.slope_of(base, first, second, a, b) == pytest.approx([2.0])


def test_bad_input_is_an_error(small_rig):
    with pytest.raises(ConfigError, match="no value"):
        check_gradients(small_rig(), EXPERIMENT, ["gel-card.stiffness_pa_per_m"])
    blind = small_rig().model_copy(update={"sensors": {}, "cameras": {}})
    with pytest.raises(ConfigError, match="nothing that is measured"):
        check_gradients(blind, EXPERIMENT, ["card.E"])
    with pytest.raises(ConfigError, match=r"no parameter 'pose'\. Did you mean 'poses'"):
        check_gradients(small_rig(), EXPERIMENT, ["pose"])


def test_poses_start_and_fields_are_checked_too(small_rig):
    """In contact that slides, on a mount that gives way."""
    rig = small_rig(effects={"end_effector_compliance": {"compliance_m_per_n": 2e-4}})
    passed, rows = check(rig, ["poses", "start", "fields"], steps=(1e-2, 1e-3, 1e-4, 1e-6))
    assert passed, [(r["parameter"], r["channel"], r["errors"]) for r in rows if r["verdict"] == "differs"]
    judged = {r["parameter"] for r in rows if r["verdict"] == "agrees"}
    assert {"poses of finger", "positions at the start", "velocities at the start"} <= judged
    assert {f"field {name}" for name in build_scene(rig).fields.names} <= judged
    assert all(r["adjoint"] is None and r["value"] is None for r in rows)


def test_a_start_that_friction_holds_within_nanometres_is_checked(small_rig):
    """A card that lies on a post has settled there: a step of a nanometre away, all of it would slip."""
    plastic = {"bending_plasticity": {"yield_curvature_per_m": 0.5, "hardening_ratio": 0.3}}
    rig = laid(small_rig, {"friction": 0.3}, effects=plastic)
    simulation = Simulation(build_scene(rig))
    held = simulation.state.internals["contact.card-post"]
    assert 0.0 < np.abs(held["anchor"]).max() < 1e-8 and held["load"].max() > 1e-5
    passed, rows = check(rig, ["start"], steps=(1e-2, 1e-3, 1e-4, 1e-6))
    agree = {r["parameter"] for r in rows if r["verdict"] == "agrees"}
    assert passed and agree == {f"{what} at the start" for what in ("positions", "velocities", "memory")}


def test_a_start_that_has_yielded_is_not_judged(small_rig):
    """What flowed under its own weight before the first step is just at yield: differences there have two sides."""
    rig = small_rig(effects={"bending_plasticity": {"yield_curvature_per_m": 0.2, "hardening_ratio": 0.1}})
    _, rows = check(rig, ["start"], steps=(1e-2, 1e-3, 1e-4))
    at_yield = [r for r in rows if "triangles have yielded before the first step" in r["reason"]]
    assert {r["verdict"] for r in at_yield} == {"jumps"}
    assert "differs" not in {r["verdict"] for r in rows}


def test_poses_are_moved_where_they_truly_are(small_rig):
    """An end effector that is offset: nominal poses are elsewhere than true ones, and turned."""
    rig = with_parameters(small_rig(), {"finger.offset_rz_deg": 30.0, "finger.offset_x_m": 1e-3})
    passed, rows = check(rig, ["poses"])
    assert passed and max(r["best"] for r in rows) < 1e-5


def test_what_a_rig_does_not_have_is_no_success(small_rig):
    rig = small_rig()
    bare = rig.model_copy(update={"end_effectors": {}})
    experiment = Experiment.model_validate({"name": "still", "duration_s": 0.1})
    with pytest.raises(ConfigError, match="no poses"):
        check_gradients(no_hands(bare), experiment, ["poses"])


def no_hands(rig):
    """A card in a vice, seen by a camera, and nothing that moves."""
    data = rig.model_dump()
    data["bodies"] = {"card": data["bodies"]["card"]}
    data["sensors"], data["contacts"], data["effects"] = {}, [], {}
    return parse_rig(data, "no hands")


def test_a_gradient_of_what_has_no_effect_is_not_negligible(small_rig, monkeypatch):
    plain = Backward.gradient

    def wrong(self, value, by_readings):
        found = plain(self, value, by_readings)
        off = {k: v + 1e3 if k.startswith("card") else v for k, v in found.fields.items()}
        return dataclasses.replace(found, fields=off)

    monkeypatch.setattr(Backward, "gradient", wrong)
    passed, rows = check(small_rig(), ["fields"])
    assert not passed
    card = [r for r in rows if r["parameter"].startswith("field card") and r["channel"] != "side"]
    assert {r["verdict"] for r in card} == {"differs"}


REMEMBERING = {"gel_relaxation": {"share": 0.3, "tau_s": 0.2}}


def times(factor, given):
    """A gradient, or several by name, so many times."""
    return {k: times(factor, v) for k, v in given.items()} if isinstance(given, dict) else factor * given


@pytest.mark.parametrize("factor", [1.0005, np.nan])
@pytest.mark.parametrize("kind", ["poses", "start_x", "start_v", "start_memory"])
def test_a_gradient_that_is_a_little_wrong_is_named_with_the_usual_steps(
    small_rig, monkeypatch, rolled_once, kind, factor
):
    plain = Backward.gradient

    def wrong(self, value, by_readings):
        found = plain(self, value, by_readings)
        return dataclasses.replace(found, **{kind: times(factor, getattr(found, kind))})

    monkeypatch.setattr(Backward, "gradient", wrong)
    passed, text = check_gradients(small_rig(effects=REMEMBERING), EXPERIMENT, [kind.split("_")[0]])
    assert not passed and "the error is" in text


@pytest.mark.parametrize("kind", ["poses", "start_x", "start_v", "start_memory", "fields"])
def test_a_gradient_by_no_parameter_that_is_wrong_is_named(small_rig, monkeypatch, rolled_once, kind):
    plain = Backward.gradient

    def wrong(self, value, by_readings):
        found = plain(self, value, by_readings)
        return dataclasses.replace(found, **{kind: times(1.001, getattr(found, kind))})

    monkeypatch.setattr(Backward, "gradient", wrong)
    word = kind.split("_")[0]
    passed, rows = check(small_rig(effects=REMEMBERING), [word], steps=(1e-2, 1e-3, 1e-4))
    named = {"start_x": "positions", "start_v": "velocities", "start_memory": "memory"}.get(
        kind, word.removesuffix("s")
    )
    differ = {r["parameter"] for r in rows if r["verdict"] == "differs"}
    assert not passed and differ and all(name.startswith(named) for name in differ)


def test_words_for_what_is_no_parameter_go_with_names(small_rig):
    passed, text = check_gradients(small_rig(), EXPERIMENT, ["card.E", "start"], steps=(1e-3, 1e-4))
    assert passed
    assert "card.E_pa" in text and "velocities at the start" in text and "poses of" not in text


def test_no_derivative_is_compared_with_itself():
    """By latencies and cameras readings are differentiated by differences of one step."""
    assert RELATIVE_STEP not in differences.STEPS


JUMP = [3e4, 3e5, 8e5]
"""Errors of steps that stride over a jump, of 1e-2 to 1e-4."""


@pytest.mark.parametrize(
    ("small", "said"),
    [
        ([0.005, 0.05], "unresolved"),  # round-off, as large as it is said to be
        ([0.5, 0.5], "differs"),  # half of the derivative, at both steps
        ([1e-6, 1e-6], "agrees"),
    ],
)
def test_a_gradient_next_to_a_jump_is_judged_by_the_steps_short_of_it(small, said):
    hidden = np.array([1e-6, 1e-5, 1e-4, 0.01, 0.1])
    assert differences.verdict(FIVE, [*JUMP, *small], hidden, 1e-4, alone=True) == said


def test_what_jumps_as_much_as_round_off_is_said_to_make_is_not_judged():
    """Round-off is how far readings of the smallest step are from a straight line, which a jump is, too."""
    errors = np.array([2.0, 5.9, 60.0, 6e3, 6e4])
    for share, said in ((1.1, "unresolved"), (0.1, "jumps")):
        assert differences.verdict(FIVE, errors, share * errors, 1e-4, alone=True) == said
    wrong = np.array([1.0, 1.0, 1.0, 1.1, 12.0])
    assert differences.verdict(FIVE, wrong, 1e-7 / np.array(FIVE), 1e-4, alone=True) == "differs"


def test_an_error_that_stays_is_not_explained_by_round_off_at_the_smallest_step():
    """Six times the bound at three steps, far above round-off, which hides the derivative at 1e-7 alone."""
    errors, hidden = [1e-3, 7e-5, 6e-5, 6e-5, 7e-5, 1.6e-4], np.array([0.0, 0.0, 0.0, 1e-6, 2e-5, 2e-4])
    assert differences.verdict(differences.STEPS, errors, hidden, 1e-5) == "differs"


ONCE_OFF = [0.30, 3.9e-3, 9.3e-4, 9.0e-4, 1.2e-3, 4e-3]
"""Errors of a derivative that is off by 9e-4, which round-off hides at the smallest steps."""


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("errors", [ONCE_OFF, [0.30, 3.9e-3, 6e-4, 5e-4, 1.1e-3, 1.1e-2]])
def test_an_error_at_the_best_step_is_not_explained_by_round_off_at_smaller_ones(errors, alone):
    """Nor is what grows there by no more than round-off a jump."""
    for at_best, said in ((6e-5, "differs"), (1e-3, "unresolved")):
        hidden = at_best * 2e-5 / np.array(differences.STEPS)
        assert differences.verdict(differences.STEPS, errors, hidden, 1e-4, alone=alone) == said
    assert differences.verdict(differences.STEPS, errors, hidden, 1e-3, alone=alone) == "agrees"


def test_rows_that_are_not_judged_are_counted_by_their_reasons():
    known = dict.fromkeys(("value", "effect", "best", "best_step", "adjoint", "bound"), 1e-3)
    said = ["agrees", *["no effect"] * 2, "negligible", *["unresolved"] * 3, "jumps"]
    rows = [
        differences.Row(parameter=f"p{k}", channel="wrench", unit="N", errors=(1e-3,), plateau=(), verdict=v, **known)
        for k, v in enumerate(said)
    ]
    closing = _as_text(rows, (1e-3,)).splitlines()[-1]
    assert closing.startswith("1 of 1 judged rows agree")
    assert closing.endswith(
        "Not judged: 7 of 8 rows (2 without effect, 1 of negligible effect, 3 hidden by round-off, 1 next to a jump)."
    )
    nothing = _as_text(rows[1:3], (1e-3,)).splitlines()[-1]
    assert nothing.startswith("Not judged: 2 of 2 rows (2 without effect). Nothing could be judged")
    assert _as_text(rows[:1], (1e-3,)).endswith("Not judged: 0 of 1 rows.")


def test_a_single_field_is_checked_by_its_name(small_rig):
    _, rows = check(small_rig(), ["fields.gel.E"])
    assert {r["parameter"] for r in rows} == {"field gel.E_pa"}
    with pytest.raises(ConfigError, match=r"no field 'gel\.Epa'\. Did you mean 'fields\.gel\.E_pa'"):
        check_gradients(small_rig(), EXPERIMENT, ["fields.gel.Epa"])


def test_a_kink_is_named_with_its_side_and_is_no_success(small_rig, monkeypatch):
    """Readings that fall off below the value of a modulus: sensitivities are those of more of it."""
    rig, plain = small_rig(), compare.predicted

    def kinked(trace, there, channel, stamps):
        below = min(0.0, there.bodies["card"].material.E_pa / rig.bodies["card"].material.E_pa - 1.0)
        return (1.0 + 0.5 * below) * plain(trace, there, channel, stamps)

    monkeypatch.setattr(compare, "predicted", kinked)
    steps = (1e-3, 1e-4, 2e-5)
    passed, rows = check(rig, ["card.E", "gravity.z"], steps)
    assert not passed and {r["verdict"] for r in rows if r["parameter"] == "gravity.z_m_s2"} == {"agrees"}
    of_card = [r for r in rows if r["parameter"] == "card.E_pa"]
    assert {r["verdict"] for r in of_card} == {"one side"}, [(r["channel"], r["verdict"], r["errors"]) for r in of_card]
    assert all(min(r["errors"]) > 0.1 and "to the side of more of it, to " in r["reason"] for r in of_card)
    _, text = check_gradients(rig, EXPERIMENT, ["card.E"], steps=steps)
    assert "card.E_pa = 2e+09 in side: the error is" in text and "the side of more of it" in text


@pytest.mark.parametrize(("side", "slope"), [("more", 2.0), ("less", 7.0)])
def test_a_derivative_of_one_side_of_a_kink_is_distinguished_from_a_wrong_one(side, slope):
    """Of what rises by 2 to the one side and by 7 to the other, and is curved; that of the middle is of no side."""

    def reading(away):
        return np.array([3.0 + (2.0 if away > 0.0 else 7.0) * away + 5.0 * away**2])

    aways = [(h, -h) for h in (1e-2, 1e-3, 1e-4)]
    readings = [[reading(a) for a in both] for both in aways]
    found = differences.side_of(np.array([slope]), slope, reading(0.0), readings, aways, 1e-4)
    assert found is not None and found[0] == side and found[1] < 1e-9
    for wrong in (4.5, 1.001 * slope):
        assert differences.side_of(np.array([wrong]), wrong, reading(0.0), readings, aways, 1e-4) is None
    jumped = [[r + (0.0 if h == aways[0] else 1.0) for r in both] for h, both in zip(aways, readings, strict=True)]
    by_chance = differences.slope_of(reading(0.0), *(jumped[k][0] for k in (2, 1)), aways[2][0], aways[1][0])
    assert differences.side_of(by_chance, slope, reading(0.0), jumped, aways, 1e-4) is None, "one pair alone"
