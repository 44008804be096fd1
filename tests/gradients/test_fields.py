"""Gradients by fields over elements and hinges: against differences of rollouts, scalars, and a field that is known."""

from __future__ import annotations

import numpy as np
import pytest
from explicit_contact import explicit_contact
from gradient_scenes import PRESS, ball, damped
from test_adjoint import EFFECTS, TIGHT, small, weights

from sim_core.errors import ConfigError
from sim_core.gradients import Backward, Tape, directions, simulate_tangent
from sim_core.rigs import parse_rig, with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, run, simulate

SHAKEN = {"clamps": [{"name": "vice", "body": "card", "region": {"x_m": [-0.04, -0.02]}, "mount": "finger"}]}
BALL = {
    "type": "affine", "shape": {"type": "sphere", "radius_m": 0.004}, "pose": {"position_m": [0.0, 0.1, 0.05]},
    "material": {"density_kg_m3": 1000.0},
}  # fmt: skip


def shaken(small_rig, visit, **changes):
    """The card in the finger's grip, off which nothing is touched; with a free ball nothing settles."""
    rig = small_rig(**SHAKEN, **changes)
    moves = ([0.0, 0.06, 0.12, 0.2], [[0, 0, 0], [0, 0, 0.004], [0, 0.002, -0.004], [0, 0, 0]])
    return rig, visit(*moves), np.linspace(0.0, 0.2, 11)


def unsettled(small_rig, visit):
    rig, poses, times = shaken(small_rig, visit)
    data = rig.model_dump()
    data["bodies"]["ball"] = BALL
    return parse_rig(data, "unsettled"), poses, times[:4]  # in the step after these the card may snap either way


SHIFTS = {"nu": 0.03, "rest_angle_rad": 2.5e-4}
"""How far fields that are no shares of the rig's number vary about it."""
DAMPINGS = {"mass_damping_per_s": 3.0, "stiffness_damping_s": 2e-3}
"""Mean of what is added to the dampings of the rig; never below zero."""
SCALES = {"nu": 1.0, "rest_angle_rad": 0.01, "mass_damping_per_s": 90.0, "stiffness_damping_s": 0.06}
"""Changes of them that are as large as changes of the others by their own size."""

SCENES = {
    "every effect": small(PRESS, 0.3),
    "damped, looking back": lambda *given, **_: damped("bdf2", *given),
    "ball on a card": lambda *given, **_: ball(),
    "unsettled": lambda *given, **_: unsettled(*given),
}


def over_elements(scene):
    """All fields but the shapes at rest."""
    return [name for name in scene.fields.names if not name.endswith("rest_m")]


def uneven(scene):
    """Set all fields but shapes to something that varies, such that no sheet yields before it moves: the path to the
    first equilibrium counts as given."""
    rng = np.random.default_rng(1)
    last = ["nu", "hardening_ratio", "relaxation_g", "relaxation_tau_s", *DAMPINGS]
    for name in sorted(over_elements(scene), key=lambda name: [name.endswith(end) for end in reversed(last)]):
        wave = rng.standard_normal(len(scene.fields[name]))
        given, quantity = scene.fields[name], name.split(".")[1]
        if quantity in DAMPINGS:
            scene.fields[name] = given + DAMPINGS[quantity] * np.exp(0.5 * wave)
        else:
            shift = SHIFTS.get(quantity)
            scene.fields[name] = given * np.exp(0.1 * wave) if shift is None else given + shift * wave


@pytest.mark.parametrize("case", SCENES)
def test_fields_against_differences_of_rollouts(case, small_rig, visit):
    """Along a random direction and by single elements, through contact, friction, memory and dampings."""
    rig, poses, times = SCENES[case](small_rig, visit, effects=EFFECTS)
    scene = build_scene(rig)
    fields, rng = scene.fields, np.random.default_rng(2)
    uneven(scene)
    tape = Tape(scene, poses, times, TIGHT)
    assert not any(kept.get("accumulated_curvature", np.zeros(1)).any() for kept in tape.start.internals.values())
    given = {c: w / np.nanmax(np.abs(tape.trace.outputs[c])) for c, w in weights(tape.trace).items()}
    strained = "" if case != "unsettled" else "card."  # nothing strains the gel there
    names = [n for n in over_elements(scene) if n.startswith(strained)]
    found = Backward(tape, [], names).gradient(0.0, given).fields
    assert list(found) == names
    for name, gradient in found.items():
        here = fields[name]
        scale = np.full(len(here), SCALES[name.split(".")[1]]) if name.split(".")[1] in SCALES else here
        assert gradient.shape == here.shape and np.abs(gradient).max() > 0.0
        largest = int(np.argmax(np.abs(gradient * scale)))
        for along in (rng.standard_normal(len(here)), *np.eye(len(here))[[largest, -1]]):
            bound, errors = 5e-5 * np.abs(gradient * scale).max() * np.linalg.norm(along), []

            def central(h, name=name, here=here, change=along * scale):
                ends = []
                for s in (h, -h):
                    fields[name] = here + s * change
                    outputs = simulate(scene, poses, times, settings=TIGHT).outputs
                    ends.append(sum(np.nansum(outputs[c] * w) for c, w in given.items()))
                return (ends[0] - ends[1]) / (2.0 * h)

            # The last of fourth order, over so much that round-off does not count.
            for h in (1e-4, 1e-5, 1e-3, 2e-3, None):
                numeric = (4.0 * central(4e-3) - central(8e-3)) / 3.0 if h is None else central(h)
                errors.append(abs(numeric - gradient @ (along * scale)))
                if errors[-1] < bound:
                    break
            fields[name] = here
            assert min(errors) < bound, (name, along, errors)


def test_what_all_elements_have_together(small_rig, visit):
    """sum dL/dq_e q_e = q dL/dq of the rig's number, by which a whole field is scaled, and sum dL/dnu_e = dL/dnu, by
    which it is shifted; whatever the field. With constants of contact that do not follow the rig's modulus."""
    rig, poses, times = small(PRESS, 0.4)(small_rig, visit, effects=EFFECTS)
    rig = explicit_contact(rig)
    names = ["gel.E_pa", "gel.nu", "gel.density_kg_m3", "card.E_pa", "card.nu", "card.density_kg_m3"]
    compare_with_scalars(rig, poses, times, names)


def test_what_all_elements_have_together_of_effects(small_rig, visit):
    """Of the flow of a sheet and of the relaxation of a gel, whatever the field."""
    rig, poses, times = small(PRESS, 0.4)(small_rig, visit, effects=EFFECTS)
    scene = build_scene(rig)
    pairs = {
        "effects.bending_plasticity.yield_curvature_per_m": "card.yield_curvature_per_m",
        "effects.bending_plasticity.hardening_ratio": "card.hardening_ratio",
        "effects.gel_relaxation.share": "gel.relaxation_g",
        "effects.gel_relaxation.tau_s": "gel.relaxation_tau_s",
    }
    uneven(scene)
    found, scalars = by_elements_and_forwards(scene, poses, times, pairs, list(pairs.values()))
    for name, field in pairs.items():
        _, effect, quantity = name.split(".")
        shares = found.fields[field] * scene.fields[field]
        whole = scalars[name] * rig.effects[effect][quantity]
        assert abs(whole) > 0.0 and shares.sum() == pytest.approx(whole, rel=1e-7), name


@pytest.mark.parametrize("uniform", [True, False])
def test_what_all_elements_have_together_of_dampings(small_rig, visit, uniform):
    """sum dL/da_e = dL/da of the rig's number, by which a field of damping is shifted; also where there is none."""
    rig, poses, times = SCENES["damped, looking back"](small_rig, visit, effects=EFFECTS)
    names = [f"{body}.{quantity}" for body in ("gel", "card") for quantity in DAMPINGS]
    rig = with_parameters(rig, dict.fromkeys(names, 0.0)) if uniform else rig
    scene = build_scene(rig)
    if not uniform:
        uneven(scene)
    found, scalars = by_elements_and_forwards(scene, poses, times, names, names)
    for name in names:
        by_elements = found.fields[name]
        expected = pytest.approx(scalars[name], rel=1e-6, abs=1e-9 * np.abs(by_elements).sum())
        assert by_elements.any() and by_elements.sum() == expected, name


def test_a_damping_of_each_element_is_the_number_of_the_rig(small_rig, visit):
    """The same everywhere, and shifted by another rig; a spot without damping is one."""
    rig, poses, times = SCENES["damped, looking back"](small_rig, visit)
    given = {"gel.mass_damping_per_s": 4.0, "card.stiffness_damping_s": 3e-3, "card.mass_damping_per_s": 2.0}
    more = {name: value + 1e-3 * value for name, value in given.items()}
    scene = build_scene(with_parameters(rig, dict.fromkeys(given, 0.0)))
    for name, value in given.items():
        scene.fields[name] = value
    for numbers, expected in ((dict.fromkeys(given, 0.0), given), ({n: 1e-3 * v for n, v in given.items()}, more)):
        scene.use(with_parameters(rig, numbers))
        plain = simulate(build_scene(with_parameters(rig, expected)), poses, times, settings=TIGHT)
        found = simulate(scene, poses, times, settings=TIGHT)
        for channel, there in plain.outputs.items():
            assert np.nanmax(np.abs(found.outputs[channel] - there)) < 1e-8 * np.nanmax(np.abs(there)), channel
    here = scene.fields["card.stiffness_damping_s"]
    scene.fields["card.stiffness_damping_s"] = np.where(np.arange(len(here)) < 4, 0.0, here)
    spotted = simulate(scene, poses, times, settings=TIGHT)
    assert any(not np.array_equal(spotted.outputs[c], v, equal_nan=True) for c, v in found.outputs.items())
    with pytest.raises(ConfigError, match=r"With 0, .* card\.stiffness_damping_s .* below zero"):
        scene.use(with_parameters(rig, dict.fromkeys(given, 0.0) | {"card.stiffness_damping_s": 0.0}))


def test_a_half_of_a_sheet_that_does_not_yield(small_rig, visit):
    rig, poses, times = small(PRESS, 0.4)(small_rig, visit, effects=EFFECTS)
    scene = build_scene(rig)
    here, places = scene.fields["card.yield_curvature"], scene.fields.places("card.yield_curvature")
    plain = flowed(scene, poses, times)
    hard = places[:, 0] > np.median(places[plain > 0.0, 0])
    assert plain[hard].any() and plain[~hard].any()
    scene.fields["card.yield_curvature"] = np.where(hard, 1e6, here)
    kept = flowed(scene, poses, times)
    assert kept[~hard].any() and not kept[hard].any()


def flowed(scene, poses, times):
    """What has flowed in each triangle of the card at the end."""
    simulation = Simulation(scene, TIGHT)
    run(simulation, poses, times)
    return simulation.state.internals["card.bending"]["accumulated_curvature"]


def test_what_all_triangles_have_together_of_a_thickness(small_rig, visit):
    """Where no contact has the half of it for its distance."""
    compare_with_scalars(*shaken(small_rig, visit, contacts=[]), ["card.thickness_m", "card.E_pa"])


def test_numbers_where_nothing_settles(small_rig, visit):
    """What the card is put with counts, of elements that are all different."""
    rig, poses, times = unsettled(small_rig, visit)
    scene = build_scene(rig)
    uneven(scene)
    names = ["card.E_pa", "card.nu", "card.thickness_m", "card.density_kg_m3"]
    for last in (1, len(times)):  # the readings of the start alone, and all
        by_elements_and_forwards(scene, poses, times, names, ["card.E_pa"], last)


@pytest.mark.parametrize("name", ["card.E_pa", "gel.nu", "effects.gel_relaxation.tau_s"])
def test_one_number_alone_from_steps_that_were_kept(name, small_rig, visit):
    """Nothing else puts the system where a step ended."""
    rig, poses, times = small(PRESS, 0.3)(small_rig, visit, effects=EFFECTS)
    scene = build_scene(rig)
    by_elements_and_forwards(scene, poses, times, [name], [])


def test_the_share_that_relaxes_where_none_does(small_rig, visit):
    """On a scene that nothing has gone through before, to the one side that there is."""
    name = "effects.gel_relaxation.share"
    rig, poses, times = small(PRESS, 0.3)(small_rig, visit, effects={"gel_relaxation": {"share": 0.0, "tau_s": 0.2}})
    along = directions(rig, [name])
    scene = build_scene(rig)
    tape = Tape(scene, poses, times, TIGHT)
    given = weights(tape.trace)
    found = Backward(tape, along).gradient(0.0, given).parameters[name]

    def at(share):
        outputs = simulate(build_scene(with_parameters(rig, {name: share})), poses, times, settings=TIGHT).outputs
        return sum(np.nansum(outputs[c] * w) for c, w in given.items())

    h = 1e-4
    assert found == pytest.approx((4.0 * at(h) - at(2.0 * h) - 3.0 * at(0.0)) / (2.0 * h), rel=1e-4)
    by_elements_and_forwards(scene, poses, times, [name], [])


def by_elements_and_forwards(scene, poses, times, names, fields, last=None):
    """Gradient of a random sum of the readings before number ``last`` by fields and parameters, and the derivatives of
    the sum by the parameters forwards. That of the gradient is the same; but for relaxation and flow, which have one
    closed form both ways, forwards each term is stepped."""
    along = directions(scene.rig, names)
    trace, derivatives = simulate_tangent(scene, poses, times, along, settings=TIGHT)
    given = {
        c: np.where(np.arange(len(w)).reshape(-1, *[1] * (w.ndim - 1)) < (last or len(w)), w, 0.0)
        for c, w in weights(trace).items()
    }
    found = Backward(Tape(scene, poses, times, TIGHT), along, fields).gradient(0.0, given)
    products = [np.nan_to_num(derivatives[c]) * w[..., None] for c, w in given.items()]
    assert any(np.any(p) for p in products)
    sums, sizes = (sum(a(p).reshape(-1, len(along)).sum(axis=0) for p in products) for a in (np.asarray, np.abs))
    for direction, value, size in zip(along, sums, sizes, strict=True):
        assert found.parameters[direction.name] == pytest.approx(value, rel=1e-7, abs=1e-8 * size), direction.name
    return found, dict(zip(names, sums, strict=True))


def compare_with_scalars(rig, poses, times, names):
    scene = build_scene(rig)
    uneven(scene)
    found, scalars = by_elements_and_forwards(scene, poses, times, names, names)
    for name in names:
        body, key = name.split(".")
        shifted = key == "nu"
        whole = scalars[name] * (1.0 if shifted else getattr(rig.bodies[body].material, key))
        shares = found.fields[name] * (1.0 if shifted else scene.fields[name])
        assert shares.sum() == pytest.approx(whole, rel=1e-7, abs=1e-9 * np.abs(shares).sum()), name


def test_a_uniform_field_changes_no_bit(small_rig, visit):
    rig, poses, times = damped("bdf2", small_rig, visit)
    plain = simulate(build_scene(rig), poses, times)
    scene = build_scene(rig)
    for name in scene.fields.names:
        scene.fields[name] = scene.fields[name]
    same = simulate(scene, poses, times)
    uneven(scene)
    other = simulate(scene, poses, times)
    scene.fields.reset()
    again = simulate(scene, poses, times)
    for channel, expected in plain.outputs.items():
        assert np.array_equal(same.outputs[channel], expected, equal_nan=True)
        assert np.array_equal(again.outputs[channel], expected, equal_nan=True)
        assert not np.array_equal(other.outputs[channel], expected, equal_nan=True)


def test_a_field_everywhere_the_same_is_the_number_of_the_rig(small_rig, visit):
    """Twice the modulus and the density, less contraction, and a quarter more thickness of a sheet that touches
    nothing."""
    rig, poses, times = shaken(small_rig, visit, contacts=[])
    card = rig.bodies["card"].material
    changed = {
        "E_pa": 2.0 * card.E_pa,
        "nu": card.nu - 0.25,
        "density_kg_m3": 2.0 * card.density_kg_m3,
        "thickness_m": 1.25 * card.thickness_m,
    }
    data = rig.model_dump()
    data["bodies"]["card"]["material"].update(changed)
    expected = simulate(build_scene(parse_rig(data, "changed")), poses, times, settings=TIGHT)
    scene = build_scene(rig)
    for key, value in changed.items():
        scene.fields[f"card.{key}"] = value
        assert scene.fields[f"card.{key}"] == pytest.approx(value)
    found = simulate(scene, poses, times, settings=TIGHT)
    for channel, there in expected.outputs.items():
        assert np.nanmax(np.abs(found.outputs[channel] - there)) < 1e-8 * np.nanmax(np.abs(there))


def test_rest_angles_of_an_arc(small_rig, visit):
    """A flat card without weight that gets the rest angles of a bent one settles to the shape of that."""
    rig, poses, times = shaken(small_rig, visit, contacts=[], gravity_m_s2=[0.0, 0.0, 0.0])
    data = rig.model_dump()
    data["bodies"]["card"]["shape"]["folds"] = [{"at_m": 0.01, "angle_deg": 40.0, "over_m": 0.03}]
    bent, flat = build_scene(parse_rig(data, "bent")), build_scene(rig)
    flat.fields["card.rest_angle"] = bent.fields["card.rest_angle"]
    nodes = flat.bodies["card"].nodes
    assert np.ptp(flat.rest[nodes, 2]) == 0.0 and np.ptp(bent.rest[nodes, 2]) > 0.01
    settled = Tape(flat, poses, times[:1]).start.x
    assert np.abs(settled - bent.rest)[nodes].max() < 1e-8


def test_a_spot_that_does_not_relax(small_rig, visit):
    """Half of a gel keeps its stress, the other half does not; derivatives by both are those of differences."""
    rig, poses, times = small(PRESS, 0.3)(small_rig, visit, effects={"gel_relaxation": {"share": 0.4, "tau_s": 0.1}})
    scene = build_scene(rig)
    fields, name = scene.fields, "gel.relaxation_g"
    spot = np.arange(len(fields[name])) < len(fields[name]) // 2
    here = np.where(spot, 0.0, fields[name])
    fields[name] = here
    tape = Tape(scene, poses, times, TIGHT)
    simulation = Simulation(scene, TIGHT)
    run(simulation, poses, times)
    kept = simulation.state.internals["gel.elastic_laws"]["gel_relaxation.stress"].reshape(len(spot), -1)
    assert not kept[spot].any() and kept[~spot].any()
    given = {c: w / np.nanmax(np.abs(tape.trace.outputs[c])) for c, w in weights(tape.trace).items()}
    gradient = Backward(tape, [], [name]).gradient(0.0, given).fields[name]
    assert gradient[spot].any() and gradient[~spot].any()
    values = []
    for h in (0.0, 1e-3, 2e-3):
        fields[name] = here + h * spot
        outputs = simulate(scene, poses, times, settings=TIGHT).outputs
        values.append(sum(np.nansum(outputs[c] * w) for c, w in given.items()))
    slope = (4.0 * values[1] - values[2] - 3.0 * values[0]) / 2e-3
    assert gradient[spot].sum() == pytest.approx(slope, rel=1e-4)


def test_fields_that_cannot_be_used(small_rig):
    scene = build_scene(small_rig())
    fields = scene.fields
    assert len(fields["gel.E"]) == len(fields.places("gel.E_pa"))
    assert fields.resolve("card.rest_angle") == "card.rest_angle_rad"
    for name, values, words in (
        ("gel.thickness_m", 1.0, "no field"),
        ("card.yield_curvature_per_m", 5.0, "no field"),  # without that effect
        ("gel.E_pa", np.ones(3), "values, not an array"),
        ("gel.E_pa", 0.0, "above zero"),
        ("card.density_kg_m3", np.nan, "finite"),
        ("card.rest_angle_rad", 4.0, "pi"),
        ("gel.nu", 0.5, "not between -1 and 0.5"),
        ("card.nu", np.full(len(fields["card.nu"]), -1.0), "not between -1 and 0.5"),
        ("card.nu", np.nan, "finite"),
        ("card.mass_damping_per_s", -1.0, "below zero"),
        ("gel.stiffness_damping_s", np.inf, "finite"),
        ("gel.relaxation_g", 0.5, "no field"),  # without that effect
    ):
        with pytest.raises(ConfigError, match=words):
            fields[name] = values
    with pytest.raises(ConfigError, match=r"Did you mean 'gel\.E_pa'"):
        fields.resolve("gel.F")
    relaxing = build_scene(small_rig(effects={"gel_relaxation": {"share": 0.4, "tau_s": 0.1}}))
    relaxing.fields["gel.relaxation_g"] = 0.8
    with pytest.raises(ConfigError, match=r"not in \[0, 1\)"):
        relaxing.fields["gel.relaxation_g"] = 1.0
    with pytest.raises(ConfigError, match=r"With 0\.5, the number of the rig, .* not in \[0, 1\)"):
        relaxing.use(small_rig(effects={"gel_relaxation": {"share": 0.5, "tau_s": 0.1}}))
