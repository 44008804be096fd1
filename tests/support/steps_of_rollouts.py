"""Steps of rollouts, each against the potential that it makes least, and that against central differences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from sim_core.core import rollout
from sim_core.core.covers import covers
from sim_core.core.rollout import CoreRollout
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import Scene
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation, Trace, between, simulate
from sim_core.solve.report import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-13, force_tolerance=1e-11)


def check_steps(scene: Scene, poses: Mapping[str, PoseTrajectory], times: np.ndarray, *, every: int = 5) -> Trace:
    """The trace of a rollout. At the end of each step no force is left over on what may move, but for that of the
    1e-13 m to which the end is searched for. After every so many steps, at a random place 1e-6 m about, the derivatives
    of the potential agree with central differences to 1e-6 of their largest value."""
    assert covers(scene) is None
    trace = simulate(scene, poses, times, settings=TIGHT, keep_path=True)
    assert trace.path is not None
    ends, spread, rng = trace.path.positions, scene.system.spread_matrix, np.random.default_rng(0)
    dt = float(times[1] - times[0])
    checked = 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rollout, "CHUNK_BYTES", 1)  # a chunk a step
        core = CoreRollout(scene, poses, times, TIGHT)
        core.settle()
        steps = core.run()
        for k, report in enumerate(trace.reports, 1):
            if report.parts == 1:
                _, gradient, hessian = core.potential(dt, ends[k], k)
                left = spread.T @ gradient.ravel() + _springs(core, ends[k], k)
                assert np.abs(left).max() < TIGHT.step_tolerance_m * np.abs(hessian).max(), k
                checked += 1
            if k % every == 0:
                about = (spread @ (1e-6 * rng.standard_normal(spread.shape[1]))).reshape(-1, 3)
                _check_derivatives(core, dt, ends[k] + about, k, rng.standard_normal(spread.shape[1]))
            next(steps)
    assert checked > 0.9 * len(trace.reports)
    return trace


def _springs(core: CoreRollout, x: np.ndarray, k: int) -> np.ndarray:
    """What hands that have given way exert on their unknowns, the last ones."""
    system = core.scene.system
    out = np.zeros(system.spread_matrix.shape[1])
    if system.compliant:
        targets = core.scene.targets(core.frames(k))
        given = np.array([(x - targets)[group.nodes[0]] for group in system.compliant])
        out[-given.size :] = (system.springs * given).ravel()
    return out


def _check_derivatives(core: CoreRollout, dt: float, x: np.ndarray, k: int, direction: np.ndarray) -> None:
    """Gradient and true Hessian of the step to an instant; the other Hessian is positive semidefinite."""
    spread, h = core.scene.system.spread_matrix, 4e-9  # well below the 3e-5 m over which contact acts
    move = (spread @ direction).reshape(-1, 3)
    slope, change = 0.0, np.zeros_like(direction)
    for share, weight in ((1, 8), (-1, -8), (2, -1), (-2, 1)):  # of fourth order
        energy, gradient, _ = core.potential(dt, x + share * h * move, k)
        slope += weight * energy / (12.0 * h)
        change += weight * (spread.T @ gradient.ravel()) / (12.0 * h)
    _, gradient, hessian = core.potential(dt, x, k)
    found = spread.T @ gradient.ravel() + _springs(core, x, k)
    assert abs(found @ direction - slope) < 1e-6 * np.abs(found).max(), k
    found = spread.T @ hessian @ spread @ direction
    np.testing.assert_allclose(found, change, rtol=0.0, atol=1e-6 * np.abs(change).max(), err_msg=str(k))
    smooth = spread.T @ core.potential(dt, x, k, exact=False)[2] @ spread
    assert np.linalg.eigvalsh(smooth).min() > -1e-9 * np.abs(smooth).max(), k


def by_both_searches(scene: Scene, poses: Mapping[str, PoseTrajectory], times: np.ndarray) -> tuple[Trace, Trace]:
    """A rollout by the fast search, and by the guarded one alone, which takes other ways to the ends of steps."""
    fast, guarded = (
        simulate(scene, poses, times, settings=replace(TIGHT, fast_iterations=n), keep_path=True) for n in (20, 0)
    )
    return fast, guarded


def check_halved_step(scene: Scene, poses: Mapping[str, PoseTrajectory], times: np.ndarray) -> None:
    """The first step that a search with few iterations halves ends where two steps of half the time end."""
    few = NewtonSettings(fast_iterations=1, max_iterations=4, step_tolerance_m=1e-12, force_tolerance=1e-10)
    trace = simulate(scene, poses, times, settings=few, keep_path=True)
    parts = [report.parts for report in trace.reports]
    k = next(k for k, n in enumerate(parts, 1) if n > 1)
    assert trace.path is not None and parts[k - 1] == 2
    frames = [{name: frame_of(*path.at(t)) for name, path in poses.items()} for t in times[: k + 1]]
    simulation = Simulation(scene, few)
    simulation.reset(frames[0])
    dt = float(times[1] - times[0])
    for there in frames[1:k]:
        simulation.step(there, dt)
    middle = {name: between(frames[k - 1][name], frames[k][name]) for name in poses}
    assert [simulation.step(there, 0.5 * dt).parts for there in (middle, frames[k])] == [1, 1]
    assert np.abs(simulation.state.x - trace.path.positions[k]).max() < 1e-11
