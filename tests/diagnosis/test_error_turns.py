"""A fit and the error of the mesh where it stands, in turns, on a model whose error is known in closed form."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sysid.diagnosis import error_turns
from sysid.diagnosis.error_turns import settled
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.named_errors import NamedError, NamedErrors

TRUE, CURVATURE, SD = 1.0, 0.05, 1e-3
COLUMNS = (NamedError("poses", "direction 1", 0.0, 1.0), NamedError("mesh", "mesh", 1.0, 0.5))


class Toy:
    """A reading at theta = 1 of y = theta, which a coarse mesh sees as theta - c theta^3: its error is c theta^3, and
    with an error that was measured at theta' the fit stands where theta - c theta^3 + c theta'^3 = 1."""

    def __init__(self, error_at: float, engine: Any, log: list[str]) -> None:
        shape = np.array([[7.0, CURVATURE * error_at**3]])[:, None, :]
        refined = (ErrorShape("mesh", ({"wrist": shape[..., 1]},)),)
        self.named: Any = NamedErrors(COLUMNS, ({"wrist": shape},), refined)
        self.engine, self.runs, self.log = engine, [SimpleNamespace(name="rec_01")], log

    def with_named(self, named: NamedErrors) -> Toy:
        found = Toy(0.0, self.engine, self.log)
        found.named = named
        return found


def stood(theta: float) -> Any:
    return SimpleNamespace(parameters=[], scaled=np.array([theta]), centre="rig", converged=True, message="")


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> Toy:
    log: list[str] = []

    def standing(coarse: Any, reference: Any, rigs: Any, runs: Any, own: Any) -> Any:
        theta = own[0]
        if theta > 5.0:
            raise ConvergenceError("The finer mesh does not converge.", "")
        log.append(f"measured at {theta:.6f}, reference {reference}")
        shape = ErrorShape("mesh", ({"wrist": np.array([[CURVATURE * theta**3]])},))
        added = SimpleNamespace(coarse=coarse, name="with what the reference adds there")
        return SimpleNamespace(refined=[shape], engine=added)

    def fit_within(problem: Any, evaluations: int, rig: Any, parameters: Any, start: np.ndarray) -> Any:
        other, error = problem.named.shapes[0]["wrist"][0, 0]
        assert other == 7.0, "errors of other owners stay"
        roots = np.roots([-CURVATURE, 0.0, 1.0, error - TRUE])
        real = roots[np.abs(roots.imag) < 1e-9].real
        return stood(float(real[np.argmin(np.abs(real - TRUE))]))

    monkeypatch.setattr(error_turns, "standing", standing)
    monkeypatch.setattr(error_turns, "fit_within", fit_within)
    monkeypatch.setattr(error_turns, "rig_in", lambda rig, parameters, scaled, name: float(scaled[0]))
    monkeypatch.setattr(error_turns, "uncertainty", lambda fitted: SimpleNamespace(sd=np.array([SD])))
    coarse = SimpleNamespace(submit=lambda rig, run: SimpleNamespace(result=lambda: rig))
    return Toy(0.8, SimpleNamespace(coarse=coarse, name="plain"), log)


def test_turns_end_where_the_error_is_that_of_the_fit(toy: Toy) -> None:
    """With the error of a place apart the fit is off by far more than its standard deviation, and in the end by less
    than one."""
    first = error_turns.fitted_on(cast(Any, toy), stood(0.8))
    assert abs(first.scaled[0] - TRUE) > 20.0 * SD
    problem, fitted, at = settled(cast(Any, toy), first, cast(Any, "finer cells"), np.array([0.8]))
    assert at is not None and abs(fitted.scaled[0] - at[0]) <= SD
    assert fitted.scaled[0] == pytest.approx(TRUE, abs=SD)
    assert cast(Any, problem.engine).name == "with what the reference adds there"
    assert problem.named is not None
    np.testing.assert_allclose(problem.named.shapes[0]["wrist"][0, 0], [7.0, CURVATURE * at[0] ** 3])
    assert toy.log[0] == f"measured at {first.scaled[0]:.6f}, reference finer cells"


def test_what_was_measured_where_it_stands_is_not_measured_again(toy: Toy) -> None:
    near = stood(0.8 + 0.5 * SD)
    at = np.array([0.8])
    assert settled(cast(Any, toy), near, None, at) == (toy, near, at) and not toy.log
    _, _, again = settled(cast(Any, toy), near, None, None, rounds=1)
    assert len(toy.log) == 1 and again == near.scaled


def test_turns_end_where_they_come_no_closer(toy: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    stands = iter([0.9, 0.7, 0.95])
    monkeypatch.setattr(error_turns, "fit_within", lambda *given: stood(next(stands)))
    _, fitted, at = settled(cast(Any, toy), stood(0.5), None, np.array([0.0]))
    assert at is not None and fitted.scaled == [0.95] and len(toy.log) == 3, "by 0.5, 0.4, 0.2, and 0.25"
    assert at == [0.7]


def test_an_error_that_cannot_be_measured_is_said(toy: Toy) -> None:
    far, at = stood(6.0), np.array([0.8])
    problem, fitted, measured_at = settled(cast(Any, toy), far, None, at)
    assert cast(Any, problem) is toy and fitted is far and measured_at is at and not fitted.converged
    assert "its discretisation error is not known" in fitted.message and "does not converge" in fitted.message
