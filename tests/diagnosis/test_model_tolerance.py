"""What careful models may differ in: a share of the deformation, not of rigid motion."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.rigs import Gel, Rig
from sim_core.simulate import Trace
from sysid.diagnosis.model_tolerance import deformation, model_tolerance
from sysid.model.predictor import Prediction
from sysid.observations.observations import Measured, Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.discretisation_basis import MODEL, ErrorShape, basis_of

POINTS = np.random.default_rng(0).normal(size=(12, 2)) * 40.0
T = np.linspace(0.0, 1.0, 7)


def tracks(values: np.ndarray) -> Measured:
    return Measured("camera", "tracks", T, values, tuple(str(k) for k in range(values.shape[1])))


def moved(bend: float) -> np.ndarray:
    """Points that turn and shift by hundreds of pixels, and bend by ``bend`` at the end."""
    frames = []
    for t in T:
        turned = Rotation.from_euler("z", 2.5 * t).as_matrix()[:2, :2]
        bent = POINTS + bend * t * np.column_stack([np.zeros(12), (POINTS[:, 0] / 40.0) ** 2])
        frames.append((bent @ turned.T + [300.0 * t, -100.0 * t]).ravel())
    return np.array(frames)


def test_rigid_motion_is_no_deformation() -> None:
    assert np.abs(deformation(tracks(moved(0.0)), moved(0.0))).max() < 1e-9
    bent = deformation(tracks(moved(5.0)), moved(5.0))
    assert np.abs(bent[0]).max() < 1e-9
    parabola = (POINTS[:, 0] / 40.0) ** 2 * 5.0
    assert np.sqrt(np.mean(bent[-1] ** 2)) == pytest.approx(np.std(parabola) / np.sqrt(2.0), rel=0.35)


def test_points_out_of_sight_have_none() -> None:
    values = moved(5.0)
    values[3, :4] = np.nan
    found = deformation(tracks(values), values)
    assert np.isfinite(found).all() and not found[3, :4].any() and found[3, 4:].any()


def test_of_a_wrench_it_is_the_change_since_the_start() -> None:
    values = np.outer(T, np.arange(1.0, 7.0)) + 3.0
    wrench = Measured("wrist", "wrench", T, values, tuple("abcdef"))
    run = Run("run", "", (), {}, (wrench,), 1.0)
    shape = model_tolerance(
        cast(Rig, SimpleNamespace(cameras={})), [run], [Prediction({"wrist": values}, {}, Trace(T, {}, {}, {}, ()))]
    )
    np.testing.assert_allclose(shape.shapes[0]["wrist"], DIAGNOSIS.model_tolerance * (values - 3.0))
    assert shape.mean == 0.0


@pytest.mark.parametrize("label", [MODEL, "mesh"])
def test_what_models_differ_in_is_none_where_there_is_no_signal(label: str) -> None:
    """Right beside a loud instant too, where the error of a mesh may reach: a release shows what nothing else does."""
    t = np.linspace(0.0, 5.0, 501)
    signal = np.where((t > 1.0) & (t < 2.0), 0.1, 0.0)[:, None] * np.ones(6)
    wrench = Measured("wrist", "wrench", t, signal, tuple("abcdef"))
    run = Run("run", "", (), {}, (wrench,), 5.0)
    found = basis_of([ErrorShape(label, ({"wrist": signal},))], 0, run, wrench)
    quiet, beside = t > 2.0, (t > 2.0) & (t < 2.05)
    assert (found.largest[beside].min() > 0.0) == (label != MODEL)
    allowed = sum(np.abs(p.shape[quiet]).max() for p in (*found.own, *found.common))
    assert (allowed > 0.0) == (label != MODEL)


def test_points_on_a_gel_seen_from_its_mount_may_be_off_by_a_share_of_all_their_motion() -> None:
    """Their shift is deformation there; seen from elsewhere, it is none."""
    values = moved(0.0)
    run = Run("run", "", (), {}, (tracks(values),), 1.0)
    gel = Gel.model_construct(mount="world")
    for mount, size in (("world", DIAGNOSIS.gel_marker_tolerance * (values - values[0])), ("hand", 0.0 * values)):
        camera = SimpleNamespace(mount=mount, sees=[SimpleNamespace(body="pad")])
        rig = cast(Rig, SimpleNamespace(cameras={"camera": camera}, bodies={"pad": gel}))
        shape = model_tolerance(rig, [run], [Prediction({"camera": values}, {}, Trace(T, {}, {}, {}, ()))])
        np.testing.assert_allclose(shape.shapes[0]["camera"], size, atol=1e-9)
