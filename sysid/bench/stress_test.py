"""Long random runs of rigs, to find steps that fail: every end effector wanders about its start, then all hold still.

A run of a rig follows from its seed and its number of steps alone, so whatever fails can be replayed by itself.
While nothing is driven, the total energy (kinetic, elastic, of contact and of weight) of a scene that is stepped by
implicit Euler may only fall: friction, plastic flow, damping and the integrator take energy out.

Within a step, with what the step holds constant (slip limits, memories), that is checked without any allowance but for
the tolerance on positions times the largest force: the energy that a step minimises contains what is dissipated. From
the first such step to the last, what friction springs hold is measured against a limit that follows the normal force
a step late, so a small rise is no fault (:data:`RISE`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.core.record import dead_loads
from sim_core.errors import ConfigError, ConvergenceError
from sim_core.rigs import Rig, load_rig
from sim_core.rigs.motion import Experiment, Random, compile_experiment
from sim_core.scene import build_scene
from sim_core.sensing.observe import frame_of
from sim_core.solve.report import NewtonSettings
from sim_core.solve.state import State
from sim_core.solve.step import potential
from sim_core.solve.system import System
from sim_core.stepping import Simulation

RUN_STEPS = 200
"""Steps of one run, at most."""

HELD = 0.25
"""Share of a run in which nothing is driven, at its end."""

REACH_M, TURN_DEG = 3e-3, 4.0
"""How far end effectors go from their start poses, along and about each axis."""

RISE = 1e-2
"""Rise of the energy that is no fault, as a share of what it has fallen by and of the kinetic energy, while held; on
top of the tolerance on positions times the largest force, a step."""

FEWEST_STEPS = 20


@dataclass(frozen=True)
class SoakRun:
    """One run. ``failure``: empty, or what went wrong, in step ``failed_step``; ``halvings``: of steps;
    ``rise_j``: largest rise of the energy while held still [J], of at most ``allowed_j``; ``step_rise_j``,
    ``step_allowed_j``: within one step."""

    rig: str
    seed: int
    asked: int
    steps: int
    unknowns: int
    failure: str
    failed_step: int
    halvings: int
    finite: bool
    smallest_gap_m: float
    most_iterations: int
    rise_j: float
    allowed_j: float
    step_rise_j: float
    step_allowed_j: float
    wall_s: float

    @property
    def replay(self) -> str:
        """Command that makes this run again."""
        return f"thinshell soak {self.rig} --steps {self.asked} --seed {self.seed}"


def random_experiment(rig: Rig, steps: int, seed: int) -> Experiment:
    """Wander with every end effector for ``steps`` steps of the rig."""
    duration = steps * rig.solver.dt_s
    spans = 6  # knot spans in a run
    speed = 1.001 * 2.0 * math.sqrt(3.0) * spans / duration
    motions = {
        name: (
            Random(
                type="random",
                duration_s=duration,
                bounds_m=(REACH_M,) * 3,
                bounds_deg=(TURN_DEG,) * 3,
                speed_m_s=speed * REACH_M,
                speed_deg_s=speed * TURN_DEG,
                seed=1000 * seed + index,
            ),
        )
        for index, name in enumerate(rig.end_effectors)
    }
    rate = min(max(1.0 / rig.solver.dt_s, 1.0), 1000.0)
    return Experiment(name="soak", duration_s=duration, command_rate_hz=rate, motions=motions)


@dataclass(frozen=True)
class StepEnergies:
    """Kinetic plus potential energy [J] at the start and at the end of a step in which nothing is driven, with the
    constants of that step; at the end with what it dissipates. ``kinetic``: of that at the end; ``force_n``: the
    largest on a node there."""

    start: float
    end: float
    kinetic: float
    force_n: float

    def tolerance(self, settings: NewtonSettings | None = None) -> float:
        """How well the step knows its energy [J]: the tolerance on positions times the largest force, and round-off."""
        length = (settings or NewtonSettings()).step_tolerance_m
        return length * self.force_n + 1e-12 * abs(self.end)


def kinetic_energy(system: System, state: State) -> float:
    """Of all nodes [J]."""
    return 0.5 * float(np.sum(state.v * (system.mass @ state.v)))


def step_energies(simulation: Simulation, before: State, dt: float) -> StepEnergies:
    """Of the last step, of ``dt`` [s], which began in the state ``before``."""
    scene, after = simulation.scene, simulation.state
    system, targets = scene.system, scene.targets(simulation.frames)
    start, end = (potential(system, before, x, targets, dt) for x in (before.x, after.x))
    kinetic = kinetic_energy(system, after)
    force = max(float(np.abs(found).max(initial=0.0)) for found in (end.gradient, dead_loads(system)))
    return StepEnergies(start.energy + kinetic_energy(system, before), end.energy + kinetic, kinetic, force)


def soak_run(simulation: Simulation, rig_name: str, steps: int, seed: int) -> SoakRun:
    """Make one run with a simulation at hand; it is reset first. Nothing is raised for a step that fails."""
    rig = simulation.scene.rig
    driven = round((1.0 - HELD) * steps)
    poses = compile_experiment(random_experiment(rig, driven, seed), rig)
    dt = rig.solver.dt_s
    failure, finite, gap, iterations, k = "", True, math.inf, 0, 0
    rise, fallen, kinetic_most, highest, lowest = 0.0, 0.0, 0.0, -math.inf, math.inf
    in_step, in_step_allowed, worst = -math.inf, 0.0, -math.inf
    force = 0.0
    begin = time.perf_counter()
    try:
        simulation.reset()
        for k in range(1, steps + 1):
            before, halvings = simulation.state, simulation.halvings
            report = simulation.step({name: frame_of(*pose.at(k * dt)) for name, pose in poses.items()}, dt)
            iterations = max(iterations, report.iterations)
            gap = min(gap, report.min_gap_m)
            if not np.isfinite(simulation.state.x).all():
                failure, finite = "positions are not finite.", False
                break
            if k > driven and rig.solver.integrator == "implicit_euler":
                energies = step_energies(simulation, before, dt)
                total, force = energies.end, energies.force_n
                highest, lowest = max(highest, total), min(lowest, total)
                rise, fallen = max(rise, total - lowest), max(fallen, highest - total)
                kinetic_most = max(kinetic_most, energies.kinetic)
                if simulation.halvings == halvings:
                    made, bound = energies.end - energies.start, energies.tolerance()
                    if made - bound > worst:
                        worst, in_step, in_step_allowed = made - bound, made, bound
    except ConvergenceError as error:
        failure = str(error)
    inexact = (steps - driven) * NewtonSettings().step_tolerance_m * force
    allowed = RISE * (fallen + kinetic_most) + inexact
    if not failure and rise > allowed:
        failure = f"the energy rises by {rise:.3g} J while nothing is driven, more than {allowed:.3g} J."
    if not failure and worst > 0.0:
        failure = (
            f"the energy rises by {in_step:.3g} J within a step while nothing is driven, more than "
            f"{in_step_allowed:.3g} J."
        )
    if not failure and not gap > 0.0:
        failure = f"a gap is {gap:.3g} m."
    return SoakRun(
        rig=rig_name,
        seed=seed,
        asked=steps,
        steps=k - bool(failure),
        unknowns=simulation.scene.system.n_unknowns,
        failure=failure,
        failed_step=k if failure else 0,
        halvings=simulation.halvings,
        finite=finite,
        smallest_gap_m=gap,
        most_iterations=iterations,
        rise_j=rise,
        allowed_j=allowed,
        step_rise_j=max(in_step, 0.0),
        step_allowed_j=in_step_allowed,
        wall_s=time.perf_counter() - begin,
    )


def run_lines(runs: Sequence[SoakRun]) -> list[str]:
    """One line a rig, and the sum."""
    lines = [
        f"{'rig':<34}{'unknowns':>9}{'runs':>6}{'steps':>8}{'failed':>8}{'halved':>8}{'NaN':>5}{'gap um':>8}"
        f"{'most its':>10}{'rise J':>10}{'in step J':>11}{'steps/s':>9}"
    ]
    names = list(dict.fromkeys(r.rig for r in runs))
    for name, mine in [*((n, [r for r in runs if r.rig == n]) for n in names), ("all", list(runs))]:
        gap = min(r.smallest_gap_m for r in mine)
        lines.append(
            f"{name:<34}{max(r.unknowns for r in mine):>9}{len(mine):>6}{sum(r.steps for r in mine):>8}"
            f"{sum(bool(r.failure) for r in mine):>8}{sum(r.halvings for r in mine):>8}"
            f"{sum(not r.finite for r in mine):>5}{1e6 * gap if math.isfinite(gap) else math.nan:>8.2f}"
            f"{max(r.most_iterations for r in mine):>10}{max(r.rise_j for r in mine):>10.1e}"
            f"{max(r.step_rise_j for r in mine):>11.1e}"
            f"{sum(r.steps for r in mine) / sum(r.wall_s for r in mine):>9.1f}"
        )
    return lines


def failure_lines(runs: Sequence[SoakRun]) -> list[str]:
    """What failed, and how to see it again."""
    return [
        f"{r.rig}, step {r.failed_step} of {r.asked}, seed {r.seed}: {r.failure} Replay: {r.replay}"
        for r in runs
        if r.failure
    ]


def soak(
    rigs: Sequence[str], steps: int, seed: int, on_run: Callable[[float, SoakRun], None] | None = None
) -> Iterator[SoakRun]:
    """Spread ``steps`` over the rigs, in runs with the seeds ``seed``, ``seed + 1``, ...

    ``on_run``: called after each run with the share of the work that is done.
    """
    if not rigs:
        raise ConfigError("There is no rig to run.", "Name one.")
    each = steps // len(rigs)
    if each < FEWEST_STEPS:
        raise ConfigError(
            f"{steps} steps for {len(rigs)} rigs are fewer than {FEWEST_STEPS} for each.",
            f"Ask for at least {FEWEST_STEPS * len(rigs)} steps, or name fewer rigs.",
        )
    runs = math.ceil(each / RUN_STEPS)
    length = math.ceil(each / runs)
    for index, name in enumerate(rigs):
        simulation = Simulation(build_scene(load_rig(name)))
        for r in range(runs):
            found = soak_run(simulation, name, length, seed + r)
            if on_run is not None:
                on_run((index * runs + r + 1) / (len(rigs) * runs), found)
            yield found
