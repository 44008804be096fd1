"""What is left of a simulation at a start when the parameters of the baseline may move, against its closed form."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sysid.diagnosis.refits import worse_there
from sysid.diagnosis.starts import _least
from sysid.fit.result import ChannelError


def baseline(jacobian: np.ndarray, known: list[float]) -> Any:
    """A fitted model with these derivatives, and as many rows of priors."""
    count = jacobian.shape[1]
    parameters = [SimpleNamespace(known_sd=sd, prior_sd=9.0) for sd in known]
    rows = np.vstack([jacobian, np.diag(1.0 / np.array(known))])
    return cast(Any, SimpleNamespace(parameters=parameters, jacobian=rows, residual=np.zeros(len(rows)), pulls=count))


def test_what_the_parameters_can_take_up_does_not_count() -> None:
    rng = np.random.default_rng(0)
    j = rng.standard_normal((50, 2))
    apart = rng.standard_normal(50)
    apart -= j @ np.linalg.lstsq(j, apart, rcond=None)[0]
    model = baseline(j, [1e6, 1e6])
    assert _least(model, apart + j @ [3.0, -2.0]) == pytest.approx(float(apart @ apart), rel=1e-9)


def test_what_is_known_of_parameters_limits_what_they_take_up() -> None:
    """min over d of (r - d)^2 + (d / s)^2 is r^2 / (1 + s^2)."""
    model = baseline(np.ones((1, 1)), [0.5])
    assert _least(model, np.array([4.0])) == pytest.approx(16.0 / 1.25, rel=1e-12)
    assert _least(model, np.array([4.0, 1.0])) == 17.0, "other readings are in sight"


def error(quantity: str, before: float, after: float, own: float = 0.0) -> ChannelError:
    return ChannelError("later", "gauge", quantity, "N", before, after, 0.01, True, 0.01, own)


@pytest.mark.parametrize(
    ("errors", "said"),
    [
        ([error("force", 0.02, 0.015), error("torque", 0.02, 0.021)], ""),  # by 5 %
        ([error("force", 0.010, 0.013)], ""),  # by less than the noise
        ([error("force", 0.02, 0.05, own=0.2)], ""),  # by less than half the error of the mesh
        ([error("force", 0.02, 0.03), error("torque", 0.02, 0.04)], "the torque of gauge in later, 0.02 -> 0.04 N"),
    ],
)
def test_what_is_predicted_worse_is_told(
    monkeypatch: pytest.MonkeyPatch, errors: list[ChannelError], said: str
) -> None:
    monkeypatch.setattr("sysid.diagnosis.refits.rms_errors", lambda *given, **named: errors)
    monkeypatch.setattr("sysid.diagnosis.refits.error_sizes", lambda problem: {})
    base = cast(Any, SimpleNamespace(there=object(), check=None, problem=None))
    assert worse_there(base, cast(Any, object())) == said
