"""What every effect promises, whoever wrote it: one test for all that the registry knows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from effect_examples import TYPICAL

from sim_core.effects import Effect, EffectParameter, all_effects, effect_by_name
from sim_core.effects.hooks import BodyForce, ClockMap, NormalLaw, ReadingMap
from sim_core.effects.registry import checked
from sim_core.effects.scopes import CONTACTS
from sim_core.errors import ConfigError
from sim_core.rigs import Rig
from sim_core.rigs.motion import Experiment
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sysid.gradients import check_gradients

RUB = [
    {"type": "waypoints", "speed_m_s": 0.1, "poses": [
        {"position_m": [0.0, 0.0, -0.006]}, {"position_m": [0.004, 0.001, -0.007]},
        {"position_m": [0.004, 0.001, 0.002]},
    ]},
]  # fmt: skip
"""The finger presses the card, rubs along it, and lets go, within 0.2 s."""

STEPS = (1e-4, 1e-5, 1e-6)

OVER_THE_POST = {"finger": {"start": {"position_m": [0.08, 0.004, 0.0595]}}}
"""Where the finger begins above a rigid body."""


def rig_with(name: str, small_rig: Callable[..., Rig]) -> Rig:
    """The small rig with an effect, its finger above what that acts on."""
    place = {"end_effectors": OVER_THE_POST} if name == "contact_bonding" else {}
    return small_rig(effects={name: TYPICAL[name]}, **place)


@pytest.fixture(scope="module")
def rub() -> Experiment:
    return Experiment.model_validate({"name": "rub", "motions": {"finger": RUB}})


@pytest.mark.slow
@pytest.mark.parametrize("name", all_effects())
def test_derivatives_against_differences_of_rollouts(name: str, small_rig: Callable[..., Rig], rub: Experiment) -> None:
    """By its own parameters, a density, the commanded poses, the start and shapes at rest, of all channels."""
    own = [f"effects.{name}.{p}" for p in TYPICAL[name]]
    others = ["card.density", "poses", "start", "fields.card.rest_m", "fields.gel.rest_m"]
    passed, text = check_gradients(rig_with(name, small_rig), rub, [*own, *others], until_s=0.16, steps=STEPS)
    assert passed, text


@pytest.mark.parametrize("name", all_effects())
def test_own_derivatives_against_differences_of_rollouts(
    name: str, small_rig: Callable[..., Rig], rub: Experiment
) -> None:
    """By its own parameters in the first steps of contact, forwards and backwards."""
    own = [f"effects.{name}.{p}" for p in TYPICAL[name]][:3]
    until_s = 0.13 if name == "contact_bonding" else 0.1  # bonds act from the step after a touch
    passed, text = check_gradients(rig_with(name, small_rig), rub, own, until_s=until_s, steps=STEPS[:2])
    assert passed, text


@pytest.mark.parametrize("name", all_effects())
def test_is_refused_where_it_acts_on_nothing(name: str, small_rig: Callable[..., Rig]) -> None:
    from sim_core.effects import active_effects

    nothing = {"bodies": {}, "clamps": (), "contacts": (), "sensors": {}, "cameras": {}, "end_effectors": {}}
    rig = small_rig().model_copy(update={**nothing, "effects": {name: TYPICAL[name]}})
    with pytest.raises(ConfigError, match=f"{name} acts on nothing .* it needs") as refused:
        active_effects(rig)
    assert effect_by_name(name).scope.needs in str(refused.value)


@pytest.mark.parametrize("name", all_effects())
def test_scope_narrows_what_it_acts_on(name: str, small_rig: Callable[..., Rig]) -> None:
    from sim_core.effects import active_effects

    effect = effect_by_name(name)
    for target in effect.targets(small_rig()):
        (instance,) = active_effects(small_rig(effects={f"{name}@{target}#one": TYPICAL[name]}))
        assert instance.targets == (target,)
    with pytest.raises(ConfigError, match="cannot act on 'nobody'"):
        active_effects(small_rig(effects={f"{name}@nobody": TYPICAL[name]}))


def test_two_branches_that_would_be_one_number_are_refused(small_rig: Callable[..., Rig]) -> None:
    """Numbers of a term are there once; material laws, which add up, take as many branches as are named."""
    from sim_core.effects import active_effects

    branch, flow = {"share": 0.2, "tau_s": 0.1}, TYPICAL["bending_plasticity"]
    with pytest.raises(ConfigError, match="set the same numbers of card"):
        active_effects(small_rig(effects={"bending_plasticity@card#one": flow, "bending_plasticity#other": flow}))
    both = active_effects(small_rig(effects={"viscoelastic_gel@gel#fast": branch, "viscoelastic_gel#slow": branch}))
    assert [instance.targets for instance in both] == [("gel",), ("gel",)]


AMOUNT = EffectParameter("amount", "N", 0.0, 1.0, (0.1,), 0.0, False, 0.1, "how much")


def _incomplete() -> Iterator[tuple[type[Effect], str]]:
    """Classes that forgot something, and what."""
    words = {
        "title": "it pulls",
        "words": "It pulls.",
        "slot": "contact",
        "scope": CONTACTS,
        "parameters": (AMOUNT,),
    }

    def made(base: type[Effect], *methods: str, **changes: Any) -> type[Effect]:
        body = {
            **words,
            "parameters": (AMOUNT,),
            "name": "unfinished",
            **changes,
            **{m: lambda self, *given: None for m in methods},
        }
        return type("Unfinished", (base,), body)

    yield made(NormalLaw, "reach"), "energy"
    yield made(ReadingMap, "read", "push"), "pull"
    yield made(BodyForce, "terms"), "numbers"
    yield made(NormalLaw, "reach", "energy", title=""), "title"
    yield made(NormalLaw, "reach", "energy", scope=None), "scope"
    yield made(NormalLaw, "reach", "energy", example={}), "example"
    fixed = EffectParameter("shape", "-", 0.0, 1.0, (0.1,), None, False, 0.1, "a shape")
    yield (
        made(NormalLaw, "reach", "energy", parameters=(fixed,), example={"shape": 0.5}),
        "vanishes",
    )


@pytest.mark.parametrize(("kind", "lacking"), list(_incomplete()), ids=lambda x: x if isinstance(x, str) else "")
def test_an_effect_that_lacks_something_is_an_error(kind: type[Effect], lacking: str) -> None:
    """Before anything is simulated: a missing derivative, empty words, no value at which it vanishes."""
    with pytest.raises(ConfigError, match=lacking):
        checked(kind)


def test_an_effect_of_another_package_is_found(monkeypatch: pytest.MonkeyPatch, small_rig: Callable[..., Rig]) -> None:
    """By an entry point, and then it is one like all others."""
    from sim_core.effects import active_effects, registry
    from sim_core.effects.static_friction import StaticFriction

    class Point:
        name, value = "theirs", "their_package.theirs"

        @staticmethod
        def load() -> type[Effect]:
            return type("Theirs", (StaticFriction,), {"name": "theirs"})

    monkeypatch.setattr(registry, "entry_points", lambda group: [Point] if group == registry.GROUP else [])
    registry.all_effects.cache_clear()
    try:
        assert "theirs" in all_effects()
        (instance,) = active_effects(small_rig(effects={"theirs": {"excess": 0.2}}))
        assert instance.targets == ("gel-card", "gel-post")
    finally:
        registry.all_effects.cache_clear()


def test_priors_and_starts_fit_the_recording() -> None:
    """A time constant is sought within the length of the recording, a bias on the scale of its forces."""
    from sim_core.effects import RecordingScales

    scales = RecordingScales(duration_s=200.0, sampling_s=0.1, force_n=30.0, torque_nm=2.0, speed_m_s=0.01)
    tau = effect_by_name("gel_relaxation").parameters[1].fitted_to(scales)
    assert tau.typical == pytest.approx((2.0, 10.0, 50.0))
    bias, drift = (
        next(p for p in effect_by_name("wrench_offset").parameters if p.name == name).fitted_to(scales)
        for name in ("bias_x_n", "drift_x_n_per_s")
    )
    assert (bias.prior_sd, drift.prior_sd) == pytest.approx((3.0, 3.0 / 200.0))
    assert np.isfinite(tau.prior_sd)


@pytest.mark.parametrize(
    "name", [n for n, e in all_effects().items() if e.passive and not isinstance(e, ReadingMap | ClockMap)]
)
def test_a_passive_effect_gives_no_energy(name: str, small_rig: Callable[..., Rig], visit: Callable[..., Any]) -> None:
    """Along a closed way of the finger, from rest in air to rest in air, it puts in at least as much as it gets back:
    W = -sum F_k . dx_k with the forces at the ends of steps, at which the implicit step evaluates them."""
    times = [0.0, 0.06, 0.12, 0.2, 0.26, 0.5]
    offsets = [[0, 0, 0], [0, 0, -0.006], [0.004, 0.001, -0.007], [0.001, 0.0, -0.006], [0, 0, 0], [0, 0, 0]]
    rig, poses = small_rig(effects={name: TYPICAL[name]}), visit(times, offsets)
    instants = step_times(0.0, 0.5, rig.solver.dt_s)
    trace = simulate(build_scene(rig), poses, instants)
    force = trace.outputs["wrench"][:, :3]
    move = np.diff(poses["finger"].sample(instants)[0], axis=0)
    work = -(force[1:] * move).sum(axis=1)
    assert np.abs(work).sum() > 1e-7, "the finger does no work in this motion"
    assert work.sum() >= -1e-3 * np.abs(work).sum()
