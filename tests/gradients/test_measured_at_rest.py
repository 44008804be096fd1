"""What is measured on shapes at rest, term by term, against differences: the curvature operator, and what contacts
exert and remember."""

from __future__ import annotations

import numpy as np
import pytest
from test_rest_shape import shake, shapes_of

from sim_core.contact.edges import EdgeContact
from sim_core.energies.curvature import curvature_operator
from sim_core.energies.curvature_rest import CurvatureRest
from sim_core.energies.linearised import flatten, times_back
from sim_core.energies.membrane import material_frames
from sim_core.errors import ConfigError
from sim_core.geometry.sheets import SheetMesh, find_hinges, rectangle
from sim_core.gradients.parameter_jacobian import moment_on_body
from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.solve.integrator import step_context


@pytest.mark.parametrize("pattern", ["regular", "crossed", "irregular"])
def test_curvature_operator_against_its_differences(pattern):
    """Of a crumpled sheet of which a part is held, in axes that are oblique."""
    rng = np.random.default_rng(0)
    mesh = rectangle(0.08, 0.04, (6, 4), pattern)
    x, triangles = mesh.nodes + 4e-4 * rng.standard_normal(mesh.nodes.shape), mesh.triangles
    hinges = find_hinges(triangles)
    rigid = (mesh.nodes[:, 0] < -0.02)[triangles].all(axis=1)
    axes = np.broadcast_to([0.8, 0.6, 0.1], (len(triangles), 3))

    def operator(x):
        frames, areas = material_frames(x, triangles, axes), SheetMesh(x, triangles).areas
        return curvature_operator(x, triangles, hinges, frames, areas, rigid)

    rest = CurvatureRest(x, triangles, hinges, axes, rigid)
    given = rng.standard_normal((rest.pairs.shape[1], 3))
    where, of = (3 * rest.pairs[0][:, None] + np.arange(3)).ravel(), np.repeat(rest.pairs[1], 3)
    inside = np.zeros(operator(x).shape, dtype=bool)
    inside[where, of] = True
    assert 0 < rigid.sum() < len(rigid) and not np.any(operator(x).toarray()[~inside])
    found = rest.back(given)
    for along in (rng.standard_normal(x.shape), *np.eye(x.size)[[40, -20]].reshape(2, *x.shape)):
        ends = [np.asarray(operator(x + s * along)[where, of]).ravel() @ given.ravel() for s in (1e-8, -1e-8)]
        scale = np.abs(found).max() * np.linalg.norm(along)
        assert abs((ends[0] - ends[1]) / 2e-8 - np.vdot(found, along)) < 1e-6 * scale


def cards():
    """Two cards 10 um apart, beside the gap of 27 um that contact counts from before it; their edges are parallel but
    for half a degree."""
    shape = {"type": "rectangle", "length_m": 0.03, "width_m": 0.02, "cells": [3, 2]}
    material = {"E_pa": 2.0e9, "nu": 0.3, "thickness_m": 2.0e-4, "density_kg_m3": 700.0}
    pose = {"position_m": [1e-3, 4e-5, 2.1e-4 - 2.7e-5], "rpy_deg": [0.0, 0.0, 0.5]}
    plate = {"position_m": [2e-3, 1e-3, -1.1e-4 + 2.7e-5 - 0.01]}
    return parse_rig(
        {
            "name": "cards",
            "solver": {"dt_s": 0.01},
            "bodies": {
                "low": {"type": "sheet", "shape": shape, "material": material},
                "high": {"type": "sheet", "shape": shape, "material": material, "pose": pose},
                "plate": {"type": "rigid", "shape": {"type": "box", "size_m": [0.013, 0.009, 0.02]}, "pose": plate},
            },
            "contacts": [
                {"between": ["low", "high"], "friction": 0.4},
                {"between": ["low", "plate"], "friction": 0.4},
            ],
        },
        "cards",
    )


def test_every_contact_against_differences_of_what_it_exerts_and_remembers():
    """By the shape at rest alone, positions and memory given; some points slide, and some edges are nearly parallel."""
    scene, rng = build_scene(cards()), np.random.default_rng(3)
    shake(scene, 1e-6)
    rest, names = scene.rest.copy(), shapes_of(scene)
    at = {name: scene.bodies[name.split(".")[0]].nodes for name in names}
    start = rest + 1e-6 * rng.standard_normal(rest.shape)
    end = start + [2e-5, 1e-5, 0.0] * np.linspace(-1.0, 1.0, len(rest))[:, None] ** 3
    step = step_context(start, np.zeros_like(start), 0.01)

    def respond(internals, to):
        """Forces, moments on rigid bodies, and memory of all contacts after a step to positions ``to``."""
        system = scene.system
        system.forget()
        system.x[:] = start
        system.begin_step(step, internals)
        system.x[:] = to
        terms = {t.name: t for t in system.terms if hasattr(t, "measures")}
        forces = {name: system.gradient_of(t) for name, t in terms.items()}
        moments = {name: moment_on_body(t) for name, t in terms.items()}
        return terms, forces, moments, system.end_step(step, internals)

    internals = respond(scene.system.initial_internals(), start)[-1]
    terms, forces, moments, after = respond(internals, end)
    wave, exerted = rng.standard_normal((2, *rest.shape))
    turning = 1e3 * rng.standard_normal(3)
    kept = {name: rng.standard_normal(sum(a.size for a in after[name].values())) for name in terms}
    found, faded, slid = {}, 0, 0
    for name, term in terms.items():
        known = term.linearise(step, internals[name], after[name])
        slid += np.count_nonzero(after[name]["slip_speed"])
        if not term.measures or not np.any(forces[name]):
            continue
        weights = times_back(known.force_rest, exerted.ravel()) + times_back(known.memory_rest, kept[name])
        weights, first, found[name] = weights + times_back(known.moment_rest, turning), 0, 0.0
        for measure in term.measures:
            found[name] += np.vdot(measure.back(rest, weights[first : first + measure.count]), wave)
            first += measure.count
        if isinstance(term, EdgeContact):
            fades = term._now.fade[: term._count[0], 0][term._load[: term._count[0]] > 0.0]
            faded += np.count_nonzero((fades > 0.0) & (fades < 1.0))
    assert faded > 0 and slid > 5 and np.abs(moments["contact.low-plate"]).max() > 1e-3
    assert set(found) >= {f"contact.low-{n}" for n in ("high.0", "high.1", "high.edges", "plate", "plate.core0.edges")}

    def products(h):
        for name in names:
            scene.fields[name] = (rest + h * wave)[at[name]]
        changed, pushed, turned, memory = respond(internals, end)
        for name in found:
            if hasattr(changed[name], "aligned"):
                memory[name] = changed[name].aligned(memory[name], after[name])
        remembered = {name: flatten(memory[name]) @ kept[name] + turned[name] @ turning for name in found}
        return {name: np.vdot(pushed[name], exerted) + remembered[name] for name in found}

    high, low = products(1e-8), products(-1e-8)
    for name, expected in found.items():
        assert (high[name] - low[name]) / 2e-8 == pytest.approx(expected, rel=1e-6), name


def test_a_strip_of_one_cell_has_no_derivative_of_its_bending():
    """Its hinges leave one component of the curvature open; a node that moves makes it appear."""
    mesh = rectangle(0.08, 0.01, (6, 1), "regular")
    axes = np.broadcast_to([1.0, 0.0, 0.0], (len(mesh.triangles), 3))
    with pytest.raises(ConfigError, match="two cells in each direction"):
        rigid = np.zeros(len(mesh.triangles), dtype=bool)
        CurvatureRest(mesh.nodes, mesh.triangles, find_hinges(mesh.triangles), axes, rigid)
