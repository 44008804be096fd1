"""The reference model has the cells and the extent that recordings follow, and says what it adds to the rig's."""

from __future__ import annotations

from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sysid.diagnosis import reference_model
from sysid.diagnosis.reference_model import reference_for
from sysid.discretisation.contact_mesh import ContactMesh
from sysid.discretisation.gel_extent import Widened
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run

T = np.linspace(0.0, 1.0, 200)
SIGMA = 1e-3
SHAPES = {"own": np.sin(3.0 * T), "wide": 0.05 * T, "fine": 0.03 * T**3}


def readings(kinds: str, theta: float) -> np.ndarray:
    """Of a model with the changes that its name says."""
    shapes = np.array([SHAPES[k] for k in ("own", *kinds.split())])
    return np.asarray((1.0 + theta) * shapes.sum(axis=0)[:, None])


class Engine:
    """Predicts by what is in the rig's name, a tenth of that for the run ``quiet``; fails for names in ``fails``.
    ``asked``: rigs and runs of the rollouts."""

    def __init__(self, fails: tuple[str, ...] = ()) -> None:
        self.fails = fails
        self.asked: list[tuple[str, str]] = []

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        found: Future[Prediction] = Future()
        self.asked.append((rig.name, run.name))
        if rig.name in self.fails:
            found.set_exception(ConvergenceError("A step does not converge.", "Shorten it."))
        else:
            share = 0.1 if run.name == "quiet" else 1.0
            own = readings("", 0.0)
            changed = own + share * (readings(rig.name, 0.0) - own)
            found.set_result(Prediction({"gauge": changed}, {}, cast(Any, None)))
        return found

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        own = readings("", 0.0)
        return [Prediction({"gauge": own}, {"gauge": own[..., None]}, cast(Any, None)) for _ in runs]


def found(
    small_rig: Any,
    monkeypatch: pytest.MonkeyPatch,
    truth: str,
    fails: tuple[str, ...] = (),
    engine: Any = None,
    coarser: Any = None,
) -> Any:
    """What is made of a recording of the model ``truth`` with a modulus that is 10 % off, after a quiet one."""
    rig = small_rig().model_copy(update={"name": ""})
    wide = rig.model_copy(update={"name": "wide"})
    monkeypatch.setattr(reference_model, "widened", lambda rig: Widened(wide, ("It is wide.",)))
    monkeypatch.setattr(
        reference_model,
        "refined_where_touched",
        lambda rig, runs: ContactMesh(rig.model_copy(update={"name": f"{rig.name} fine"}), 2.0, ("It is fine.",)),
    )
    noise = {"gauge": ChannelNoise(np.array([SIGMA]), np.zeros(1), "given")}
    noise_of = np.random.default_rng(0).standard_normal
    runs = []
    for name, share in (("quiet", 0.1), ("run", 1.0)):
        values = readings("", 0.1) + share * (readings(truth, 0.1) - readings("", 0.1)) + SIGMA * noise_of((len(T), 1))
        runs.append(Run(name, "", (), {}, (Measured("gauge", "markers", T, values, ("u",)),), 1.0))
    parameters = fit_parameters(rig, ["card.E"])
    assert len(start_of(rig, parameters)) == 1
    return reference_for(cast(Any, engine or Engine(fails)), rig, parameters, runs, [], noise, coarser)


@pytest.mark.parametrize("truth", ["", "wide", "fine", "wide fine"])
def test_recordings_tell_extent_and_cells(small_rig: Any, monkeypatch: pytest.MonkeyPatch, truth: str) -> None:
    reference, added, warnings = found(small_rig, monkeypatch, truth)
    assert warnings == ()
    if not truth:
        assert reference is None and added is None
        return
    assert ("It is wide." in reference.notes) == ("wide" in truth)
    assert ("It is fine." in reference.notes) == ("fine" in truth)
    change = readings(truth, 0.0) - readings("", 0.0)
    np.testing.assert_allclose(added.readings["run"]["gauge"], change, atol=1e-12)
    if "fine" in truth:
        np.testing.assert_allclose(added.error.shapes[1]["gauge"], SHAPES["fine"][:, None] / 3.0, atol=1e-12)
    else:
        assert added.error is None


def test_finer_cells_of_the_rig_itself_are_asked_of_the_recording_that_tells_most(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = Engine()
    found(small_rig, monkeypatch, "wide fine", engine=engine)
    assert [run for name, run in engine.asked if name == " fine"] == ["run"]
    assert {run for name, run in engine.asked if name == "wide fine"} == {"quiet", "run"}


def test_cells_with_which_simulations_do_not_end_are_not_taken(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    reference, added, warnings = found(small_rig, monkeypatch, "wide fine", ("wide fine",))
    assert reference.notes == ("It is wide.",) and added.error is None
    assert "simulations do not end" in warnings[0] and "does not converge" in warnings[0]


def test_the_cells_of_a_user_are_the_reference_of_coarser_ones_whatever_recordings_follow(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def given_cells(rig: Any) -> ContactMesh:
        return ContactMesh(rig.model_copy(update={"name": f"{rig.name} fine"}), 2.0, ("They are the user's.",))

    coarser = SimpleNamespace(given_cells=given_cells)
    reference, added, warnings = found(small_rig, monkeypatch, "", coarser=coarser)
    assert reference.notes == ("They are the user's.",) and not warnings
    np.testing.assert_allclose(added.readings["run"]["gauge"], SHAPES["fine"][:, None], atol=1e-12)
    with pytest.raises(ConvergenceError):
        found(small_rig, monkeypatch, "", (" fine",), coarser=coarser)


def test_a_rig_has_the_shapes_of_the_reference_and_keeps_its_own_numbers(small_rig: Any) -> None:
    rig = small_rig()
    name = next(n for n, b in rig.bodies.items() if hasattr(b, "shape") and hasattr(b.shape, "cells"))
    body = rig.bodies[name]
    shape = body.shape.model_copy(update={"cells": tuple(2 * n for n in body.shape.cells)})
    finer = rig.model_copy(update={"bodies": {**rig.bodies, name: body.model_copy(update={"shape": shape})}})
    stiff = rig.model_copy(
        update={"bodies": {**rig.bodies, name: body.model_copy(update={"pose": SimpleNamespace(other=True)})}}
    )
    found = cast(Any, reference_model.Reference(finer, None, ()).fine(stiff).bodies[name])
    assert found.shape == shape and found.pose.other
