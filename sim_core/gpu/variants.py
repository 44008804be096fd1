"""Variants of a rig as one problem for a device."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sim_core.batch import Variant, poses_of_each
from sim_core.contact.rigid import RigidContact
from sim_core.core.covers import covers as core_covers
from sim_core.core.mounts import mount_places
from sim_core.core.record import record_values
from sim_core.core.record_layout import ARRAYS
from sim_core.core.slopes import NumberSlopes
from sim_core.energies.bending import Bending
from sim_core.energies.mass_damping import MassDamping
from sim_core.energies.membrane import Membrane
from sim_core.errors import ConfigError
from sim_core.gpu.plan import plan_of
from sim_core.gpu.problem import OWN, Problem
from sim_core.rigs import Rig, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import Scene, build_scene
from sim_core.scene.carriage import start_state
from sim_core.solve.report import NewtonSettings


def covers(scene: Scene) -> str | None:
    """Why rollouts of a scene are not for a device, in a sentence; None where they are."""
    lack = core_covers(scene)
    if lack is not None:
        return lack
    for term in scene.system.terms:
        if type(term) not in (Membrane, Bending, MassDamping, RigidContact):
            return f"A device has no elements for {term.name} ({type(term).__name__})."
        if isinstance(term, Bending) and term.initial_internals():
            return f"A device has no plastic flow, which {term.name} has."
        if isinstance(term, RigidContact) and term.laws.formulas:
            return f"A device has no laws that effects add to contacts, as to {term.name}."
    if not scene.all_held:
        return "A device has no bodies that nothing holds."
    return None


def problem_of(
    rig: Rig,
    variants: Sequence[Variant],
    poses: Mapping[str, PoseTrajectory] | Sequence[Mapping[str, PoseTrajectory]],
    times: np.ndarray,
    settings: NewtonSettings | None = None,
    on_variant: Callable[[int, int], None] | None = None,
) -> Problem:
    """The rollouts of the ``variants`` of a rig along ``poses`` of its end effectors, of all or of each, at ``times``
    [s] ``(t,)``. Raises ``ConfigError`` where the rig is not for a device, or a variant has another mesh than the rig.
    """
    if not variants:
        raise ConfigError(
            "There are no variants to roll out.", "Give one mapping of parameters at least, {} for the rig."
        )
    own_poses = poses_of_each(variants, poses)
    scene, settings = build_scene(rig), settings or NewtonSettings()
    lack = covers(scene)
    if lack is not None:
        raise ConfigError(lack, "Roll it out on the CPU, with sim_core.batch.rollouts.")
    kinds = dict(ARRAYS)
    first: dict[str, np.ndarray] = {}
    arrays: dict[str, list[np.ndarray]] = {name: [] for name in OWN}
    places, starts = [], []
    for k, (variant, tracks) in enumerate(zip(variants, own_poses, strict=True)):
        scene.use(with_parameters(rig, variant))
        record = record_values(scene, settings, np.empty(0, dtype=int), NumberSlopes(), 0)
        found = {name: np.array(record[name], dtype=kinds[name], order="C") for name in kinds}
        first = first or found
        for name in kinds:
            if name not in OWN and not np.array_equal(found[name], first[name]):
                raise ConfigError(
                    f"The variant {k} changes '{name}' of the record, which all rollouts of a batch share.",
                    "Vary material, friction, gravity and poses; another mesh or sample is another batch.",
                )
        if k == 0:
            base = record | found
        for name in OWN:
            arrays[name].append(found[name])
        places.append(mount_places(scene, tracks, times))
        starts.append(start_state(scene, scene.start, None)[0])
        if on_variant is not None:
            on_variant(k + 1, len(variants))
    own = {name: np.stack(values) for name, values in arrays.items() if any((v != values[0]).any() for v in values)}
    return Problem(
        len(variants),
        base,
        own,
        plan_of(base),
        _shared(places),
        np.asarray(times, dtype=float),
        _shared(starts),
        bool(scene.system.inertia),
    )


def _shared(arrays: list[np.ndarray]) -> np.ndarray:
    """Stacked, or one where all are the same."""
    same = all(np.array_equal(a, arrays[0]) for a in arrays)
    return np.stack(arrays[:1] if same else arrays)
