"""Small scenes with affine bodies, and what is read off them."""

import numpy as np

from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation

G = 9.81
DENSITY = 1000.0


def affine(shape, position=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0), density=DENSITY, **more):
    """An affine body for a rig; ``shape``: sizes of a box, or a radius, or a radius and a length."""
    if np.ndim(shape) == 0:
        given = {"type": "sphere", "radius_m": float(shape)}
    elif len(shape) == 2:
        given = {"type": "cylinder", "radius_m": float(shape[0]), "length_m": float(shape[1])}
    else:
        given = {"type": "box", "size_m": [float(s) for s in shape]}
    pose = {"position_m": [float(p) for p in position], "rpy_deg": [float(a) for a in rpy]}
    return {"type": "affine", "shape": given, "pose": pose, "material": {"density_kg_m3": density}, **more}


def plane(rpy=(0.0, 0.0, 0.0), position=(0.0, 0.0, 0.0)):
    pose = {"position_m": [float(p) for p in position], "rpy_deg": [float(a) for a in rpy]}
    return {"type": "rigid", "shape": {"type": "plane"}, "pose": pose}


def gel(size, cells, position, e_pa=2e5, **more):
    return {
        "type": "gel",
        "shape": {"type": "block", "size_m": list(size), "cells": list(cells)},
        "pose": {"position_m": list(position)},
        "material": {"E_pa": e_pa, "nu": 0.4, "density_kg_m3": 1000.0},
        **more,
    }


def rig_of(bodies, dt=0.005, integrator="implicit_euler", gravity=(0.0, 0.0, -G), **more):
    return parse_rig(
        {
            "name": "bodies",
            "gravity_m_s2": [float(g) for g in gravity],
            "solver": {"dt_s": dt, "integrator": integrator},
            "bodies": bodies,
            **more,
        },
        "test",
    )


def simulation(bodies, dt=0.005, integrator="implicit_euler", gravity=(0.0, 0.0, -G), settings=None, **more):
    return Simulation(build_scene(rig_of(bodies, dt, integrator, gravity, **more)), settings)


def run(sim, steps, each=None):
    """Step without any motion of mounts; what ``each(sim)`` gives after every step."""
    out = []
    for _ in range(steps):
        sim.step({}, sim.scene.rig.solver.dt_s)
        if each is not None:
            out.append(each(sim))
    return np.array(out)


def centre(sim, name):
    return sim.scene.pose_of(name, sim.state.x)[0]


def velocity(sim, name):
    return sim.state.v[sim.scene.bodies[name].control].mean(axis=0)


def momenta(sim):
    """Momentum [kg m/s] and angular momentum about the origin [kg m^2/s] of all that is simulated."""
    p = sim.scene.system.mass @ sim.state.v
    return p.sum(axis=0), np.cross(sim.state.x, p).sum(axis=0)


def kinetic(sim):
    return 0.5 * float(np.sum(sim.state.v * (sim.scene.system.mass @ sim.state.v)))


def potential(sim):
    """In gravity [J]."""
    return -float(np.sum((sim.scene.system.mass @ sim.state.x) @ sim.scene.system.gravity))


def stretch(sim):
    """Largest principal strain of any affine body."""
    worst = 0.0
    for body in sim.scene.bodies.values():
        if body.spec.type == "affine":
            rest, now = (x[1:] - x[0] for x in (body.rest[-4:], sim.state.x[body.control]))
            a = np.linalg.solve(rest, now)
            worst = max(worst, np.abs(np.linalg.svd(a, compute_uv=False) - 1.0).max())
    return worst
