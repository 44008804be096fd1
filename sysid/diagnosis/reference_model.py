"""The finer model that a diagnosis measures against, and what it adds to the readings of the rig's own.

Cells that are too wide and a pad that is cut off change readings by tens of times the noise. Both are mended in a
reference model, which costs ten times a rollout of the rig. It is simulated where the baseline stands, and what it adds
is kept for all else (:mod:`sysid.model.space_mapping`). A rig with so many cells that it costs as much itself is the
reference model, and one with coarser cells takes its place (:mod:`sysid.discretisation.coarser_cells`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.discretisation.coarser_cells import CoarserCells
from sysid.discretisation.contact_mesh import ContactMesh, refined_where_touched
from sysid.discretisation.followed_model import follows
from sysid.discretisation.gel_extent import widened
from sysid.discretisation.refinement import discretisation, error_of_coarser_cells
from sysid.model.parameters import FitParameter, start_of
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.model.space_mapping import SpaceMappedPredictor, additions, mapped
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Run
from sysid.solve.discretisation_basis import ErrorShape


@dataclass(frozen=True)
class Reference:
    """``extended``: a rig with pads as wide as recordings follow them, and the cells of the given one; ``mesh``: finer
    cells of that, None where they are fine enough; ``notes``: what was changed, in words."""

    extended: Rig
    mesh: ContactMesh | None
    notes: tuple[str, ...]

    def fine(self, rig: Rig) -> Rig:
        """A rig with other parameters or effects with the shapes of the reference."""
        return _with_shapes(rig, self.extended if self.mesh is None else self.mesh.rig)

    def coarser(self, rig: Rig) -> Rig:
        """The same with the cells of the given rig."""
        return _with_shapes(rig, self.extended)


@dataclass(frozen=True)
class Added:
    """``readings``: what the reference adds, by run and channel, measured units; ``error``: of its cells, None where
    these are the given ones."""

    readings: dict[str, dict[str, np.ndarray]]
    error: ErrorShape | None


@dataclass(frozen=True)
class Standing:
    """What is known where a search stands. ``engine``: predictions of the rig's own model with what the reference adds;
    ``plain``: of the recordings; ``refined``: what these are off by mesh and by time step."""

    engine: SpaceMappedPredictor
    plain: list[Prediction]
    refined: list[ErrorShape]


def _with_shapes(rig: Rig, other: Rig) -> Rig:
    changed = {
        n: rig.bodies[n].model_copy(update={"shape": body.shape})
        for n, body in other.bodies.items()
        if getattr(body, "shape", None) != getattr(rig.bodies[n], "shape", None)
    }
    return rig.model_copy(update={"bodies": {**rig.bodies, **changed}})


def reference_for(
    engine: AnyEngine,
    rig: Rig,
    parameters: Sequence[FitParameter],
    runs: Sequence[Run],
    held_out: Sequence[Run],
    noise: dict[str, ChannelNoise],
    coarser: CoarserCells | None = None,
) -> tuple[Reference | None, Added | None, tuple[str, ...]]:
    """The reference model whose extent and cells the recordings ``runs`` follow, None where those of the rig are as
    good, what it adds, and what was not possible, in words. ``coarser``: how ``rig`` has come to its cells, where a
    user's are finer: these are taken for what recordings follow. Raises ``ThinshellError`` where these cannot be
    simulated."""

    def finer(own: Rig) -> ContactMesh | None:
        return refined_where_touched(own, [*runs, *held_out]) if coarser is None else coarser.given_cells(own)

    wide, mesh = widened(rig), finer(rig)
    if wide is None and mesh is None:
        return None, None, ()
    known = np.array([p.known_sd or p.prior_sd for p in parameters])
    own = engine.predict_all(rig, runs, parameters, start_of(rig, parameters))
    extended, there = rig, own
    notes: list[str] = []
    fine: list[Prediction] | None = None
    warnings: tuple[str, ...] = ()
    try:
        if wide is not None:
            here = _all(engine, wide.rig, runs)
            if _extends(engine, mesh, runs, own, here, noise, known):
                extended, mesh = wide.rig, finer(wide.rig)
                there = [replace(d, values=h.values) for d, h in zip(own, here, strict=True)]
                notes += wide.notes
        if mesh is not None:
            fine = _all(engine, mesh.rig, runs)
            if coarser is not None or follows(runs, there, [fine], noise, known)[0].refines:
                notes += mesh.notes
            else:
                mesh = fine = None
    except ThinshellError as error:
        if coarser is not None:
            raise
        mesh, warnings = None, (f"The cells of the rig are kept: with finer ones, simulations do not end. {error}",)
    if mesh is None or fine is None:
        reference = None if extended is rig else Reference(extended, None, tuple(notes))
        return reference, None if reference is None else Added(additions(runs, own, there), None), warnings
    error_there = error_of_coarser_cells(fine, there, mesh.finer)
    return Reference(extended, mesh, tuple(notes)), Added(additions(runs, own, fine), error_there), warnings


def _extends(
    engine: AnyEngine,
    mesh: ContactMesh | None,
    runs: Sequence[Run],
    own: Sequence[Prediction],
    wide: Sequence[Prediction],
    noise: dict[str, ChannelNoise],
    known: np.ndarray,
) -> bool:
    """Whether recordings follow wide pads. What they seem to tell of these is asked again with finer cells, which may
    change the readings alike, of the recording in which wide pads change most."""
    if not follows(runs, own, [wide], noise, known)[0].extends:
        return False
    if mesh is None:
        return True
    k = int(np.argmax([_change(*pair, noise) for pair in zip(own, wide, strict=True)]))
    fine = engine.submit(mesh.rig, runs[k]).result()
    return follows([runs[k]], [own[k]], [[wide[k]], [fine]], noise, known)[0].extends


def _change(one: Prediction, other: Prediction, noise: dict[str, ChannelNoise]) -> float:
    """Sum of the squares of what readings change by, in units of the noise."""
    moved = ((other.values[c] - v) / noise[c].sigma for c, v in one.values.items())
    return float(sum(np.nansum(m**2) for m in moved))


def standing(
    engine: AnyEngine,
    reference: Reference | None,
    rigs: Sequence[Rig],
    runs: Sequence[Run],
    own: Sequence[Prediction],
    known: Added | None = None,
) -> Standing:
    """What is known at the parameters of ``rigs``, one for each run. ``own``: predictions of these, without what the
    reference adds; ``known``: that, where it is at hand. Raises ``ThinshellError`` where something cannot be
    simulated."""
    if reference is None:
        added = Added({}, None)
    else:
        added = known or added_at(engine, reference, rigs, runs, own)
    shapes = discretisation(engine, rigs, runs, own, added.error)
    plain = [mapped(p, run, added.readings) for p, run in zip(own, runs, strict=True)]
    return Standing(SpaceMappedPredictor(engine, added.readings), plain, shapes)


def added_at(
    engine: AnyEngine, reference: Reference, rigs: Sequence[Rig], runs: Sequence[Run], own: Sequence[Prediction]
) -> Added:
    """What the reference adds to predictions ``own`` of the given rigs."""
    pairs = list(zip(rigs, runs, strict=True))
    fine = [engine.submit(reference.fine(rig), run) for rig, run in pairs]
    if reference.mesh is None:
        return Added(additions(runs, own, [job.result() for job in fine]), None)
    same = all(reference.coarser(rig) == rig for rig in rigs)
    coarse = [] if same else [engine.submit(reference.coarser(rig), run) for rig, run in pairs]
    there = [job.result() for job in fine]
    coarser = [job.result() for job in coarse] or list(own)
    return Added(additions(runs, own, there), error_of_coarser_cells(there, coarser, reference.mesh.finer))


def _all(engine: AnyEngine, rig: Rig, runs: Sequence[Run]) -> list[Prediction]:
    jobs = [engine.submit(rig, run) for run in runs]
    return [job.result() for job in jobs]
