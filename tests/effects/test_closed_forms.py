"""Closed forms of single laws: loops, steps, uniform motions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from material_points import Strained, respond
from scipy.spatial.transform import Rotation

from sim_core.effects import all_effects, effect_by_name
from sim_core.effects.hooks import Channel, CommandMap
from sim_core.energies.strain import SHEAR
from sim_core.materials.elastic import plane_stress

NU = 0.3
PLATE = plane_stress({"E_pa": 2.0, "nu": NU})[None]
STRIP = np.array([1.0, -NU, 0.0])
"""Strains of a strip that is pulled or bent along x: the stress across it is zero."""


def driven(name: str, values: dict[str, float], path: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Stress at the end of each step of a path of strains ``(n, k)`` from rest."""
    effect: Any = effect_by_name(name)
    state = {n: np.zeros((1, *shape)) for n, shape in effect.state().items()}
    before, out = np.zeros((1, path.shape[1])), []
    for strain in path[:, None]:
        found = respond(effect, Strained(strain, before, stiffness, state, 0.01), values)
        state, before = dict(found.state), strain
        out.append(found.stress[0])
    return np.array(out)


def test_bent_to_and_fro_a_strip_makes_a_loop_of_known_height() -> None:
    values = {"share": 0.5, "slip_curvature_per_m": 0.4}
    bend = np.concatenate([np.linspace(0.0, 2.0, 41), np.linspace(2.0, -2.0, 81)])
    moment = driven("bending_friction", values, bend[:, None] * STRIP, PLATE)
    assert moment[:, 0].max() == pytest.approx(0.5 * 2.0 * 0.4)
    assert moment[-1, 0] == pytest.approx(-0.5 * 2.0 * 0.4)
    assert moment[4, 0] == pytest.approx(0.5 * 2.0 * bend[4])
    assert np.abs(moment[:, 1:]).max() < 1e-12


@pytest.mark.parametrize(
    ("name", "number"), [("sheet_stiffening", "coefficient"), ("bending_stiffening", "coefficient_m2")]
)
def test_a_strip_stiffens_with_the_square_of_its_strain(name: str, number: str) -> None:
    e = np.array([0.01, 0.02, -0.03])
    found = driven(name, {number: 50.0}, e[:, None] * STRIP, PLATE)
    assert found[:, 0] == pytest.approx(2.0 * e * 50.0 * e**2)


def test_a_gel_is_softer_up_to_the_largest_strain_so_far() -> None:
    """q of a bar is its strain; the share that is lost is that of the largest strain."""
    mu, values = 3.0, {"share": 0.4, "strain": 0.1}
    bar = np.array([1.0, -0.5, -0.5, 0.0, 0.0, 0.0])
    strains = np.array([0.1, 0.3, 0.1, 0.3])
    stress = driven("gel_mullins", values, strains[:, None] * bar, mu * SHEAR[None])[:, 0]
    lost = 0.4 * (1.0 - np.exp(-np.array([0.1, 0.3, 0.3, 0.3]) / 0.1))
    assert stress == pytest.approx(-lost * 2.0 * mu * strains)


def channel(name: str, kind: Any, stamps: np.ndarray, rig: Any = None) -> Channel:
    return Channel(name, kind, stamps, 0.0, rig)


def test_a_filter_follows_a_ramp_late_by_its_time_constant() -> None:
    effect, stamps = effect_by_name("wrench_low_pass"), np.sort(np.random.default_rng(0).uniform(0.0, 3.0, 40))
    ramp = stamps[:, None] * np.arange(1.0, 7.0)
    found = effect.read(channel("wrench", "wrench", stamps), ramp, {"tau_s": 0.2})  # type: ignore[attr-defined]
    since = stamps - stamps[0]
    late = 0.2 * (1.0 - np.exp(-since / 0.2))
    np.testing.assert_allclose(found, (stamps - late)[:, None] * np.arange(1.0, 7.0), rtol=1e-12)


def test_a_rolling_shutter_sees_a_uniform_motion_at_the_time_of_each_row(small_rig: Any) -> None:
    rig, stamps = small_rig(), np.array([0.0, 0.04, 0.08])
    speed = np.array([120.0, 0.0])
    first = np.array([[600.0, 0.0], [600.0, 360.0], [600.0, 720.0]])
    points = first + stamps[:, None, None] * speed
    found = effect_by_name("rolling_shutter").read(  # type: ignore[attr-defined]
        channel("side", "tracks", stamps, rig), points, {"readout_s": 0.02}
    )
    late = 0.02 * (first[:, 1] / 720.0 - 0.5)
    np.testing.assert_allclose(found, points + late[:, None] * speed, rtol=1e-12)


def test_play_is_used_up_after_each_reversal() -> None:
    effect: Any = effect_by_name("hand_backlash")
    values, still = {"play_m": 1e-3, "play_deg": 2.0}, Rotation.identity()
    memory = effect.begin((np.zeros(3), still), values)
    found = []
    for place, angle in ((5e-3, 10.0), (4e-3, 9.0), (0.0, -10.0)):
        pose = np.array([place, 0.0, 0.0]), Rotation.from_euler("z", angle, degrees=True)
        memory, reached = effect.advance(memory, pose, 0.01, values)
        found.append((reached[0][0], reached[1].as_rotvec(degrees=True)[2]))
    np.testing.assert_allclose(found, [(4e-3, 8.0), (4e-3, 8.0), (1e-3, -8.0)], atol=1e-9)


@pytest.mark.parametrize("name", [n for n, e in all_effects().items() if isinstance(e, CommandMap)])
def test_weights_pass_a_command_map_as_motions_do(name: str) -> None:
    """Of small motions of each commanded pose, p + rho and exp(phi) R, by differences of the map alone."""
    effect: Any = effect_by_name(name)
    values, rng = {**effect.example, **({"play_deg": 1.0} if name == "hand_backlash" else {})}, np.random.default_rng(4)
    times = np.arange(6) * 0.02
    places = np.cumsum(rng.uniform(-2e-3, 2e-3, (6, 3)), axis=0)
    turns = Rotation.from_rotvec(np.cumsum(rng.uniform(-0.05, 0.05, (6, 3)), axis=0))
    poses = [(places[k], turns[k]) for k in range(6)]
    weights = rng.standard_normal((6, 6))

    def reached(commanded: list[Any]) -> list[Any]:
        memory, out = effect.begin(commanded[0], values), [commanded[0]]
        for k in range(1, 6):
            memory, pose = effect.advance(memory, commanded[k], float(times[k] - times[k - 1]), values)
            out.append(pose)
        return out

    here, found = reached(poses), np.zeros((6, 6))
    for k in range(6):
        for axis in range(6):
            step, ends = 1e-6 * np.eye(6)[axis], []
            for s in (1.0, -1.0):
                pose = poses[k][0] + s * step[:3], Rotation.from_rotvec(s * step[3:]) * poses[k][1]
                moved = reached([*poses[:k], pose, *poses[k + 1 :]])
                motions = [_in_world(a, b) for a, b in zip(here, moved, strict=True)]
                ends.append(float((weights * np.array(motions)).sum()))
            found[k, axis] = (ends[0] - ends[1]) / 2e-6
    np.testing.assert_allclose(effect.pull(times, poses, weights, values), found, atol=2e-5)


def _in_world(low: Any, high: Any) -> np.ndarray:
    """Motion from one pose to another near it along the axes of the world."""
    return np.concatenate([high[0] - low[0], (high[1] * low[1].inv()).as_rotvec()])
