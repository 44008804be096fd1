"""Run a scene of ``config`` and look at it from outside: positions of everything, after every step."""

import itertools
from dataclasses import dataclass, field

import numpy as np
from crossing import crossings, edges_of

from sim_core.rigs import load_rig
from sim_core.rigs.motion import compile_experiment, load_experiment
from sim_core.scene import build_scene
from sim_core.scene.assembly import contact_triangles
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation, step_times
from sim_core.solve.state import State
from sim_core.solve.step import potential
from sim_core.solve.system import System

G = 9.81


@dataclass
class Run:
    """``times`` [s] ``(n + 1,)``; ``x``, ``v``: positions [m] and velocities [m/s] of all nodes at them;
    ``reports``: one a step; ``readings``: of every channel, at ``times``."""

    simulation: Simulation
    times: np.ndarray
    x: list[np.ndarray] = field(default_factory=list)
    v: list[np.ndarray] = field(default_factory=list)
    reports: list = field(default_factory=list)
    readings: list[dict] = field(default_factory=list)

    @property
    def scene(self):
        return self.simulation.scene

    def nodes(self, body):
        return self.scene.bodies[body].nodes

    def path(self, body):
        """Mean position of a body's nodes [m], ``(n + 1, 3)`` (of an affine body: its centre)."""
        nodes = self.control(body) if self.scene.bodies[body].spec.type == "affine" else self.nodes(body)
        return np.array([x[nodes].mean(axis=0) for x in self.x])

    def speed(self, body):
        """Velocity of the centre of an affine body [m/s], ``(n + 1, 3)``."""
        return np.array([v[self.control(body)].mean(axis=0) for v in self.v])

    def control(self, body):
        return self.scene.bodies[body].control

    def force(self, channel):
        """Forces of a wrench in its sensor's frame [N], ``(n + 1, 3)``."""
        return np.array([r[channel][:3] for r in self.readings])

    def energy(self, step):
        """Kinetic energy, and elastic and gravitational energy [J], after a step, of a scene without contact there."""
        system = self.scene.system
        mass = system.mass
        kinetic = 0.5 * float(np.sum(self.v[step] * (mass @ self.v[step])))
        weight = -float(np.sum((mass @ self.x[step]) @ system.gravity))
        terms = [term for term in system.terms if not term.name.startswith("contact.")]
        free = System(
            system.nodes, mass, system.prescribed, terms, np.zeros(3), inertia=False, embedding=system.embedding
        )
        still = State(0.0, self.x[step], np.zeros_like(self.x[step]), free.initial_internals())
        return kinetic, weight + potential(free, still).energy


def run(rig_name, experiment, effects=None):
    """Simulate it all. Every step converges, or in parts, or raises."""
    rig = load_rig(rig_name)
    if effects is not None:
        rig = rig.model_copy(update={"effects": effects})
    plan = load_experiment(experiment)
    poses = compile_experiment(plan, rig)
    end = max([plan.duration_s or 0.0, *(p.times[-1] for p in poses.values())])
    times = step_times(0.0, end, rig.solver.dt_s)
    simulation = Simulation(build_scene(rig))
    found = Run(simulation, times)

    def keep():
        found.x.append(simulation.state.x.copy())
        found.v.append(simulation.state.v.copy())
        found.readings.append(simulation.read())

    keep()
    for before, now in itertools.pairwise(times):
        frames = {name: frame_of(*pose.at(now)) for name, pose in poses.items()}
        found.reports.append(simulation.step(frames, now - before))
        keep()
    assert all(r.converged for r in found.reports)
    assert min(r.min_gap_m for r in found.reports) > 0.0
    nothing_crosses(found)
    return found


def nothing_crosses(found, instants=4):
    """No edge of a body goes through a face of one that it may touch, at some instants and at the end."""
    scene = found.scene
    soft = {n: contact_triangles(b) for n, b in scene.bodies.items() if b.mesh is not None}
    for k in np.linspace(0, len(found.x) - 1, instants + 1).astype(int)[1:]:
        x = found.x[k]
        for contact in scene.rig.contacts:
            one, other = contact.between
            if one in soft and other in soft:
                assert crossings(x, edges_of(soft[one]), soft[other]) == 0
                assert crossings(x, edges_of(soft[other]), soft[one]) == 0
