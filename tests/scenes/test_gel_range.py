"""A gel that is pressed too far is refused by name before it turns inside out, and its force never falls on the way."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from sim_core.energies.element_volume import least_volumes
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.geometry import solids
from sim_core.rigs import Rig, load_rig
from sim_core.scene import build_scene
from sim_core.scene.solid_range import ElementInverted, LeastVolume, softening_volume
from sim_core.simulate import Simulation
from sysid.fit.pressed_gels import pressed_gels

BLOCK = solids.block((0.02, 0.01, 0.01), (2, 1, 1))


def term() -> NeoHookean:
    return NeoHookean("gel", BLOCK.tets, BLOCK.nodes)


@pytest.mark.parametrize(
    ("gradient", "least"),
    [
        (np.diag([1.0, 1.0, 0.25]), 0.25),
        (np.diag([2.0, 1.0, 1.0]), 1.0),
        (np.diag([1.0, 1.0, -0.5]), -0.5),
        (np.diag([1.0, -0.5, -0.5]), 0.0),  # J = (1 - 3/2 s)^2: a double root, at 0 and no less
        (np.diag([-0.5, -1.0, 1.0]), -1 / 48),  # J = (1 - 3/2 s)(1 - 2 s), least between its roots at 7/12
        (Rotation.from_euler("x", 90, degrees=True).as_matrix(), 0.5),
        (Rotation.from_euler("y", 120, degrees=True).as_matrix(), 0.25),
    ],
)
def test_the_least_volume_on_the_straight_way(gradient: np.ndarray, least: float) -> None:
    """Closed forms; a turn by a comes to cos(a/2)^2."""
    path = np.stack([BLOCK.nodes, BLOCK.nodes @ gradient.T, BLOCK.nodes @ gradient.T])
    found = least_volumes(term(), path)
    np.testing.assert_allclose(found[0], least, atol=1e-9)
    np.testing.assert_allclose(found[1], np.linalg.det(gradient), atol=1e-9)  # it stays there


@pytest.mark.parametrize("nu", [0.2, 0.3, 0.45, 0.49])
def test_where_the_law_gets_softer_is_where_its_force_is_largest(nu: float) -> None:
    """The energy itself, free to widen at each stretch, by numbers."""
    mu, bulk = 0.5 / (1.0 + nu), 0.5 / (1.0 + nu) / (1.0 - 2.0 * nu)
    c = 1.0 - 2.0 * nu  # below the stretch c / (1 + c) it would widen to no volume

    def energy(s: float, t: float) -> float:
        j = s * t * t
        return 0.5 * mu * (s * s + 2.0 * t * t - 3.0) - mu * (j - 1.0) + 0.5 * bulk * (j - 1.0) ** 2

    def relaxed(s: float) -> float:
        return float(
            minimize_scalar(lambda t: energy(s, t), bounds=(0.05, 6.0), method="bounded", options={"xatol": 1e-12}).x
        )

    def force(s: float) -> float:
        t = relaxed(s)
        return (energy(s + 1e-6, t) - energy(s - 1e-6, t)) / 2e-6

    s = float(minimize_scalar(force, bounds=(c / (1.0 + c) + 1e-3, 0.9), method="bounded", options={"xatol": 1e-10}).x)
    assert softening_volume(nu) == pytest.approx(s * relaxed(s) ** 2, rel=2e-3)


def over_post(rig: Rig) -> Rig:
    finger = rig.end_effectors["finger"]
    start = finger.start.model_copy(update={"position_m": (0.08, 0.0, 0.0541)})
    return rig.model_copy(update={"end_effectors": {"finger": finger.model_copy(update={"start": start})}})


PRESSES = {
    "card_press": SimpleNamespace(thickness=0.004, down=(0, 0, -1), gel="gel", change=over_post, gap=1e-4),
    "gel_sensor": SimpleNamespace(thickness=0.004, down=(0, 0, -1), gel="gel", change=lambda rig: rig, gap=1e-3),
    "tactip_cr": SimpleNamespace(thickness=0.0056, down=(0, 0, 1), gel="dome", change=lambda rig: rig, gap=1e-3),
}


def forces(name: str, step_m: float) -> tuple[np.ndarray, str]:
    """Contact force [N] on the gel after each step of a press to twice its thickness, and what ended it."""
    press = PRESSES[name]
    rig = press.change(load_rig(name))
    simulation = Simulation(build_scene(rig))
    (effector,) = rig.end_effectors
    origin, turn = simulation.scene.start[effector]
    found = []
    for k in range(1, int((2.0 * press.thickness + press.gap) / step_m) + 1):
        try:
            simulation.step({effector: (origin + k * step_m * np.array(press.down), turn)}, rig.solver.dt_s)
        except ElementInverted as error:
            return np.array(found), str(error)
        wrenches = [w for pair, w in simulation.contact_wrenches().items() if press.gel in pair]
        found.append(float(np.linalg.norm(sum(wrenches)[:3])))
    return np.array(found), ""


@pytest.mark.parametrize(
    ("name", "step_m"),
    [("gel_sensor", 2e-4), *(pytest.param(n, s, marks=pytest.mark.slow) for n in PRESSES for s in (1e-4, 8e-4))],
)
def test_force_never_falls_while_the_finger_advances(name: str, step_m: float) -> None:
    found, end = forces(name, step_m)
    assert found[-1] > 1.0 and (np.diff(found) >= -1e-6 * found.max()).all()
    gel = PRESSES[name].gel
    if name == "tactip_cr":
        assert not end  # its wall bends
        return
    assert f"{gel} would turn inside out near x = " in end and "End the motion there" in end


def test_a_state_that_is_refused_is_the_one_before() -> None:
    """A retreat goes on from there."""
    rig = over_post(load_rig("card_press"))
    simulation = Simulation(build_scene(rig))
    origin, turn = simulation.scene.start["finger"]
    for depth in np.arange(4e-4, 2.5e-3, 4e-4):
        simulation.step({"finger": (origin - [0, 0, depth], turn)}, rig.solver.dt_s)
    with pytest.raises(ElementInverted):
        simulation.step({"finger": (origin - [0, 0, 3.6e-3], turn)}, rig.solver.dt_s)
    assert simulation.least_volumes["gel"].ratio > 0.0
    deep = float(np.linalg.norm(simulation.contact_wrenches()["gel-post"][:3]))
    simulation.step({"finger": (origin - [0, 0, 2.0e-3], turn)}, rig.solver.dt_s)
    assert 1.0 < float(np.linalg.norm(simulation.contact_wrenches()["gel-post"][:3])) < deep


def test_a_fit_says_that_its_path_came_near() -> None:
    near = LeastVolume("gel", 0.2, 1.5, (0.0, 0.0, 0.001), softening_volume(0.45))
    far = LeastVolume("gel", 0.6, 1.5, (0.0, 0.0, 0.001), softening_volume(0.45))
    runs = [SimpleNamespace(name="one"), SimpleNamespace(name="two")]
    predictions = [SimpleNamespace(trace=SimpleNamespace(least_volumes=(v,))) for v in (near, far)]
    (said,) = pressed_gels(runs, predictions)  # type: ignore[arg-type]
    assert "one" in said and "gel is pressed to 20 % of its volume near x = 0 m" in said and "below 37 %" in said
