"""The energy of a system that nothing drives only falls, step by step, whatever it is made of (implicit Euler)."""

import numpy as np
import pytest

from sim_core.rigs import load_rig, with_parameters
from sim_core.scene import build_scene
from sim_core.sensing.observe import frame_of
from sim_core.solve.report import NewtonSettings
from sim_core.stepping import Simulation
from sysid.bench.stress_test import RISE, step_energies

TIGHT = NewtonSettings(step_tolerance_m=1e-12, force_tolerance=1e-9)
EULER = {"integrator": "implicit_euler"}


def euler(name):
    rig = load_rig(name)
    return rig.model_copy(update={"solver": rig.solver.model_copy(update=EULER)})


def pressed(offset, dt, steps, rig):
    """The rig's only hand moves by ``offset`` [m] within ``steps``, and stops."""
    simulation = Simulation(build_scene(rig), TIGHT)
    (mount,) = rig.end_effectors
    origin, rotation = simulation.scene.start[mount]
    for k in range(1, steps + 1):
        moved = origin + np.array(offset) * k / steps
        simulation.step({mount: frame_of(moved, rotation.as_quat())}, dt)
    return simulation


def small(small_rig, **given):
    """A card struck by a gel finger at 0.1 m/s, with friction, and what it is made of."""
    effects = {"bending_plasticity": {"yield_curvature_per_m": 0.5, "hardening_ratio": 0.2}} if not given else {}
    rig = with_parameters(small_rig(effects=effects), given)
    return pressed([0.002, 0.0, -0.012], 0.005, 24, rig)


SYSTEMS = {
    "card and gel, plastic": (lambda small_rig: small(small_rig), 0.005, 40),
    "card and gel, damped": (
        lambda small_rig: small(
            small_rig,
            **{"card.mass_damping_per_s": 1.0, "card.stiffness_damping_s": 2e-4, "gel.stiffness_damping_s": 5e-3},
        ),
        0.005,
        40,
    ),
    "plastic fold with contact of a sheet with itself": (
        lambda small_rig: pressed([0.0, 0.0, -4e-3], 5e-3, 20, load_rig("folding")),
        0.005,
        30,
    ),
    "sheet, gel, plane": (lambda small_rig: pressed([2e-3, 0.0, -5e-3], 5e-3, 20, load_rig("forming")), 0.005, 30),
    "sheet that falls and bounces": (
        lambda small_rig: Simulation(build_scene(euler("bouncing")), TIGHT),
        None,
        150,
    ),
    "free bodies": (lambda small_rig: pressed([0.0] * 3, 2e-3, 1, euler("push_block")), 2e-3, 40),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_energy_never_rises_while_nothing_is_driven(name, small_rig):
    build, dt, steps = SYSTEMS[name]
    simulation = build(small_rig)
    dt = dt or simulation.scene.rig.solver.dt_s
    change = moving = most = fallen = 0.0
    last = np.inf
    for k in range(steps):
        before = simulation.state
        simulation.step({}, dt)
        assert simulation.halvings == 0
        found = step_energies(simulation, before, dt)
        allowed, made = found.tolerance(TIGHT), found.end - found.start
        assert made <= allowed, k
        # Between steps only limits of friction change.
        assert found.start - last <= allowed + RISE * (moving + fallen), k
        moving, change, most, last = max(moving, found.kinetic), change + made, max(most, allowed), found.end
        fallen = -made
    assert moving > 100.0 * most and change < -100.0 * most  # it was a matter of more than the tolerance
