"""Derivatives of single terms in a step against central differences of the terms themselves."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from step_differences import differences, last_step, respond

from sim_core.energies.linearised import flatten, times
from sim_core.gradients.parameter_jacobian import Columns
from sim_core.rigs import load_rig, parse_rig, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory

EFFECTS = {
    "gel_relaxation": {"share": 0.3, "tau_s": 0.1},
    "bending_plasticity": {"yield_curvature_per_m": 0.5, "hardening_ratio": 0.3},
    "air_drag": {"drag_coefficient": 1.2},
    "static_friction": {"excess": 0.5},
}
PRESS = ([0.0, 0.1, 0.3, 0.6], [[0, 0, 0], [0, 0, 0], [0, 0, -0.008], [0.004, 0.002, -0.008]])
RUB = ([0.0, 0.1, 0.2, 0.4], [[0, 0, 0], [0.054, 0, 0], [0.055, 0, -0.0009], [0.0562, 0.001, -0.0009]])


def small(small_rig, visit, path, end):
    return small_rig(effects=EFFECTS), visit(*path), np.linspace(0.0, end, round(end / 0.02) + 1)


def damped(integrator, small_rig, visit):
    """Both kinds of damping beside plastic flow and relaxation, in motion."""
    rig = small_rig(effects=EFFECTS, solver={"dt_s": 0.02, "integrator": integrator})
    for body, alpha, beta in (("card", 3.0, 5e-3), ("gel", 2.0, 0.02)):
        given = {f"{body}.mass_damping_per_s": alpha, f"{body}.stiffness_damping_s": beta}
        rig = with_parameters(rig, given)
    return rig, visit(*PRESS), np.linspace(0.0, 0.26, 14)


def forming():
    """A round gel presses a card on a table and draws it: points and faces both ways, edges, a plane."""
    rig = load_rig("forming").model_copy(update={"effects": {"static_friction": {"excess": 0.5}}})
    start = rig.end_effectors["finger"].start.position()
    path = start + np.array([[0, 0, 0], [0, 0, -6.5e-3], [1e-2, 0, -6.5e-3]])
    poses = {"finger": PoseTrajectory(np.array([0.0, 0.15, 0.30]), path, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)))}
    return rig, poses, np.linspace(0.0, 0.165, 34)


def ball():
    """A ball on an arm rolls over a card: its normal turns with the place, and its frame with the arm."""
    sheet = {"type": "rectangle", "length_m": 0.06, "width_m": 0.06, "cells": [8, 8], "pattern": "crossed"}
    rig = parse_rig(
        {
            "name": "ball",
            "solver": {"dt_s": 0.005},
            "bodies": {
                "card": {
                    "type": "sheet", "shape": sheet, "pose": {"position_m": [0.0, 0.0, -0.002]},
                    "material": {"preset": "card_200gsm"},
                },
                "ball": {"type": "rigid", "shape": {"type": "sphere", "radius_m": 0.02}, "mount": "arm"},
            },
            "clamps": [{"body": "card", "region": {"x_m": [-0.03, -0.02]}}],
            "end_effectors": {"arm": {"start": {"position_m": [0.01, 0.0, 0.0184], "rpy_deg": [0.0, 0.0, 60.0]}}},
            "contacts": [{"between": ["card", "ball"], "friction": 0.3}],
            "sensors": {"wrench": {"type": "wrench", "on": "arm"}},
        },
        "ball",
    )  # fmt: skip
    path = np.array([[0.01, 0.0, 0.0184], [0.01, 0.0, 0.0152], [0.012, 0.001, 0.0152]])
    turned = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0], [0.03, 0.05, 0.02, 0.998]])
    turned = (Rotation.from_quat(turned) * Rotation.from_euler("z", 60.0, degrees=True)).as_quat()
    return rig, {"arm": PoseTrajectory(np.array([0.0, 0.05, 0.1]), path, turned)}, np.linspace(0.0, 0.07, 15)


def laid(small_rig, friction, **changes):
    """A card that is held at one end and has settled on a post; ``friction``: of both, and the contact's stiffness."""
    rig = small_rig(**changes)
    given = rig.model_dump(mode="json", exclude_none=True)
    given["bodies"]["post"]["pose"]["position_m"] = [0.04, 0.0, 0.0297]
    given["contacts"] = [{"between": ["card", "post"], **friction}]
    return parse_rig(given, "laid")


SCENES = {
    "press": lambda *given: small(*given, PRESS, 0.26),
    "drag": lambda *given: small(*given, PRESS, 0.5),
    "rub": lambda *given: small(*given, RUB, 0.3),
    "forming": lambda *given: forming(),
    "ball": lambda *given: ball(),
    "damped": lambda *given: damped("implicit_euler", *given),
    "damped, looking back": lambda *given: damped("bdf2", *given),
}
DAMPED = {"card.membrane", "card.bending", "card.mass_damping", "gel.elastic", "gel.mass_damping"}
EXPECTED = {
    "press": {"card.bending", "gel.elastic", "contact.gel-card.0", "card.air_drag"},
    "drag": {"contact.gel-card.0"},
    "rub": {"gel.elastic", "contact.gel-post"},
    "forming": {"contact.gel-card.0", "contact.gel-card.edges", "contact.card-table"},
    "ball": {"contact.card-ball"},
    "damped": DAMPED,
    "damped, looking back": DAMPED,
}
"""Terms that must be at work in a scene, lest the comparison be of zeros."""


@pytest.mark.parametrize("scene", SCENES)
def test_every_term(scene, small_rig, visit):
    simulation, before, step = last_step(*SCENES[scene](small_rig, visit))
    system, rng = simulation.scene.system, np.random.default_rng(1)
    at_work = set()
    for term in system.terms:
        internals, after = before.internals[term.name], simulation.state.internals[term.name]
        found = term.linearise(step, internals, after) if hasattr(term, "linearise") else None
        if found is None:
            continue
        size, memory = system.x.size, flatten(internals)
        scales = [np.full(a.size, 0.0 if n == "pair" else np.abs(a).max(initial=0.0)) for n, a in internals.items()]
        remembered = rng.standard_normal(len(memory)) * np.concatenate([np.empty(0), *scales]) * (memory != 0.0)
        moved, still, nothing = rng.standard_normal(size), np.zeros(size), np.zeros(len(memory))
        waves = {
            "start": ((moved, nothing, still, still), moved, 1e-10),
            "memory": ((still, remembered, still, still), remembered, 1e-7),
            "end": ((still, nothing, moved, still), moved, 1e-10),
            "past": ((still, nothing, still, moved), moved, 1e-10),
        }
        for name, (along, vector, h) in waves.items():
            by_step = [differences(simulation, term, step, internals, along, k * h, before.past) for k in (1.0, 0.1)]
            for what, references in zip(("force", "memory"), zip(*by_step, strict=True), strict=True):
                if (what, name) in (("force", "end"), ("memory", "past")):
                    continue  # the Hessian; and what nothing looks back for
                ours = times(getattr(found, f"{what}_{name}"), vector) + np.zeros(len(references[0]))
                for part in parts(after) if what == "memory" else [slice(None)]:
                    scale = np.abs(references[0][part]).max(initial=0.0)
                    if scale > 1e-9:
                        at_work.add(term.name)
                        error = min(np.abs(ours - reference)[part].max() for reference in references)
                        assert error < 5e-6 * scale, (term.name, what, name, part)
    assert at_work >= EXPECTED[scene]


def parts(internals):
    """Where each internal variable is in the flattened vector."""
    ends = np.cumsum([0, *(a.size for a in internals.values())])
    return [slice(a, b) for a, b in pairwise(ends)]


@pytest.mark.parametrize(
    ("scene", "names"),
    [
        (forming, ("contact.gel-card.0", "contact.gel-card.edges", "contact.card-table")),
        (ball, ("contact.card-ball",)),
    ],
    ids=["forming", "ball"],
)
def test_friction_holds_as_before_where_its_springs_are_stretched_by_a_move_of_the_start(scene, names):
    """Also on a body that stands turned."""
    simulation, before, step = last_step(*scene())
    rng = np.random.default_rng(3)
    for name in names:
        term = next(t for t in simulation.scene.system.terms if t.name == name)
        internals = before.internals[name]
        move = 1e-6 * rng.standard_normal(step.x_start.shape)
        carried = term.carried(internals, move)
        (force, memory), (slid, moved), (held, kept) = (
            respond(simulation, term, step, given, step.x_start + away, simulation.scene.system.x, None)
            for given, away in ((internals, 0.0 * move), (internals, move), (carried, move))
        )
        lost = np.abs(slid - force).max()
        assert lost > 1e-5 and np.abs(held - force).max() < 0.02 * lost, name
        anchor = parts(simulation.state.internals[name])[list(internals).index("anchor")]
        assert np.abs(kept - memory)[anchor].max() < 0.02 * np.abs(moved - memory)[anchor].max(), name


def test_distance_without_gap_range_and_stiffness_of_every_contact():
    """What contacts say of themselves against central differences of their forces, memory and moments."""
    simulation, before, step = last_step(*forming())
    scene, after = simulation.scene, simulation.state.internals
    columns, compared = Columns(scene, scene.values(scene.rig), []), set()
    for term in scene.system.terms:
        if not term.name.startswith("contact."):
            continue
        own = term.linearise(step, before.internals[term.name], after[term.name]).numbers
        for number in ("offset_m", "range_m", "stiffness_pa_per_m"):
            column = columns._of_term(term, number, step, before.internals[term.name], after[term.name])
            force, memory, moment = (
                column.force.ravel(),
                column.memory[term.name],
                column.moment.get(term.name, np.zeros(3)),
            )
            if not own:  # points of a sheet against a gel, which do not bear here
                assert not force.any() and not memory.any() and not moment.any()
                continue
            found = own[number]
            for reference, ours in ((force, found.force), (memory, found.memory), (moment, found.moment)):
                scale = np.abs(reference).max()
                assert np.abs(ours - reference).max() <= 1e-8 * scale
                compared |= {term.name} if scale > 0.0 else set()
    assert compared == EXPECTED["forming"]
