"""Gradients by what cameras are, taken of all pictures at once."""

from __future__ import annotations

import numpy as np
import pytest
from gradient_scenes import PRESS
from test_adjoint import EFFECTS, TIGHT, small, weights

from sim_core.gradients import Backward, Direction, Tape, directions, simulate_tangent
from sim_core.rigs import list_parameters, load_rig, with_parameters
from sim_core.rigs.motion import Experiment, compile_experiment
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times

PULL = {"type": "slide", "by_m": [0.0, 0.0, 0.0005], "speed_m_s": 0.001}


@pytest.mark.parametrize("name", ["knit_acrylic_garter_x", "strip_coarse", "tactip_cr"])
def test_cameras_against_other_cameras(name):
    """By intrinsics and offsets of a camera that shows its origin, of one that stands and of one that moves along: the
    rollout is the same, and pictures of it by other cameras differ by the derivative."""
    rig = load_rig(name)
    mount = next(iter(rig.end_effectors))
    experiment = Experiment.model_validate({"name": "pull", "motions": {mount: [PULL]}})
    poses, times = compile_experiment(experiment, rig), step_times(0.0, 0.3, rig.solver.dt_s)
    (camera,) = rig.cameras
    given = [p for p in list_parameters(rig) if p.name.startswith(f"{camera}.") and p.value is not None]
    names = [p.name for p in given if not p.name.endswith("latency_s")]
    assert len(names) >= 9
    scene = build_scene(rig)
    tape = Tape(scene, poses, times)
    drawn = {camera: weights(tape.trace)[camera]}
    found = Backward(tape, directions(rig, names)).gradient(0.0, drawn).parameters
    steps = {p.name: (p.value, 1e-4 * abs(p.value) or 1e-6) for p in given if p.name in names}
    others = {
        f"{name} {side:+g}": with_parameters(rig, {name: value + side * h}).cameras[camera]
        for name, (value, h) in steps.items()
        for side in (1.0, -1.0)
    }
    seen = simulate(build_scene(rig.model_copy(update={"cameras": others})), poses, times).outputs
    size = np.nansum(np.abs(tape.trace.outputs[camera] * drawn[camera]))
    for name, (_, h) in steps.items():
        up, down = (np.nansum(seen[f"{name} {side:+g}"] * drawn[camera]) for side in (1.0, -1.0))
        assert found[name] == pytest.approx((up - down) / (2.0 * h), rel=1e-5, abs=1e-11 * size / h), name


def test_points_out_of_sight_and_a_camera_on_a_hand_that_gives_way(small_rig, visit):
    """Against the forward sensitivities, which image each picture for itself."""
    side = small_rig().model_dump()["cameras"]["side"]
    narrow = {**side, "width_px": 900, "height_px": 440}
    pose = {"position_m": [0.0, -0.25, 0.07], "rpy_deg": [-105.0, 0.0, 0.0]}
    topics = {"marker_tracks": "hand/tracks", "camera_info": "hand/camera_info", "image": "hand/image"}
    carried = {**side, "mount": "finger", "pose": pose, "height_px": 600, "topics": topics}
    build = small(PRESS, 0.3)
    rig, poses, times = build(small_rig, visit, effects=EFFECTS, cameras={"side": narrow, "hand": carried})
    assert "end_effector_compliance" in rig.effects
    names = [p.name for p in list_parameters(rig) if p.name.startswith(("side.", "hand.")) and p.value is not None]
    along = directions(rig, names)
    scene = build_scene(rig)
    trace, derivatives = simulate_tangent(scene, poses, times, along, settings=TIGHT)
    sights = np.isnan(trace.outputs["side"][..., 0]).mean(axis=0)
    assert sights.any() and not sights.all()
    backward = Backward(Tape(scene, poses, times, TIGHT), along)
    for camera in ("side", "hand"):
        given = weights(trace)[camera]
        found = backward.gradient(0.0, {camera: given}).parameters
        products = np.nan_to_num(derivatives[camera]) * given[..., None]
        sums, sizes = (a(products).reshape(-1, len(along)).sum(axis=0) for a in (np.asarray, np.abs))
        assert sum(bool(size) for size in sizes) >= 9
        for name, value, size in zip(names, sums, sizes, strict=True):
            assert found[name] == pytest.approx(value, rel=1e-7, abs=1e-8 * size), (camera, name)


def test_a_secant_to_a_camera_that_points_leave_tells_of_all_that_are_seen(small_rig, visit):
    """The pixels of a pinhole are linear in a shift of it across its view: a long secant is the derivative."""
    rig, poses, times = small(PRESS, 0.1)(small_rig, visit)
    far = with_parameters(rig, {"side.offset_x_m": 0.1})
    outputs = [simulate(build_scene(r), poses, times).outputs["side"] for r in (rig, far)]
    seen, left = (np.isfinite(o) for o in outputs)
    assert seen.any() and (seen & ~left).sum() > 10
    along = [Direction("far", rig, far, 0.1), *directions(rig, ["side.offset_x_m"])]
    _, found = simulate_tangent(build_scene(rig), poses, times, along)
    secant, slope = np.moveaxis(found["side"], -1, 0)
    assert np.isfinite(secant[seen]).all()
    np.testing.assert_allclose(secant[seen], slope[seen], rtol=1e-6, atol=1e-6 * np.abs(slope[seen]).max())
