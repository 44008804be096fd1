"""One step of a scene that is full of contact, and differences of what single terms do in it."""

from __future__ import annotations

from dataclasses import replace

from sim_core.energies.linearised import flatten, unflatten
from sim_core.scene import build_scene
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation
from sim_core.solve.integrator import step_context


def last_step(rig, poses, times):
    """Simulation after the last step, the state before it and the constants of the step; the system holds its end."""
    simulation = Simulation(build_scene(rig))
    tracks = {name: p.sample(times) for name, p in poses.items()}
    frames = [{n: frame_of(p[k], q[k]) for n, (p, q) in tracks.items()} for k in range(len(times))]
    simulation.reset(frames[0])
    before = simulation.state
    for k in range(1, len(times)):
        before = simulation.state
        report = simulation._advance({**simulation.frames, **frames[k]}, times[k] - times[k - 1])
        assert report.converged
    return simulation, before, step_context(before.x, before.v, times[-1] - times[-2], before.past)


def respond(simulation, term, step, memory, x_start, x_end, past):
    """Force and new memory of a term, flattened, for a neighbouring start, memory and end of the step, and a
    neighbouring state before it."""
    system = simulation.scene.system
    kept = system.x.copy()
    term.begin_step(step_context(x_start, step.v_start, step.dt, past), memory)
    system.x[:] = x_end
    system._gradient[:] = 0.0
    term.add_gradient()
    out = system._gradient.ravel().copy(), flatten(term.end_step(step, memory))
    system.x[:] = kept
    term.begin_step(step, memory)
    return out


def differences(simulation, term, step, internals, along, h, past=None):
    """Central differences of force and memory along (start, memory, end, and the state before); ``past``: it."""
    x = simulation.scene.system.x.copy()
    flat = flatten(internals)
    start, memory, end, before = along
    out = []
    for s in (h, -h):
        out.append(
            respond(
                simulation, term, step, unflatten(flat + s * memory, internals),
                step.x_start + s * start.reshape(-1, 3), x + s * end.reshape(-1, 3),
                None if past is None else replace(past, x=past.x + s * before.reshape(-1, 3)),
            )
        )  # fmt: skip
    return [(a - b) / (2.0 * h) for a, b in zip(*out, strict=True)]
