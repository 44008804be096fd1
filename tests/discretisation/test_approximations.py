"""Named approximations: what the noise of poses leaves open of a motion, and errors by refinement, as columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.rigs import Gel, Rig, parse_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.discretisation.approximations import (
    AVERAGING,
    CONTACT_RANGE,
    TOUCHING_SURFACE,
    Approximations,
    _of_gel_extent,
    mean_less_instant,
    of_instants,
    of_jumps,
    of_rollouts,
    of_stamps,
    principal,
)
from sysid.discretisation.error_budget import with_half_range
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import SerialPredictor
from sysid.model.time_span import rollout_times
from sysid.observations.observations import Measured, Run
from sysid.proof.truths import paths, strip
from sysid.settings.discretisation import DISCRETISATION
from sysid.settings.solve import SOLVE
from sysid.solve.discretisation_basis import ErrorShape

TIMES = [0.0, 0.06, 0.12, 0.2, 0.3]
WAY = [[0, 0, 0], [0, 0, -0.006], [0.004, 0.001, -0.007], [0.004, 0.001, -0.007], [0, 0, -0.003]]
STAMPS = np.linspace(0.013, 0.287, 21)
NOISE = (1e-7, 1e-6)


@pytest.fixture(scope="module")
def given(small_rig: Callable[..., Rig], visit: Callable[..., Any]) -> tuple[Approximations, SerialPredictor, Any, Run]:
    """Those of the small rig, pressed along poses with noise, with the tool askew in the hand."""
    rig = small_rig(end_effectors={"finger": {"offset_x_m": 0.01, "offset_ry_deg": 3.0}})
    predictor = SerialPredictor()
    blank = tuple(
        Measured(channel, kind, STAMPS, np.zeros((len(STAMPS), m)), tuple(str(k) for k in range(m)))  # type: ignore[arg-type]
        for channel, (kind, m) in {"wrench": ("wrench", 6), "side": ("tracks", 20)}.items()
    )
    at = np.linspace(0.0, TIMES[-1], 61)
    position, quaternion = visit(TIMES, WAY)["finger"].sample(at)
    rng = np.random.default_rng(5)
    position = position + NOISE[0] * rng.standard_normal(position.shape)
    run = Run("own", "own", (), {"finger": PoseTrajectory(at, position, quaternion, NOISE)}, blank, TIMES[-1])
    parameters = fit_parameters(rig, ["gel.E_pa"])
    scaled = start_of(rig, parameters)
    base = SimpleNamespace(
        rig=rig, centre=rig, parameters=parameters, scaled=scaled, predictions=[predictor.predict(rig, run)]
    )
    ones = tuple({m.channel: np.ones(m.values.shape) for m in r.measured} for r in [run])
    problem = SimpleNamespace(runs=[run], refined=[ErrorShape("mesh", ones)])
    return Approximations(predictor, cast(Any, base), cast(Any, problem)), predictor, base, run


def test_each_has_its_shape_and_its_size(given: Any) -> None:
    found, predictor, base, run = given
    averaging = [f"{AVERAGING}, {channel}" for channel in ("wrench", "side")]
    assert [c.name for c in found.columns] == ["mesh", CONTACT_RANGE, TOUCHING_SURFACE, *averaging]
    sizes = [DISCRETISATION.approximation_sizes[n] for n in (CONTACT_RANGE, TOUCHING_SURFACE, AVERAGING, AVERAGING)]
    assert [(c.mean, c.sd) for c in found.columns] == [(SOLVE.expected_error_size, SOLVE.error_size_sd), *sizes]
    assert (found.shapes[0]["wrench"][..., 0] == 1.0).all()
    # The error of a range of contact is twice what half of it changes: it vanishes with the range.
    readings = base.predictions[0].values["wrench"]
    change = predictor.predict(with_half_range(base.rig), run).values["wrench"] - readings
    # Steps of a rollout that is made again are as solved, and not the same to the last digit.
    round_off = 1e-9 * np.abs(readings).max()
    np.testing.assert_allclose(found.shapes[0]["wrench"][..., 1], 2.0 * change, rtol=1e-6, atol=round_off)
    assert found.shapes[0]["wrench"][..., 1].any()


def test_an_open_motion_changes_readings_as_a_rollout_along_it_does(given: Any) -> None:
    found, predictor, base, run = given
    motions = found.open_motions(0, run)
    assert len(motions) == DISCRETISATION.drawn_motions
    parameters, scaled = base.parameters, base.scaled
    columns = predictor.predict_responses(base.rig, run, parameters, scaled, [], motions[:1]).derivatives
    times = rollout_times([base.rig], run, base.rig.solver.dt_s)
    curve = run.poses["finger"].drawn(np.random.default_rng(0))
    drawn = replace(run, poses={"finger": PoseTrajectory(times, *curve.sample(times))})
    plain = replace(run, poses={"finger": PoseTrajectory(times, *run.poses["finger"].sample(times))})
    for channel in ("wrench", "side"):
        ends = [predictor.predict(base.rig, r).values[channel] for r in (plain, drawn)]
        change = (ends[1] - ends[0]) / np.sqrt(DISCRETISATION.drawn_motions)
        assert np.abs(change).max() > 0.0
        off = np.linalg.norm(np.nan_to_num(columns[channel][..., -1] - change)) / np.linalg.norm(np.nan_to_num(change))
        assert off < 0.05, channel


def test_rollouts_follow_the_draws(given: Any) -> None:
    """Where a body responds linearly, along the draws of the open motions it does what their responses say."""
    found, predictor, base, run = given
    motions, jobs = found.open_motions(0, run), found.submit_along(0, run)
    count = DISCRETISATION.rolled_motions
    assert len(jobs) == count + 1
    columns = predictor.predict_responses(base.rig, run, base.parameters, base.scaled, [], motions[:count])
    responses = np.nan_to_num(columns.derivatives["side"][..., len(base.parameters) :])
    beyond = of_rollouts(responses, [job.result().values["side"] for job in jobs])
    assert beyond.shape == (len(STAMPS), count, 20)
    whole = np.sqrt(DISCRETISATION.drawn_motions / count) * responses
    assert np.linalg.norm(beyond) < 0.1 * np.linalg.norm(whole)
    exact = replace(run, poses={n: replace(p, noise=(0.0, 0.0)) for n, p in run.poses.items()})
    still = Approximations(predictor, base, cast(Any, SimpleNamespace(runs=[exact], refined=[])))
    assert still.submit_along(0, exact) == []


def test_rollouts_along_draws_have_no_less_friction_than_the_rig(given: Any) -> None:
    """A fit may have lost it; where it has found more, they have that."""
    _, predictor, base, run = given
    mu = base.rig.contacts[0].friction
    for there, expected in ((0.1 * mu, mu), (1.2 * mu, 1.2 * mu)):
        contacts = tuple(c.model_copy(update={"friction": there}) for c in base.rig.contacts)
        rigs: list[Rig] = []
        fitted = SimpleNamespace(**{**vars(base), "rig": base.rig.model_copy(update={"contacts": contacts})})
        other = Approximations(predictor, cast(Any, fitted), cast(Any, SimpleNamespace(runs=[run], refined=[])))
        other._engine = cast(Any, SimpleNamespace(submit=lambda rig, run, into=rigs: into.append(rig)))
        other.submit_along(0, run)
        assert [rig.contacts[0].friction for rig in rigs] == [expected] * (DISCRETISATION.rolled_motions + 1)


def test_what_is_alike_for_many_readings_is_known_no_better_by_all_of_them() -> None:
    """Of a course with the autocorrelation rho^l the sum of n readings has (1 + rho) / (1 - rho) n times the variance
    of one; so have the errors of instants, independent ones and all."""
    rng, n, rho = np.random.default_rng(13), 4000, 0.9
    course = np.zeros((n, 4, 2))
    for k in range(1, n):
        course[k] = rho * course[k - 1] + np.sqrt(1.0 - rho**2) * rng.standard_normal((4, 2))
    responses = rng.standard_normal((n, 2, 4))
    plain = rng.standard_normal((n, 2))
    along = [
        plain,
        *(plain + np.sqrt(DISCRETISATION.drawn_motions) * responses[..., k] + course[:, k] for k in range(4)),
    ]
    found = of_rollouts(responses, along)
    assert np.sum(found**2) / np.sum(course**2 / 4.0) == pytest.approx((1.0 + rho) / (1.0 - rho), rel=0.2)
    white = [plain, *(a - course[:, k] + rng.standard_normal((n, 2)) for k, a in enumerate(along[1:]))]
    assert np.mean(np.sum(of_rollouts(responses, white) ** 2, axis=1)) == pytest.approx(1.0, rel=0.1)
    assert of_rollouts(responses, along[:1]).shape == (n, 0, 2)


def test_poses_without_noise_leave_no_motion_open(given: Any) -> None:
    found, _, _, run = given
    exact = replace(run, poses={n: replace(p, noise=(0.0, 0.0)) for n, p in run.poses.items()})
    (motion, *_) = found.open_motions(0, exact)
    assert max(np.abs(p.values).max() for p in motion.parts) < 1e-12


def test_principal_columns_have_the_covariance_of_the_responses() -> None:
    rng = np.random.default_rng(0)
    responses = rng.standard_normal((30, 3)) @ np.diag([3.0, 1.0, 0.01]) @ rng.standard_normal((3, 8))
    found = responses @ principal(responses)
    assert found.shape == (30, 2)
    covariance = responses @ responses.T
    np.testing.assert_allclose(found @ found.T, covariance, atol=2.0 * DISCRETISATION.faint_motion**2)
    assert np.linalg.norm(found[:, 0]) > np.linalg.norm(found[:, 1])


def test_what_a_body_follows_at_once_is_an_error_of_each_instant(given: Any) -> None:
    """Its covariance is that of the readings by the offsets that the draws have at that instant."""
    found, predictor, base, run = given
    motions, stay = found.open_motions(0, run), found.offsets(run)
    assert [p.parameter for p in stay] == [p.parameter for p in motions[0].parts]
    columns = predictor.predict_responses(base.rig, run, base.parameters, base.scaled, [], stay).derivatives["side"]
    shifted = np.nan_to_num(columns[..., len(base.parameters) :])
    errors = of_instants(STAMPS, motions, shifted)
    assert errors.shape == (len(STAMPS), 6, 20)
    k = 7
    draws = np.array([[p.course(STAMPS[k]) for p in m.parts] for m in motions])
    readings = draws @ shifted[k].T
    np.testing.assert_allclose(errors[k].T @ errors[k], readings.T @ readings, atol=1e-9 * (readings**2).sum())
    assert errors[k].any()


def test_stamps_that_jitter_are_an_error_of_each_instant() -> None:
    """Readings at other times than their stamps say are off by how fast they change; regular stamps have no jitter."""
    rng = np.random.default_rng(0)
    true = np.arange(0.0, 20.0, 0.033)
    jitter = 1.5e-3
    stamped = true + jitter * rng.standard_normal(len(true))
    values = np.stack([np.sin(3.0 * stamped), np.cos(2.0 * stamped)], axis=1)
    errors = of_stamps(stamped, values)
    off = np.stack([np.sin(3.0 * true), np.cos(2.0 * true)], axis=1) - values
    assert np.mean((off / errors[:, 0]) ** 2, where=np.abs(errors[:, 0]) > 1e-3) == pytest.approx(1.0, abs=0.25)
    assert np.abs(of_stamps(true, values)).max() < 1e-9


def test_the_extent_of_a_gel_scales_how_far_its_markers_are_dragged(small_rig: Callable[..., Rig]) -> None:
    """Of a camera that sees nothing but a gel which is fixed to what it is fixed to, axis by axis."""
    rig = small_rig()
    name = next(iter(rig.cameras))
    gel = next(n for n, b in rig.bodies.items() if isinstance(b, Gel))
    on_gel = [rig.cameras[name].sees[0].model_copy(update={"body": gel})]
    camera = rig.cameras[name].model_copy(update={"sees": tuple(on_gel), "mount": rig.bodies[gel].mount})
    rig = rig.model_copy(update={"cameras": {name: camera}})
    values = np.random.default_rng(0).standard_normal((5, 4))
    run = Run("r", "", (), {}, (Measured(name, "tracks", np.arange(5.0), values, tuple("abcd")),), 4.0)
    found = _of_gel_extent(rig, [run], [cast(Any, SimpleNamespace(values={name: values}))])
    assert [label for label, _ in found] == [f"gel extent, axis 1 of {name}", f"gel extent, axis 2 of {name}"]
    whole = sum(shapes[0][name] for _, shapes in found)
    np.testing.assert_allclose(whole, values - values[0])
    assert not found[0][1][0][name][:, 1::2].any() and not found[1][1][0][name][:, ::2].any()
    elsewhere = rig.model_copy(update={"cameras": {name: camera.model_copy(update={"mount": "world"})}})
    assert _of_gel_extent(elsewhere, [run], [cast(Any, SimpleNamespace(values={name: values}))]) == []


def test_a_sheet_that_touches_elsewhere_is_as_above_another_table() -> None:
    """Its error is what a table makes that is lower by half the thickness, extrapolated from half of that."""
    one = strip.draw_strip(np.random.default_rng(0))
    given = strip.rig(one, "strip")
    given["solver"] = {"dt_s": 0.01, "inertia": True, "integrator": "bdf2"}
    rig = parse_rig(given, "strip")
    down = strip.hanging(one, -0.3)
    path = paths.Path((0.0, down + 0.001, -0.3)).move((0.0, -0.003, 0.0), 0.3).wait(0.2)
    at = np.linspace(0.0, path.end_s, 51)
    blank = Measured("wrist", "wrench", at[1:-1], np.zeros((49, 6)), tuple("xyzabc"))
    run = Run("press", "", (), {"gripper": PoseTrajectory(at, *strip.poses(path(at)))}, (blank,), float(path.end_s))
    predictor = SerialPredictor()
    base = SimpleNamespace(
        rig=rig, centre=rig, parameters=[], scaled=np.zeros(0), predictions=[predictor.predict(rig, run)]
    )
    problem = SimpleNamespace(runs=[run], refined=[])
    found = Approximations(predictor, cast(Any, base), cast(Any, problem))
    table = rig.bodies["table"]
    below = table.pose.model_copy(update={"position_m": (0.0, 0.0, -0.25 * one.thickness)})
    lower = rig.model_copy(update={"bodies": {**rig.bodies, "table": table.model_copy(update={"pose": below})}})
    change = 2.0 * (predictor.predict(lower, run).values["wrist"] - base.predictions[0].values["wrist"])
    shape = found.shapes[0]["wrist"][..., [c.name for c in found.columns].index(TOUCHING_SURFACE)]
    assert np.abs(change).max() > 1e-5
    # Steps of a rollout that is made again are as solved, and not the same to the last digit.
    np.testing.assert_allclose(shape, change, atol=1e-6 * np.abs(base.predictions[0].values["wrist"]).max())


def test_a_sensor_reads_the_mean_about_its_stamps() -> None:
    """Of a vibration the mean over T is sin(omega T / 2) / (omega T / 2) of it; stamps need not be regular."""
    omega, T = 31.0, 0.01
    t = np.arange(0.0, 1.0, T)
    t[1:-1] += 0.0005 * np.random.default_rng(9).standard_normal(len(t) - 2)
    values = np.column_stack([np.sin(omega * t), 3.0 + 2.0 * t])
    found = mean_less_instant(t, values)
    half = 0.5 * omega * T
    np.testing.assert_allclose(found[1:-1, 0], (np.sin(half) / half - 1.0) * values[1:-1, 0], atol=4e-4)
    np.testing.assert_allclose(found[:, 1], 0.0, atol=1e-12)
    values[40] = np.nan
    lost = mean_less_instant(t, values)
    assert (lost[39:42] == 0.0).all() and lost[38, 0] == found[38, 0]


def test_a_sensor_reads_an_instant_or_the_mean_over_a_window_of_any_length_up_to_the_interval() -> None:
    squares = (np.arange(100000) + 0.5) ** 2 / 100000.0**2
    squares = np.concatenate([squares, np.zeros(100000)])
    mean, sd = DISCRETISATION.approximation_sizes[AVERAGING]
    assert mean == pytest.approx(squares.mean(), rel=1e-3) and sd == pytest.approx(squares.std(), rel=1e-3)


def test_errors_that_jump_are_errors_of_each_instant() -> None:
    """White ones have their own variance there, a straight line none, between stamps of any distance."""
    rng = np.random.default_rng(10)
    t = np.cumsum(rng.uniform(0.005, 0.015, 20000))
    errors = np.stack([rng.standard_normal((len(t), 2)), np.column_stack([1.0 + 3.0 * t, -t])], axis=-1)
    found = of_jumps(t, errors)
    assert found.shape == (len(t), 2, 2)
    # Between stamps a share u of the way apart, the distance has the variance 1 + u^2 + (1 - u)^2.
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    expected = 2.0 / 3.0 * np.mean(1.0 + share**2 + (1.0 - share) ** 2)
    assert np.mean(found[1:-1, 0] ** 2) == pytest.approx(expected, rel=0.03)
    np.testing.assert_allclose(found[:, 1], 0.0, atol=1e-9)
    assert not of_jumps(t[:2], errors[:2]).any()


def test_jumps_of_all_that_is_solved_approximately_count_and_no_others(given: Any) -> None:
    found, _, _, run = given
    names = [c.name for c in found.columns]
    solved = [names.index("mesh"), names.index(CONTACT_RANGE)]
    for m in run.measured:
        np.testing.assert_array_equal(found.jumps[0][m.channel], of_jumps(m.t, found.shapes[0][m.channel][..., solved]))
    assert found.jumps[0]["wrench"][:, 1].any()
