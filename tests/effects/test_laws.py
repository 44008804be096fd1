"""Laws of effects against differences of themselves, without a rollout: stress of energy, tangent of stress, pushes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from material_points import Strained, push, respond

from sim_core.effects import all_effects
from sim_core.effects.hooks import FieldMap, FrictionLaw, MaterialLaw, NormalLaw
from sim_core.energies.strain import SHEAR
from sim_core.materials.elastic import plane_stress

STEP = 1e-6
COUNT = 7


def effects_of(kind: type) -> list[str]:
    return [name for name, effect in all_effects().items() if isinstance(effect, kind)]


def parts_of(name: str) -> Iterator[Strained]:
    """What the law of an effect sees in elements of each part that it amends, strained until it shows, and before it
    does: no state of its own is at a switch."""
    effect, rng = all_effects()[name], np.random.default_rng(5)
    for part in effect.parts:
        solid = part == "solid"
        size = 6 if solid else 3
        own = (
            SHEAR if solid else plane_stress({"E_pa": 2.0, "nu": 0.3, "anisotropy_ratio": 1.5, "grain_angle_rad": 0.2})
        )
        typical = {"membrane": 1e-5, "bending": 2.0, "solid": 0.1}[part]
        strain, before = typical * rng.uniform(-1.0, 1.0, (2, COUNT, size))
        state = {n: 0.3 * typical * rng.uniform(0.1, 1.0, (COUNT, *shape)) for n, shape in effect.state().items()}
        stiffness = own * rng.uniform(0.5, 2.0, COUNT)[:, None, None]
        yield Strained(strain, before, stiffness, state, 0.02)


def moved(at: Strained, change: Strained, by: float) -> Strained:
    state = {n: z + by * change.state[n] for n, z in at.state.items()}
    ends = (getattr(at, f) + by * getattr(change, f) for f in ("strain", "before", "stiffness"))
    return Strained(*ends, state, at.dt)


@pytest.mark.parametrize("name", effects_of(MaterialLaw))
def test_stress_is_the_derivative_of_the_energy_and_the_tangent_that_of_the_stress(name: str) -> None:
    effect, values = all_effects()[name], all_effects()[name].example
    for at in parts_of(name):
        here, size = respond(effect, at, values), float(np.abs(at.strain).max())
        along = np.random.default_rng(1).standard_normal(at.strain.shape) * size
        ends = [respond(effect, replace(at, strain=at.strain + s * STEP * along), values) for s in (1.0, -1.0)]
        energy, stress = ((getattr(ends[0], f) - getattr(ends[1], f)) / (2.0 * STEP) for f in ("energy", "stress"))
        work = (here.stress * along).sum(axis=-1)
        assert energy == pytest.approx(work, rel=1e-6, abs=1e-7 * float(np.abs(work).max()))
        linear = (here.tangent @ along[..., None])[..., 0]
        assert stress == pytest.approx(linear, rel=1e-6, abs=1e-7 * float(np.abs(stress).max()) + 1e-30)


@pytest.mark.parametrize("name", effects_of(MaterialLaw))
def test_a_push_of_a_material_law_is_the_difference_of_its_response(name: str) -> None:
    """Along changes of all that it sees and of its parameters."""
    effect, values, rng = all_effects()[name], dict(all_effects()[name].example), np.random.default_rng(2)
    for at in parts_of(name):
        size = float(np.abs(at.strain).max())
        change = Strained(
            size * rng.standard_normal(at.strain.shape),
            size * rng.standard_normal(at.strain.shape),
            at.stiffness * rng.standard_normal(COUNT)[:, None, None],
            {n: size * rng.standard_normal(z.shape) for n, z in at.state.items()},
            0.0,
        )
        by = {n: v * rng.standard_normal() for n, v in values.items()}
        ends = [
            respond(effect, moved(at, change, s * STEP), {n: v + s * STEP * by[n] for n, v in values.items()})
            for s in (1.0, -1.0)
        ]
        stress, state = push(effect, at, change, values, by)
        difference = (ends[0].stress - ends[1].stress) / (2.0 * STEP)
        assert difference == pytest.approx(stress, rel=1e-6, abs=1e-7 * float(np.abs(stress).max()))
        for n, z in state.items():
            difference = (ends[0].state[n] - ends[1].state[n]) / (2.0 * STEP)
            assert difference == pytest.approx(z, rel=1e-6, abs=1e-7 * float(np.abs(z).max()))


def against_parameters(values: dict[str, float], law: Callable[[dict[str, float]], Any], by: dict[str, Any]) -> None:
    for name, slope in by.items():
        step = STEP * max(abs(values[name]), 1e-3)
        high, low = (law({**values, name: values[name] + s * step}) for s in (1.0, -1.0))
        size = float(np.abs(slope).max())
        assert (high - low) / (2.0 * step) == pytest.approx(slope, rel=1e-5, abs=1e-6 * size), name


@pytest.mark.parametrize("name", effects_of(NormalLaw))
def test_normal_laws(name: str) -> None:
    effect, values = all_effects()[name], dict(all_effects()[name].example)
    reach = effect.reach(values)
    gap = reach * np.array([-0.2, 0.1, 0.4, 0.8, 1.3])
    h = STEP * reach
    low, here, high = (effect.energy.at(values, gap + s * h) for s in (-1.0, 0.0, 1.0))
    slope = here.second(0, 0)
    assert (high.v - low.v) / (2 * h) == pytest.approx(here.d[0], rel=1e-5, abs=1e-6 * np.abs(here.d[0]).max())
    assert (high.d[0] - low.d[0]) / (2 * h) == pytest.approx(slope, rel=1e-5, abs=1e-5 * np.abs(slope).max())
    assert here.v[-1] == here.d[0, -1] == slope[-1] == 0.0
    by = {name: here.second(i, 0) for i, name in enumerate(effect.energy.arguments) if i}
    against_parameters(values, lambda v: effect.energy.at(v, gap).d[0], by)


@pytest.mark.parametrize("name", effects_of(FrictionLaw))
def test_friction_laws(name: str) -> None:
    effect, values = all_effects()[name], dict(all_effects()[name].example)
    at = np.array([[50.0, 400.0, 3e3, 2e4], [1e-4, 1e-3, 8e-3, 5e-2]])  # pressures [Pa] and speeds [m/s]
    here = effect.factor.at(values, *at)
    for k, slope in enumerate(here.d[:2]):
        h = STEP * at * (np.arange(2) == k)[:, None]
        high, low = (effect.factor.at(values, *(at + s * h)) for s in (1.0, -1.0))
        size = float(np.abs(slope).max())
        assert (high.v - low.v) / (2 * h[k]) == pytest.approx(slope, rel=1e-5, abs=1e-5 * size), k
    assert (here.v > 0.0).all()
    by = dict(zip(effect.factor.arguments[2:], here.d[2:], strict=True))
    against_parameters(values, lambda v: effect.factor.at(v, *at).v, by)


@pytest.mark.parametrize("name", effects_of(FieldMap))
def test_field_maps(name: str) -> None:
    effect, values = all_effects()[name], dict(all_effects()[name].example)
    places = np.random.default_rng(3).uniform(-0.02, 0.02, (40, 3))
    here = effect.factor(places, 0.13, values).v
    assert (here > 0.0).all()
    by = dict(effect.factor_by(places, 0.13, values))
    assert set(by) == set(values)
    against_parameters(values, lambda v: effect.factor(places, 0.13, v).v, by)
    if not effect.changes:
        assert np.array_equal(here, effect.factor(places, 5.0, values).v)
