"""Soak runs: repeatable, honest about what fails, and their energy check can fail."""

import dataclasses
import json

import numpy as np
import pytest

from sim_core.errors import ConfigError, ConvergenceError
from sim_core.rigs import load_rig
from sim_core.rigs.motion import compile_experiment
from sim_core.scene import build_scene
from sim_core.solve.step import potential
from sim_core.stepping import Simulation
from sysid.bench import stress_test as library
from sysid.cli import app

STEPS = 40


@pytest.fixture(scope="module")
def simulation():
    return Simulation(build_scene(load_rig("card_press")))


def without_time(run):
    return dataclasses.replace(run, wall_s=0.0)


def test_a_run_is_the_same_for_a_seed_whatever_was_run_before(simulation):
    one, other, again = (library.soak_run(simulation, "card_press", STEPS, seed) for seed in (3, 4, 3))
    assert without_time(one) == without_time(again)
    assert one.smallest_gap_m != other.smallest_gap_m
    assert one.failure == "" and one.steps == STEPS and one.finite


def test_hands_move_and_then_hold_still():
    rig = load_rig("balancing")
    poses = compile_experiment(library.random_experiment(rig, 30, 2), rig)
    times = np.arange(STEPS + 1) * rig.solver.dt_s
    paths = [p.sample(times)[0] for p in poses.values()]
    for k, path in enumerate(paths):
        assert np.ptp(path[:30], axis=0).min() > 1e-4
        assert np.ptp(path[30:], axis=0).max() == 0.0
        assert all(np.abs(path - path[0] - (q - q[0])).max() > 1e-4 for q in paths[k + 1 :])


def test_energy_is_that_of_a_thrown_body():
    """m v^2 / 2 + m g z, to rounding."""
    rig = load_rig("bouncing")
    simulation = Simulation(build_scene(rig))
    system, first = simulation.scene.system, simulation.state
    for _ in range(3):
        before = simulation.state
        simulation.step({}, 2e-3)
    found = library.step_energies(simulation, before, 2e-3)
    lost = potential(system, first).energy + library.kinetic_energy(system, first) - (found.end - found.kinetic)
    mass = 0.06 * 0.06 * 0.08
    sheet = simulation.scene.bodies["sheet"].nodes
    fallen = mass * 9.81 * float(np.mean((simulation.scene.rest - simulation.state.x)[sheet, 2]))
    assert found.kinetic == pytest.approx(0.5 * mass * float(np.mean(simulation.state.v[sheet, 2] ** 2)), rel=1e-6)
    assert lost == pytest.approx(fallen, rel=1e-6)


def test_energy_that_rises_is_a_failure_with_a_replay(simulation, monkeypatch):
    plain, calls = library.step_energies, []

    def leaking(*given):
        calls.append(1)
        found = plain(*given)
        return dataclasses.replace(found, end=found.end + 1e-5 * len(calls), start=found.start + 1e-5 * len(calls))

    monkeypatch.setattr(library, "step_energies", leaking)
    run = library.soak_run(simulation, "card_press", STEPS, 3)
    assert "energy rises" in run.failure
    assert run.replay == "thinshell soak card_press --steps 40 --seed 3"
    line = library.failure_lines([run])[0]
    assert "card_press, step 40 of 40, seed 3" in line and run.replay in line


def test_a_step_that_fails_is_counted_and_ends_with_code_1(monkeypatch, capsys):
    plain, steps = Simulation.step, []

    def failing(self, frames, dt):
        steps.append(1)
        if len(steps) == 7:
            raise ConvergenceError("It does not converge.", "Mend it.")
        return plain(self, frames, dt)

    monkeypatch.setattr(Simulation, "step", failing)
    assert app.main(["soak", "card_press", "--steps", "40", "--seed", "3"]) == 1
    done = capsys.readouterr()
    assert "card_press, step 7 of 40, seed 3: It does not converge." in done.err
    assert "Replay: thinshell soak card_press --steps 40 --seed 3" in done.err
    row = next(line for line in done.out.splitlines() if line.startswith("card_press")).split()
    assert row[2:5] == ["1", "6", "1"]  # runs, steps, failed


def test_json_has_every_run(capsys):
    assert app.main(["soak", "card_press", "--steps", "240", "--json"]) == 0
    runs = json.loads(capsys.readouterr().out)
    assert [(r["rig"], r["seed"], r["asked"], r["steps"]) for r in runs] == [
        ("card_press", s, 120, 120) for s in (0, 1)
    ]


def test_too_few_steps_are_refused():
    with pytest.raises(ConfigError, match="at least 40"):
        list(library.soak(["card_press", "forming"], 30, 0))
