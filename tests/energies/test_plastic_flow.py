"""The return mapping of sheets that flow: on the yield surface, of least energy, whatever the step."""

import numpy as np
import pytest
from potentials import check_derivatives
from scipy.optimize import minimize_scalar
from shell_terms import ORTHOTROPIC, bending, strip

from sim_core.materials.elastic import plane_stress
from sysid.validation.springback import STIFFNESS, YIELD, Bender

D = plane_stress(ORTHOTROPIC) * ORTHOTROPIC["thickness_m"] ** 3 / 12.0
ONSET, HARDENING = 12.0, 0.3


def norm(kappa):
    return np.sqrt(np.einsum("mi,ij,mj->m", kappa, D, kappa) / D[0, 0])


def plastic_sheet(hardening=HARDENING, accumulated=7.0):
    mesh = strip("irregular")
    values = {**ORTHOTROPIC, "yield_curvature_per_m": ONSET, "hardening_ratio": hardening}
    system, term = bending(mesh, values)
    rng = np.random.default_rng(3)
    internals = {
        "plastic_curvature": 10.0 * rng.standard_normal((len(mesh.triangles), 3)),
        "accumulated_curvature": accumulated * rng.random(len(mesh.triangles)),
    }
    system.begin(mesh.nodes, internals={"bending": internals})
    system.x[:, 2] += 5e-5 * rng.standard_normal(len(mesh.nodes))
    return mesh, system, term, internals


def test_flow_ends_on_the_yield_surface_along_its_normal_and_is_none_within():
    """In moments m = D kappa_e the normal of |kappa_e|_D = s is along kappa_e."""
    _, system, term, before = plastic_sheet()
    after, kappa = system.end().internals["bending"], term.curvatures_at(system.x)
    flow, amount = (after[k] - before[k] for k in ("plastic_curvature", "accumulated_curvature"))
    flows = norm(kappa - before["plastic_curvature"]) > ONSET + HARDENING * before["accumulated_curvature"]
    assert 5 < flows.sum() < len(flows) - 5
    left, onset = kappa - after["plastic_curvature"], ONSET + HARDENING * after["accumulated_curvature"]
    np.testing.assert_allclose(norm(left)[flows], onset[flows], rtol=1e-12)
    np.testing.assert_allclose(flow[flows], (amount / norm(left))[flows, None] * left[flows], atol=1e-12 * ONSET)
    assert not flow[~flows].any() and not amount[~flows].any()


def test_the_energy_is_the_least_over_all_flows():
    """Of what is stored and lost, D_11 [(n - g)^2 / 2 + s g + H g^2 / 2] a triangle, searched for by golden section."""
    mesh, system, term, internals = plastic_sheet()
    n = norm(term.curvatures_at(system.x) - internals["plastic_curvature"])
    onset = ONSET + HARDENING * internals["accumulated_curvature"]
    assert (n > onset).any() and (n < onset).any()
    total = 0.0
    for area, nt, s in zip(mesh.areas, n, onset, strict=True):
        found = minimize_scalar(
            lambda g, nt=nt, s=s: 0.5 * (nt - g) ** 2 + s * g + 0.5 * HARDENING * g**2,
            bounds=(0.0, 2.0 * nt), method="bounded", options={"xatol": 1e-9},
        )  # fmt: skip
        total += area * D[0, 0] * min(found.fun, 0.5 * nt**2)
    assert system.energy() == pytest.approx(total, rel=1e-9)


@pytest.mark.parametrize("hardening", [0.0, 0.01, HARDENING])
def test_derivatives_match_differences_while_the_sheet_flows(hardening):
    _, system, _, internals = plastic_sheet(hardening)
    check_derivatives(system, system.x.copy())
    assert system.end().internals["bending"]["accumulated_curvature"].sum() > internals["accumulated_curvature"].sum()


def test_the_tangent_of_a_sheet_that_flows_is_positive_semidefinite():
    values = np.linalg.eigvalsh(plastic_sheet()[1].hessian())
    assert values[0] > -1e-12 * values[-1]


@pytest.mark.parametrize("hardening", [0.05, 0.5])
def test_the_moment_while_flowing_does_not_depend_on_the_step(hardening):
    """In one step of twice the yield curvature: yield moment and hardening to 0.1 %, as in forty steps."""
    expected = (1.0 + hardening * 2.0 / (1.0 + hardening)) * STIFFNESS * YIELD
    few, many = Bender("regular", (10, 4), hardening), Bender("regular", (10, 4), hardening)
    moments = [few.bend([YIELD, 3.0 * YIELD])[-1], many.bend((YIELD * np.linspace(0.0, 3.0, 41)[1:]).tolist())[-1]]
    np.testing.assert_allclose(moments, expected, rtol=1e-3)
    np.testing.assert_allclose(moments[0], moments[1], rtol=1e-6)


def test_at_yield_but_for_round_off_a_sheet_is_elastic_to_all_its_derivatives():
    """The tangent of the step and the derivatives of the flow are of one branch, which round-off does not choose."""
    mesh, system, term, internals = plastic_sheet()
    n = norm(term.curvatures_at(system.x) - internals["plastic_curvature"])
    tangents = {}
    for name, onset in (("at yield", n * (1.0 - 1e-14)), ("elastic", n + 1.0), ("beyond", 0.999 * n)):
        internals["accumulated_curvature"] = (onset - ONSET) / HARDENING
        system.begin(mesh.nodes, internals={"bending": internals})
        flows = system.end().internals["bending"]["accumulated_curvature"] > internals["accumulated_curvature"]
        assert flows.any() == (name == "beyond")
        tangents[name] = system.hessian(exact=True)
    scale = np.abs(tangents["elastic"]).max()
    assert np.abs(tangents["at yield"] - tangents["elastic"]).max() < 1e-10 * scale
    assert np.abs(tangents["beyond"] - tangents["elastic"]).max() > 1e-2 * scale
