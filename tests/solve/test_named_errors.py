"""Named errors are integrated out of all residuals together."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.solve.named_errors import Marginal, NamedError, NamedErrors
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 1.0, 12)
SIGMA = 0.3


def errors(instant: tuple[dict[str, np.ndarray], ...] = ()) -> NamedErrors:
    """Two, in two recordings of one channel with three columns."""
    rng = np.random.default_rng(1)
    shapes = tuple({"gauge": rng.standard_normal((len(T), 3, 2))} for _ in range(2))
    columns = (NamedError("mesh", "mesh", 1.0, 0.3), NamedError("poses", "one", 0.0, 2.0))
    return NamedErrors(columns, shapes, instant=instant)


def problem(named: NamedErrors, values: np.ndarray) -> Problem:
    """Recordings ``(2, n, 3)``, of which a reading is missing."""
    runs = []
    for k, data in enumerate(values):
        data = data.copy()
        data[3, 1] = np.nan
        runs.append(Run(f"run{k}", "", (), {}, (Measured("gauge", "markers", T, data, tuple("uvw")),), 1.0))
    noise = {"gauge": ChannelNoise(np.full(3, SIGMA), 0.0, "given")}
    return Problem(runs, noise, cast(Any, None), named=named)


def predictions(slopes: np.ndarray | None = None) -> list[Prediction]:
    zero = np.zeros((len(T), 3))
    return [Prediction({"gauge": zero}, {} if slopes is None else {"gauge": slopes}, cast(Any, None)) for _ in range(2)]


@pytest.mark.parametrize("instants", [False, True])
def test_chi_square_is_that_of_the_whole_covariance(instants: bool) -> None:
    """r^T C^-1 r and J^T C^-1 r with the covariance of noise, named errors and errors of instants written out."""
    rng = np.random.default_rng(2)
    own = tuple({"gauge": rng.standard_normal((len(T), 2, 3))} for _ in range(2)) if instants else ()
    named, values = errors(own), rng.standard_normal((2, len(T), 3))
    slopes = rng.standard_normal((len(T), 3, 1))
    found = problem(named, values).assemble(predictions(slopes), ["p"], None)
    there = np.ones((2, len(T), 3), dtype=bool)
    there[:, 3, 1] = False
    shape = np.stack([s["gauge"] for s in named.shapes])[there]
    covariance = SIGMA**2 * np.eye(there.sum()) + shape @ np.diag(named.sd**2) @ shape.T
    if instants:
        places = np.argwhere(there)
        for a, (i, k, _) in enumerate(places):
            for b, (j, m, _) in enumerate(places):
                if (i, k) == (j, m):
                    g = own[i]["gauge"][k]
                    covariance[a, b] += g[:, places[a, 2]] @ g[:, places[b, 2]]
    miss = values[there] - shape @ named.mean
    by = -np.broadcast_to(slopes[..., 0], there.shape)[there]
    inverse = np.linalg.inv(covariance)
    assert found.residual @ found.residual == pytest.approx(miss @ inverse @ miss, rel=1e-9)
    assert found.jacobian[:, 0] @ found.residual == pytest.approx(by @ inverse @ miss, rel=1e-9)
    expected = named.mean + np.diag(named.sd**2) @ shape.T @ inverse @ miss
    np.testing.assert_allclose(found.named, expected, rtol=1e-9)


def test_what_is_made_of_errors_and_noise_is_white() -> None:
    """Drawn from the model, rows have the mean square 1, and without the errors they have not."""
    rng = np.random.default_rng(3)
    named = errors()
    draws = named.mean + named.sd * rng.standard_normal((200, 2))
    noise = SIGMA * rng.standard_normal((200, 2, len(T), 3))
    values = np.stack([s["gauge"] for s in named.shapes]) @ draws.T
    misfits = []
    for k in range(200):
        r = problem(named, values[..., k] + noise[k]).assemble(predictions(), [], None).residual
        misfits.append(float(r @ r) / len(r))
    assert np.mean(misfits) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / len(r) / 200))
    plain = problem(named.instant_alone, values[..., 0] + noise[0]).assemble(predictions(), [], None).residual
    assert plain @ plain / len(plain) > 2.0


def test_errors_of_instants_are_as_wide_beyond_coloured_noise() -> None:
    """Whitened by noise that is alike from reading to reading, what is new at each of them is larger. Columns are off
    alike at neighbouring instants, as where a hand is."""
    rng, n, rho = np.random.default_rng(6), 400, 0.9
    t = np.linspace(0.0, 10.0, n)
    own = np.tile(rng.standard_normal(3), (n, 1, 1))
    named = NamedErrors((), ({"gauge": np.zeros((n, 3, 0))},), instant=({"gauge": own},))
    noise = {"gauge": ChannelNoise(np.full(3, SIGMA), np.full(3, rho), "given")}
    misfits = []
    for _ in range(40):
        coloured = SIGMA * rng.standard_normal((n, 3))
        for k in range(1, n):
            coloured[k] = rho * coloured[k - 1] + np.sqrt(1.0 - rho**2) * coloured[k]
        values = coloured + own[:, 0] * rng.standard_normal((n, 1))
        run = Run("run", "", (), {}, (Measured("gauge", "markers", t, values, tuple("uvw")),), 10.0)
        prediction = Prediction({"gauge": np.zeros((n, 3))}, {}, cast(Any, None))
        r = Problem([run], noise, cast(Any, None), named=named).assemble([prediction], [], None).residual
        misfits.append(float(r @ r) / len(r))
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.1)


def test_other_readings_in_sight_are_another_covariance() -> None:
    """A prediction that hides a reading is compared with what is left, and the next one with all again."""
    named, values = errors(), np.random.default_rng(4).standard_normal((2, len(T), 3))
    there, hidden = predictions(), predictions()
    hidden[0].values["gauge"] = np.where(np.arange(len(T))[:, None] > 8, np.nan, 0.0) * np.ones(3)
    one = problem(named, values)
    first, less, again = (one.assemble(p, [], None).residual for p in (there, hidden, there))
    np.testing.assert_array_equal(first, again)
    fresh = problem(named, values).assemble(hidden, [], None).residual
    np.testing.assert_allclose(less, fresh, atol=1e-12)
    assert less @ less < first @ first


def test_sizes_that_readings_show_are_found() -> None:
    named = errors()
    values = np.stack([s["gauge"] for s in named.shapes]) @ np.array([1.1, 3.0])
    given = problem(named, values)
    rows = given.assemble(predictions(), [], None)
    np.testing.assert_allclose(rows.named, [1.1, 3.0], atol=0.05)
    # What the model accounts for is its prediction with the errors of these sizes.
    fitted = cast(Any, SimpleNamespace(predictions=predictions(), named=rows.named))
    for k, run in enumerate(given.runs):
        np.testing.assert_allclose(given.explained(fitted, k, run.measured[0]), values[k], atol=0.2)


def test_a_marginal_without_columns_changes_nothing() -> None:
    rows = np.random.default_rng(5).standard_normal((7, 2))
    out, sizes = Marginal(np.zeros((7, 0)), NamedErrors((), ()))(rows)
    np.testing.assert_array_equal(out, rows)
    assert sizes.shape == (0,)
