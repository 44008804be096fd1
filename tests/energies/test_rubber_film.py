"""The neo-Hookean law of films against closed forms, differences, and linear elasticity at small strain."""

import numpy as np
import pytest
from potentials import check_derivatives
from scipy.spatial.transform import Rotation
from shell_terms import X_AXIS, alone, membrane, strip

from sim_core.energies.membrane import Membrane
from sim_core.energies.rubber_film import RUBBER as LAW
from sim_core.errors import ConfigError
from sim_core.rigs import parse_rig
from sim_core.rigs.motion import Experiment
from sim_core.rigs.yamlfile import validate
from sim_core.scene import build_scene
from sim_core.scene.assembly import strain_laws
from sim_core.scene.strain_range import StrainBeyondLaw
from sim_core.simulate import Simulation
from sysid.gradients import check_gradients

RUBBER = {"E_pa": 1.2e6, "nu": 0.5, "thickness_m": 3e-4}


def rubber(mesh, parameters=RUBBER):
    term = Membrane("film", mesh.nodes, mesh.triangles, X_AXIS)
    laws = strain_laws(term)
    laws.add("rubber", LAW)
    system = alone(term, mesh.nodes, laws)
    term.configure(parameters)
    laws.configure(laws.numbers(parameters, {}))
    system.begin(mesh.nodes, dt=0.05)
    return system, term


def rough(nodes, amplitude, seed=1):
    return nodes + amplitude * np.random.default_rng(seed).standard_normal(nodes.shape)


@pytest.mark.parametrize("stretch", [0.7, 1.0, 4.0])
@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_derivatives_match_differences(stretch, damping):
    mesh = strip("irregular")
    system, _ = rubber(mesh, {**RUBBER, "stiffness_damping_s": damping})
    system.begin(rough(mesh.nodes, 3e-4, 2), dt=0.05)
    check_derivatives(system, rough(mesh.nodes * stretch, 5e-4))


def end_force(stretches, pattern="crossed"):
    """Force on the right end of a strip of 0.05 by 0.02 m in uniform stretch, and the largest force inside."""
    mesh = strip(pattern)
    system, _ = rubber(mesh)
    system.x[:] = mesh.nodes * [*stretches, 1.0]
    force = system.gradient()
    right = np.isclose(mesh.nodes[:, 0], 0.025)
    sides = np.isclose(np.abs(mesh.nodes[:, 1]), 0.01) | np.isclose(np.abs(mesh.nodes[:, 0]), 0.025)
    return force[right, 0].sum(), np.abs(force[~sides]).max(), np.abs(force).max()


@pytest.mark.parametrize("stretch", [0.6, 1.001, 2.0, 5.0])
def test_uniaxial_tension(stretch):
    """mu (s - s^-2) per area at rest (Treloar, eq. 5.4), with stress-free sides at the lateral stretch s^-1/2."""
    force, inside, largest = end_force([stretch, stretch**-0.5])
    assert force == pytest.approx(4e5 * 3e-4 * 0.02 * (stretch - stretch**-2), rel=1e-9)
    assert inside < 1e-10 * largest


@pytest.mark.parametrize("stretch", [0.8, 1.5, 5.0])
def test_equibiaxial_tension(stretch):
    """mu (s - s^-5) per area at rest (Treloar, eq. 5.9)."""
    force, inside, largest = end_force([stretch, stretch], "irregular")
    assert force == pytest.approx(4e5 * 3e-4 * 0.02 * (stretch - stretch**-5), rel=1e-9)
    assert inside < 1e-9 * largest


def test_a_strip_with_free_sides_contracts_by_itself():
    mesh = strip("regular")
    system, _ = rubber(mesh)
    system.x[:] = mesh.nodes * [3.0, 3.0**-0.5, 1.0]
    sides = np.isclose(np.abs(mesh.nodes[:, 1]), 0.01) & (np.abs(mesh.nodes[:, 0]) < 0.024)
    force = system.gradient()
    assert np.abs(force[sides]).max() < 1e-10 * np.abs(force).max()


def test_at_small_strain_it_is_linear_elasticity():
    mesh = strip("irregular")
    at = rough(mesh.nodes, 1e-9)
    forces = []
    for system in (rubber(mesh)[0], membrane(mesh, RUBBER)[0]):
        system.x[:] = at
        forces.append(system.gradient())
    np.testing.assert_allclose(forces[0], forces[1], atol=1e-5 * np.abs(forces[1]).max())


def test_projected_hessian_is_positive_semidefinite_where_the_true_one_is_not():
    mesh = strip("crossed")
    system, _ = rubber(mesh)
    system.x[:] = rough(mesh.nodes * [0.8, 1.4, 1.0], 3e-4)
    true = np.linalg.eigvalsh(system.hessian(exact=True))
    projected = np.linalg.eigvalsh(system.hessian())
    assert true[0] < -1e-3 * true[-1]
    assert projected[0] > -1e-12 * projected[-1]


FILM = {
    "name": "film",
    "solver": {"dt_s": 0.05, "inertia": True},
    "bodies": {
        "film": {
            "type": "sheet",
            "shape": {"type": "rectangle", "length_m": 0.06, "width_m": 0.02, "cells": [6, 2]},
            "material": {"E_pa": 1.2e6, "nu": 0.5, "thickness_m": 3e-4, "density_kg_m3": 1000.0,
                         "stiffness_damping_s": 0.01},
            "law": "neo_hookean",
        }
    },
    "clamps": [
        {"body": "film", "region": {"x_m": [-0.03, -0.02]}},
        {"name": "grip", "body": "film", "region": {"x_m": [0.02, 0.03]}, "mount": "hand"},
    ],
    "end_effectors": {"hand": {}},
    "sensors": {
        "force": {"type": "wrench", "on": "grip", "topic": "wrench"},
        "dots": {"type": "markers", "body": "film", "points": {"grid": [3, 2]}, "topic": "dots"},
    },
}  # fmt: skip


def film(**changes):
    data = {**FILM["bodies"]["film"], **changes}
    return parse_rig({**FILM, "bodies": {"film": data}}, "film")


def pull(distance):
    motion = {"type": "pull", "distance_m": distance, "along": [1.0, 0.2, 0.0], "speed_m_s": 0.4, "hold_s": 0.05}
    return validate(Experiment, {"name": "pull", "motions": {"hand": [motion]}}, "pull")


def test_gradients_of_a_film_that_is_drawn_out():
    """Modulus, thickness, damping, poses, start and all fields against differences of whole rollouts."""
    names = ["film.E_pa", "film.thickness_m", "film.stiffness_damping_s", "poses", "start", "fields"]
    passed, text = check_gradients(film(), pull(0.06), names, until_s=0.2)
    assert passed, text


def test_the_ratio_is_no_parameter_and_another_is_refused():
    from sim_core.rigs import list_parameters

    assert "film.nu" not in [p.name for p in list_parameters(film())]
    assert "film.nu" not in build_scene(film()).fields.names
    with pytest.raises(ConfigError, match=r"film\.material\.nu is 0\.3, and a film .* keeps its volume"):
        film(material={**FILM["bodies"]["film"]["material"], "nu": 0.3})
    rig = parse_rig({**FILM, "effects": {"sheet_orthotropy": {"modulus_ratio": 1.5, "grain_angle_rad": 0.3}}}, "film")
    with pytest.raises(ConfigError, match=r"keeps the volume, and nu is 0\.5, the ratio of moduli 1\.5"):
        build_scene(rig)


def drawn(rig, distance, steps=10):
    simulation = Simulation(build_scene(rig))
    for k in range(1, steps + 1):
        simulation.step({"hand": (np.array([distance * k / steps, 0.0, 0.0]), Rotation.identity())}, 0.05)
    return simulation


def test_the_usual_law_warns_once_where_it_does_not_hold():
    rig = film(law="st_venant_kirchhoff")
    with pytest.warns(StrainBeyondLaw, match="film is stretched by .* at x = .* 'law: neo_hookean'") as warned:
        drawn(rig, 0.02)
    assert len([w for w in warned if w.category is StrainBeyondLaw]) == 1


@pytest.mark.filterwarnings("error::sim_core.scene.strain_range.StrainBeyondLaw")
@pytest.mark.parametrize("law, distance", [("st_venant_kirchhoff", 0.006), ("neo_hookean", 0.16)])
def test_within_its_range_no_law_warns(law, distance):
    """Free length 0.04 m: 15 % with the usual law, stretch 5 with that of films."""
    end = drawn(film(law=law), distance)
    assert np.isfinite(end.read()["force"]).all()
