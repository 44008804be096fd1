"""Named errors of poses and of instants, and the blocks of a ledger that has them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sysid.diagnosis.ledger_rows import free_of, named_errors
from sysid.discretisation.approximations import Approximations
from sysid.model.predictor import Prediction
from sysid.model.responses import Modulated
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.discretisation import DISCRETISATION
from sysid.solve.named_errors import NamedError
from sysid.solve.residuals import Problem

RNG = np.random.default_rng(8)
T = np.cumsum(0.05 + 0.004 * RNG.standard_normal(30))
DRAWN, SHIFTED = np.arange(1, 5), np.arange(5, 7)
SIGMA = 0.2
BEYOND = np.random.default_rng(12).standard_normal((2, 1, 3)) * (-1.0) ** np.arange(len(T))[:, None]
MESH = NamedError("mesh", "mesh", 1.0, 0.5)


@pytest.fixture(scope="module")
def case() -> tuple[Problem, Any, list[Prediction], list[list[Modulated]], Approximations]:
    """Two recordings of three columns with derivatives by a parameter, four draws of open motions and two offsets."""
    runs, predictions, motions = [], [], []
    for k in range(2):
        values = np.sin(np.outer(T, [1.0, 3.0, 5.0]) + k)
        derivatives = RNG.standard_normal((len(T), 3, 7))
        predictions.append(Prediction({"gauge": values}, {"gauge": derivatives}, cast(Any, None)))
        data = values + SIGMA * RNG.standard_normal(values.shape)
        measured = Measured("gauge", "markers", T, data, tuple("uvw"))
        runs.append(Run(f"run{k}", "", (), {}, (measured,), float(T[-1])))
        draws = [[Modulated(f"arm.{n}", T, RNG.standard_normal(len(T))) for n in "xy"] for _ in DRAWN]
        motions.append([Modulated(a.parameter, a.times, a.values, (b,)) for a, b in draws])
    problem = Problem(runs, {"gauge": ChannelNoise(np.full(3, SIGMA), 0.0, "given")}, cast(Any, None), prior=True)
    whole = SimpleNamespace(there=np.ones((len(T), 3), dtype=bool))
    base = SimpleNamespace(scaled=None, compared={(k, "gauge"): whole for k in range(2)})
    approximations = Approximations.__new__(Approximations)
    approximations.columns = [MESH]
    approximations.shapes = [{"gauge": RNG.standard_normal((len(T), 3, 1))} for _ in runs]
    approximations._refined = ()
    approximations.jumps = [{"gauge": RNG.standard_normal((len(T), 1, 3))} for _ in runs]
    return problem, base, predictions, motions, approximations


def along_of(predictions: list[Prediction]) -> list[list[Prediction]]:
    """Readings along the motion that was measured, and along the first two draws, beyond their linear responses by
    known differences."""
    root, found = np.sqrt(DISCRETISATION.drawn_motions), []
    for p in predictions:
        slopes = p.derivatives["gauge"]
        there = [0.9 * p.values["gauge"]]
        there += [there[0] + root * slopes[..., DRAWN[k]] + BEYOND[k] for k in range(2)]
        found.append([Prediction({"gauge": values}, {}, cast(Any, None)) for values in there])
    return found


def test_poses_are_open_as_their_draws_vary(case: Any) -> None:
    """The covariance of what poses leave open is that of the responses to the draws, of each recording for itself."""
    problem, base, predictions, motions, approximations = case
    named = named_errors(problem, base, predictions, DRAWN, SHIFTED, motions, along_of(predictions), approximations)
    assert named.columns[0] == MESH
    np.testing.assert_array_equal(named.sd[1:], 1.0)
    columns = [s["gauge"].reshape(-1, len(named.columns))[:, 1:] for s in named.shapes]
    own = [p.derivatives["gauge"][..., DRAWN].reshape(-1, len(DRAWN)) for p in predictions]
    np.testing.assert_allclose(columns[0] @ columns[0].T, own[0] @ own[0].T, atol=1e-10)
    np.testing.assert_allclose(columns[1] @ columns[1].T, own[1] @ own[1].T, atol=1e-10)
    np.testing.assert_array_equal(columns[0] @ columns[1].T, 0.0)


def test_each_instant_has_errors_of_its_own(case: Any) -> None:
    """Of its stamp, of jumps, of what follows the hand at once, and of what is not linear in its motion."""
    problem, base, predictions, motions, approximations = case
    named = named_errors(problem, base, predictions, DRAWN, SHIFTED, motions, along_of(predictions), approximations)
    steps = np.diff(T)
    jitter = 1.4826 * np.median(np.abs(steps - np.median(steps))) / np.sqrt(2.0)
    for own, p, draws, jumps in zip(named.instant, predictions, motions, approximations.jumps, strict=True):
        slopes = np.gradient(p.values["gauge"], T, axis=0)
        for k in (0, 7, 29):
            expected = jitter**2 * np.outer(slopes[k], slopes[k]) + np.outer(jumps["gauge"][k], jumps["gauge"][k])
            by_offset = p.derivatives["gauge"][k][:, SHIFTED]
            for draw in draws:
                change = by_offset @ [part.values[k] for part in draw.parts]
                expected += np.outer(change, change)
            for beyond in BEYOND:
                expected += 0.5 * np.outer(beyond[k], beyond[k])
            np.testing.assert_allclose(own["gauge"][k].T @ own["gauge"][k], expected, rtol=1e-9)


def test_without_noise_of_poses_instants_have_the_errors_of_stamps_and_jumps(case: Any) -> None:
    problem, base, predictions, _, approximations = case
    nothing = np.zeros(0, dtype=int)
    named = named_errors(problem, base, predictions, nothing, nothing, [[], []], [[], []], approximations)
    assert named.columns == (MESH,)
    assert [own["gauge"].shape for own in named.instant] == [(len(T), 2, 3)] * 2


def test_a_ledger_has_the_covariance_of_the_fit(case: Any) -> None:
    """With the approximations of a ledger integrated out, chi-square and slope are those of the problem of the fit."""
    problem, base, predictions, motions, approximations = case
    named = named_errors(problem, base, predictions, DRAWN, SHIFTED, motions, along_of(predictions), approximations)
    whole = problem.with_named(named)
    free = free_of(whole, base, predictions, np.array([0]), ())
    assert [c.kind for c in free.columns] == ["approximation"] * len(named.columns)
    assert [(c.prior_mean, c.prior_sd) for c in free.columns] == [(c.mean, c.sd) for c in named.columns]
    gram = np.sum([b.gram for b in free.blocks], axis=0)
    gaussian, mean = np.diag(1.0 / named.sd**2), named.mean
    errors = slice(1, 1 + len(named.columns))

    def least(parameter: float) -> float:
        """Chi-square of readings and errors at the most probable errors."""
        r = np.array([parameter, 1.0])
        small = gram[np.ix_([0, -1], [0, -1])]
        slope = gram[errors][:, [0, -1]] @ r - gaussian @ mean
        quad = r @ small @ r + mean @ gaussian @ mean
        return float(quad - slope @ np.linalg.solve(gram[errors, errors] + gaussian, slope))

    own = [Prediction(p.values, {"gauge": p.derivatives["gauge"][..., :1]}, cast(Any, None)) for p in predictions]
    found = whole.assemble(own, ["p"], None)
    for at in (0.0, 0.3):
        r = found.residual + found.jacobian[:, 0] * at
        assert least(at) == pytest.approx(float(r @ r), rel=1e-9)
    plain = Problem(problem.runs, problem.noise, problem.engine, prior=True).assemble(own, ["p"], None).residual
    assert float(plain @ plain) != pytest.approx(least(0.0), rel=1e-2)
