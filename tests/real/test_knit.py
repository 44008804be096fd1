"""Rigs of knitted sheets against recordings of them, which are not part of the project."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_core.rigs import load_rig
from sim_core.scene import build_scene
from sysid.fit import fit_runs
from sysid.model.load import load_run
from sysid.model.marker_registration import placed
from sysid.model.predictor import SerialPredictor
from sysid.observations.observations import Measured, Run

SHARED = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
DATA = SHARED / "data" / "knit_fabric_stretch"
SHEETS = (
    "acrylic_garter_x",
    "acrylic_garter_y",
    "acrylic_stockinette_x",
    "acrylic_stockinette_y",
    "pearlized_cotton_stockinette_x",
    "pearlized_cotton_stockinette_y",
)

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"no folder {DATA}: set THINSHELL_SHARED to the folder that holds data/"
)


def channel(run: Run, name: str) -> Measured:
    return next(m for m in run.measured if m.channel == name)


def pins(values: np.ndarray) -> np.ndarray:
    """Tracks [px] as ``(n, 5, 2)``: right, left, bottom, top, centre; the origin marker left out."""
    return values[:, :10].reshape(-1, 5, 2)


def affine(run: Run) -> np.ndarray:
    """Pins [px] of a sheet that stretches evenly and keeps its width: v grows with the clamps' distance."""
    video = channel(run, "video")
    y = run.poses["puller"].sample(video.t)[0][:, 1]
    out = np.repeat(pins(video.values)[:1], len(y), axis=0)
    out[:, :, 1] *= (y / y[0])[:, None]
    return out


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def thinned(run: Run, step: int) -> Run:
    """Every so many samples of a run."""
    return replace(run, measured=tuple(replace(m, t=m.t[::step], values=m.values[::step]) for m in run.measured))


@pytest.mark.parametrize("sheet", SHEETS)
def test_rigs_agree_with_the_recordings(sheet: str) -> None:
    rig = load_rig(f"knit_{sheet}")
    run = load_run(rig, DATA / f"{sheet}_pull1")
    # The rig was written from the first frame of this pull: the pins are where it says.
    seen_by = placed(build_scene(rig), run.firsts)
    given, found = (np.array(r.cameras["video"].sees[0].points.positions_m) for r in (rig, seen_by))
    np.testing.assert_allclose(found, given, atol=3e-4)
    start = run.poses["puller"].positions[0]
    np.testing.assert_allclose(start, rig.end_effectors["puller"].start.position_m, atol=1e-5)
    measured = np.isfinite(channel(run, "gauge").values).any(axis=0)
    assert measured.tolist() == [False, True, False, False, False, False]


def test_a_pull_in_few_steps() -> None:
    rig = load_rig("knit_acrylic_stockinette_y")
    run = load_run(rig, DATA / "acrylic_stockinette_y_pull2")
    prediction = SerialPredictor().predict(rig, run, dt=run.end / 8)
    force, track = prediction.values["gauge"], prediction.values["video"]
    assert np.isfinite(force).all() and np.isfinite(track).all()
    assert force[-1, 1] > 1.0 and np.nanmax(channel(run, "gauge").values[-30:, 1]) > 1.0
    # What the stretched sheet does along the other axes is small.
    assert np.abs(force[:, [0, 2]]).max() < 0.05 * force[-1, 1]
    measured, predicted = pins(channel(run, "video").values), pins(track)
    np.testing.assert_allclose(predicted[0], measured[0], atol=0.1)
    for moved in (measured[-1] - measured[0], predicted[-1] - predicted[0]):
        assert moved[0, 0] < -1.0 and moved[1, 0] > 1.0  # the side pins go inwards
        assert (moved[:, 1] > 1.0).all()  # everything goes down,
        assert moved[3, 1] < moved[4, 1] < moved[2, 1]  # and more so further down


@pytest.mark.slow
def test_fit_of_one_sheet() -> None:
    sheet = "acrylic_stockinette_y"
    rig = load_rig(f"knit_{sheet}")
    train, held_out = (
        [thinned(load_run(rig, DATA / f"{sheet}_pull{k}"), 5) for k in pulls] for pulls in ((2, 4), (1, 5))
    )
    result, fitted = fit_runs(rig, train, ["knit.E_pa", "knit.nu"], held_out=held_out)
    assert result.converged
    stiffness = fitted.bodies["knit"].material.E_pa * fitted.bodies["knit"].material.thickness_m  # type: ignore[union-attr]
    assert 100.0 < stiffness < 5000.0  # N/m; a knit, no film
    scored = [e for e in result.errors if e.held_out]
    assert {e.run for e in scored} == {run.name for run in held_out}
    for e in scored:
        assert e.after > 2.0 * e.noise  # a linear elastic sheet does not explain a knit, and says so
        if e.channel == "gauge":
            assert e.after < 0.5 * e.before
            assert e.after < 0.2 * 30.0
    engine = SerialPredictor()
    for run in held_out:
        miss = pins(channel(run, "video").values) - pins(engine.predict(fitted, run).values["video"])
        even = pins(channel(run, "video").values) - affine(run)
        assert rms(miss) < rms(even)
        assert rms(miss[:, :2, 0]) < rms(even[:, :2, 0])  # the side pins' way inwards
