"""Loads of rigs against closed forms, and what they must not depend on."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from sim_core.gradients import directions, simulate_adjoint, simulate_tangent
from sim_core.rigs import list_parameters, parse_rig, with_parameters
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, simulate, step_times
from sim_core.solve.step import NewtonSettings
from sysid.validation import planar_elastica
from sysid.validation.plates import SAG

STILL = {"gravity_m_s2": [0.0, 0.0, 0.0], "solver": {"dt_s": 0.1, "inertia": False}}
RAMP = {"times_s": [0.0, 1.0], "values": [0.0, 1.0]}


def sheet(length, width, cells, nu=0.0, E=1e9, h=5e-4, **more):
    shape = {"type": "rectangle", "length_m": length, "width_m": width, "cells": cells, **more}
    material = {"E_pa": E, "nu": nu, "thickness_m": h, "density_kg_m3": 1000.0}
    return {"type": "sheet", "shape": shape, "material": material}


def strip(*loads, name="strip", cells=(44, 4), **changes):
    """A strip of which 0.1 m are free, clamped on the left."""
    clamp = {"name": "vice", "body": "strip", "region": {"x_m": [-0.055, -0.045]}}
    wrench = {"vice_wrench": {"type": "wrench", "on": "vice", "topic": "wrench"}}
    bodies = {"strip": sheet(0.11, 0.02, list(cells))}
    data = {"name": name, **STILL, "bodies": bodies, "clamps": [clamp], "sensors": wrench, "loads": list(loads)}
    return parse_rig({**data, **changes}, name)


STIFFNESS = 1e9 * 5e-4**3 / 12.0 * 0.02
"""Of that strip, E I [N m^2]."""
TIP = {"name": "tip", "body": "strip", "region": {"x_m": [0.055, 0.055]}}


def test_a_cantilever_under_a_force_at_its_end_is_the_elastica():
    alpha = 4.0
    force = alpha * STIFFNESS / 0.1**2
    rig = strip({**TIP, "type": "force", "force_n": [0.0, 0.0, -force], **RAMP})
    scene = build_scene(rig)
    simulation = Simulation(scene)
    for _ in range(10):
        simulation.step({}, 0.1)
    tip = simulation.state.x[scene.bodies["strip"].local[:, 0] > 0.0549].mean(axis=0)
    deflection, shortening = planar_elastica.tip_loaded(alpha)
    assert -tip[2] / 0.1 == pytest.approx(deflection, rel=5e-3)
    assert (0.055 - tip[0]) / 0.1 == pytest.approx(shortening, rel=5e-3)
    np.testing.assert_allclose(simulation.read()["vice_wrench"][:3], [0.0, 0.0, -force], atol=1e-6 * force)


def test_a_weight_that_hangs_is_its_mass_times_gravity():
    hung = strip({**TIP, "type": "weight", "mass_kg": 1e-4}, gravity_m_s2=[0.0, 3.0, -9.0])
    pulled = strip({**TIP, "type": "force", "force_n": [0.0, 3e-4, -9e-4]}, gravity_m_s2=[0.0, 3.0, -9.0])
    found = [Simulation(build_scene(rig)).state.x for rig in (hung, pulled)]
    assert np.ptp(found[0][:, 2]) > 1e-3
    np.testing.assert_allclose(*found, atol=1e-12)


def block(load, nu=0.0):
    gel = {
        "type": "gel",
        "shape": {"type": "block", "size_m": [0.02, 0.02, 0.03], "cells": [2, 2, 3]},
        "material": {"E_pa": 1e5, "nu": nu, "density_kg_m3": 1000.0},
        "bonded": "bottom",
        "mount": "world",
    }
    return parse_rig({"name": "bar", **STILL, "bodies": {"bar": gel}, "loads": [load]}, "bar")


@pytest.mark.parametrize(
    "load, stretch",
    [
        ({"type": "traction", "face": "top", "traction_pa": [0.0, 0.0, 50.0]}, 5e-4),
        ({"type": "pressure", "face": "top", "pressure_pa": 50.0}, -5e-4),
        ({"type": "force", "region": {"z_m": [0.015, 0.015]}, "force_n": [0.0, 0.0, 0.02]}, 5e-4),
    ],
)
def test_a_bar_is_stretched_by_stress_over_modulus(load, stretch):
    scene = build_scene(block({"name": "end", "body": "bar", **load}))
    moved = Simulation(scene).state.x[:, 2] - scene.rest[:, 2]
    height = scene.rest[:, 2] + 0.015
    np.testing.assert_allclose(moved, stretch * height, atol=2e-3 * abs(stretch) * 0.03)


def test_a_clamped_plate_sags_under_pressure():
    """Timoshenko & Woinowsky-Krieger, table 35, by a Ritz series."""
    cells, side, nu, h = 32, 0.1, 0.3, 5e-4
    whole = side * (cells + 2) / cells
    near, far = 0.5 * side, 0.5 * whole
    rims = [{"x_m": [-far, -near]}, {"x_m": [near, far]}, {"y_m": [-far, -near]}, {"y_m": [near, far]}]
    stiffness = 1e9 * h**3 / 12.0 / (1.0 - nu**2)
    pressure = 1e-3 * h * stiffness / side**4 / SAG["clamped"]
    data = {
        "name": "plate", **STILL,
        "bodies": {"plate": sheet(whole, whole, [cells + 2, cells + 2], nu)},
        "clamps": [{"body": "plate", "region": region} for region in rims],
        "loads": [{"name": "gas", "type": "pressure", "body": "plate", "pressure_pa": pressure}],
    }  # fmt: skip
    x = Simulation(build_scene(parse_rig(data, "plate"))).state.x
    centre = np.argmin(np.linalg.norm(x[:, :2], axis=1))
    assert x[centre, 2] * stiffness / (pressure * side**4) == pytest.approx(SAG["clamped"], rel=0.02)


def film(pressure, pattern="crossed"):
    """A thin film of 0.1 m between two clamps, whose long sides are free."""
    clamps = [{"body": "film", "region": {"x_m": x}} for x in ([-0.06, -0.05], [0.05, 0.06])]
    body = sheet(0.12, 0.04, [24, 8], E=1e6, h=1e-5, pattern=pattern)
    load = {"name": "gas", "type": "pressure", "body": "film", "region": {"x_m": [-0.05, 0.05]}}
    load |= {"pressure_pa": pressure, **RAMP}
    return parse_rig({"name": "film", **STILL, "bodies": {"film": body}, "clamps": clamps, "loads": [load]}, "film")


def test_a_film_between_clamps_is_blown_into_a_cylinder():
    """Without lateral contraction a film of the chord L is an arc of half angle a, stretched by a / sin(a), whose
    tension h E (s^2 - 1) s / 2 (St. Venant-Kirchhoff) is the pressure times the radius L / (2 sin(a))."""
    pressure, tightness = 20.0, 1e6 * 1e-5

    def excess(a):
        s = a / np.sin(a)
        return tightness * 0.5 * (s**2 - 1.0) * s - pressure * 0.05 / np.sin(a)

    a = brentq(excess, 1e-3, 1.5)
    scene = build_scene(film(pressure))
    simulation = Simulation(scene)
    for _ in range(12):
        simulation.step({}, 0.1)
    local, x = scene.bodies["film"].local, simulation.state.x
    middle = np.abs(local[:, 0]) < 1e-9
    rise = 0.05 / np.sin(a) * (1.0 - np.cos(a))
    assert rise > 0.01
    np.testing.assert_allclose(x[middle, 2], rise, rtol=4e-3)


def test_pressure_turns_with_the_body():
    """A strip with free rims, turned by 90 degrees while it is loaded: in the end, once at rest, all is turned."""
    load = {"name": "gas", "type": "pressure", "body": "strip", "pressure_pa": 24.0}
    clamp = {"name": "vice", "body": "strip", "region": {"x_m": [-0.055, -0.045]}, "mount": "hand"}
    rig = strip(load, cells=(22, 2), clamps=[clamp], end_effectors={"hand": {}}, sensors={})
    scene = build_scene(rig)
    simulation = Simulation(scene, NewtonSettings(step_tolerance_m=1e-12))
    before = simulation.state.x.copy()
    assert np.ptp(before[:, 2]) > 0.02
    for k in range(1, 10):
        simulation.step({"hand": frame(min(k, 6) * np.pi / 12.0)}, 0.1)
    expected = before @ frame(np.pi / 2.0)[1].as_matrix().T
    np.testing.assert_allclose(simulation.state.x, expected, atol=2e-7)


def frame(angle):
    return np.zeros(3), Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8]))


def test_free_rims_converge_with_the_step():
    """While a pressed strip turns, forces on its free rim are of the start of the step: an error of first order."""
    load = {"name": "gas", "type": "pressure", "body": "strip", "pressure_pa": 24.0}
    clamp = {"name": "vice", "body": "strip", "region": {"x_m": [-0.055, -0.045]}, "mount": "hand"}
    scene = build_scene(strip(load, cells=(11, 2), clamps=[clamp], end_effectors={"hand": {}}, sensors={}))
    exact = Simulation(scene).state.x @ frame(0.5)[1].as_matrix().T
    errors = []
    for count in (4, 8, 16):
        simulation = Simulation(scene)
        for k in range(1, count + 1):
            simulation.step({"hand": frame(0.5 * k / count)}, 0.1)
        errors.append(np.abs(simulation.state.x - exact).max())
    assert errors[0] < 2e-3
    assert np.log2(errors[0] / errors[2]) / 2.0 > 0.9


LOADS = [
    {"name": "gas", "type": "pressure", "body": "card", "region": {"x_m": [0.0, 0.04]}, "pressure_pa": 3.0},
    {"name": "tip", "type": "force", "body": "card", "region": {"x_m": [0.04, 0.04]}, "force_n": [1e-3, 2e-3, -4e-3]},
    {"name": "bob", "type": "weight", "body": "card", "region": {"x_m": [0.0, 0.02]}, "mass_kg": 2e-4},
    {"name": "wind", "type": "traction", "body": "card", "traction_pa": [0.0, 0.5, 0.5]},
    {"name": "squeeze", "type": "pressure", "body": "gel", "face": "top", "pressure_pa": 900.0},
]


@pytest.mark.parametrize("solver", [{"dt_s": 0.02, "inertia": True}, {"dt_s": 0.02, "inertia": False}])
def test_gradients_by_loads_and_all_else(solver, small_rig, visit):
    """Adjoint and tangent against central differences of rollouts, with all kinds of loads that change in time."""
    loads = [{**load, "times_s": [0.0, 0.05, 0.2], "values": [0.3, 1.0, 0.4]} for load in LOADS]
    rig = small_rig(solver=solver, loads=loads, contacts=[])
    poses = visit([0.0, 0.05, 0.1], [[0.0, 0.0, 0.0], [1e-3, 0.0, 1e-3], [0.0, 0.0, 0.0]])
    times, tight = step_times(0.0, 0.1, 0.02), NewtonSettings(step_tolerance_m=5e-15)
    own = [p.name for p in list_parameters(rig) if p.name.split(".")[0] in {load["name"] for load in LOADS}]
    assert len(own) == 9
    names = [*own, "card.E_pa", "card.density_kg_m3", "gravity.z_m_s2", "gel.E_pa"]
    along, scene = directions(rig, names), build_scene(rig)
    trace, derivatives = simulate_tangent(scene, poses, times, along, settings=tight)
    rng = np.random.default_rng(4)
    given = {c: rng.standard_normal(o.shape) / np.nanstd(o) for c, o in trace.outputs.items()}

    def loss(trace):
        return float(sum(np.nansum(given[c] * o) for c, o in trace.outputs.items())), given

    found = simulate_adjoint(scene, poses, times, loss, along, settings=tight)
    values = {p.name: p.value for p in list_parameters(rig)}
    for k, name in enumerate(names):
        forward = sum(np.nansum(given[c] * d[..., k]) for c, d in derivatives.items())
        ends = []
        for sign in (1.0, -1.0):
            step = 1e-3 * abs(values[name]) or 1e-4
            scene.use(with_parameters(rig, {name: values[name] + sign * step}))
            ends.append(loss(simulate(scene, poses, times, settings=tight))[0])
        scene.use(rig)
        difference = (ends[0] - ends[1]) / (2.0 * step)
        round_off = 1e-14 * sum(np.nansum(np.abs(given[c] * o)) for c, o in trace.outputs.items()) / step
        assert forward == pytest.approx(difference, rel=2e-5, abs=round_off), name
        assert round_off < 0.01 * abs(forward), name
        assert found.parameters[name] == pytest.approx(forward, rel=1e-7), name
