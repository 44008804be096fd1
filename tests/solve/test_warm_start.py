"""Steps that begin at the path of a rollout near by: fewer factorisations, the same solutions."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.gradients import Direction, simulate_tangent
from sim_core.rigs import Rig, load_rig, with_parameters
from sim_core.rigs.motion import compile_experiment, load_experiment
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import NodePath, Trace, simulate, step_times
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-12, force_tolerance=1e-10)
"""Two searches end as near as that to a solution, and to each other."""

FRICTION = "contacts.gel-block.friction"


@pytest.fixture(scope="module")
def rig() -> Rig:
    """A gel that a block shears, in balance at each instant."""
    given = load_rig("gel_sensor")
    return given.model_copy(update={"solver": given.solver.model_copy(update={"inertia": False})})


@pytest.fixture(scope="module")
def poses(rig: Rig) -> dict[str, PoseTrajectory]:
    return compile_experiment(load_experiment("press_twist"), rig)


TIMES = step_times(0.0, 1.2, 0.04)


@pytest.fixture(scope="module")
def before(rig: Rig, poses: dict[str, PoseTrajectory]) -> Trace:
    return simulate(build_scene(rig), poses, TIMES, keep_path=True)


def factorisations(trace: Trace) -> int:
    return sum(report.factorisations for report in trace.reports)


def same(one: Trace, other: Trace) -> None:
    for channel, values in one.outputs.items():
        scale = float(np.nanmax(np.abs(values)))
        np.testing.assert_allclose(other.outputs[channel], values, atol=2e-6 * scale)


def test_a_warm_start_finds_the_same_with_fewer_factorisations(
    rig: Rig, poses: dict[str, PoseTrajectory], before: Trace
) -> None:
    other = with_parameters(rig, {FRICTION: 0.3, "gel.E_pa": 2.3e5})
    alone = simulate(build_scene(other), poses, TIMES)
    changed = max(float(np.nanmax(np.abs(v - alone.outputs[c]))) for c, v in before.outputs.items())
    assert max(r.contacts for r in alone.reports) > 0 and changed > 0.1
    warm = simulate(build_scene(other), poses, TIMES, warm_start=before.path)
    same(alone, warm)
    assert factorisations(warm) < 0.75 * factorisations(alone)
    # The tangent where the search begins tells of stability: no other one is made for that where it is good enough.
    assert sum(r.factorisations == 1 and r.iterations > 2 for r in warm.reports) >= 3


def test_a_path_that_leads_astray_changes_no_result(rig: Rig, poses: dict[str, PoseTrajectory], before: Trace) -> None:
    assert before.path is not None
    alone = simulate(build_scene(rig), poses, TIMES)
    off = 1e-3 * np.random.default_rng(0).standard_normal(before.path.positions.shape)
    same(alone, simulate(build_scene(rig), poses, TIMES, warm_start=NodePath(TIMES, before.path.positions + off)))
    fewer = NodePath(TIMES, before.path.positions[:, 1:])
    assert factorisations(simulate(build_scene(rig), poses, TIMES, warm_start=fewer)) == factorisations(alone)


def test_a_path_serves_rollouts_with_other_steps(rig: Rig, poses: dict[str, PoseTrajectory], before: Trace) -> None:
    shorter = step_times(0.0, 1.2, 0.02)
    alone = simulate(build_scene(rig), poses, shorter)
    same(alone, simulate(build_scene(rig), poses, shorter, warm_start=before.path))


def test_derivatives_are_those_of_the_rollout_itself(rig: Rig, poses: dict[str, PoseTrajectory], before: Trace) -> None:
    low, high = (with_parameters(rig, {FRICTION: f}) for f in (0.3 - 1e-5, 0.3 + 1e-5))
    along = [Direction(FRICTION, low, high, 2e-5)]
    scene = build_scene(with_parameters(rig, {FRICTION: 0.3}))
    _, alone = simulate_tangent(scene, poses, TIMES, along, settings=TIGHT)
    trace, warm = simulate_tangent(scene, poses, TIMES, along, settings=TIGHT, warm_start=before.path, keep_path=True)
    assert trace.path is not None and trace.path.positions.shape == before.path.positions.shape  # type: ignore[union-attr]
    for channel, slopes in alone.items():
        scale = float(np.nanmax(np.abs(slopes)))
        np.testing.assert_allclose(warm[channel], slopes, atol=1e-5 * scale)


def test_the_path_is_where_the_nodes_were(rig: Rig, poses: dict[str, PoseTrajectory]) -> None:
    states = simulate(build_scene(rig), poses, TIMES, settings=TIGHT, keep_states=True).states
    path = simulate(build_scene(rig), poses, TIMES, settings=TIGHT, keep_path=True).path
    assert states is not None and path is not None
    np.testing.assert_array_equal(path.positions, states.positions)
