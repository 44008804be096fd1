"""One fit of a diagnosis: what it is asked, and what becomes of one that was interrupted."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sysid.diagnosis.fits import fit_within
from sysid.settings.diagnosis import DIAGNOSIS


@pytest.mark.parametrize("interrupted", [False, True])
def test_half_a_fit_is_no_answer(interrupted: bool) -> None:
    ended = SimpleNamespace(interrupted=interrupted)

    def fit(rig: Any, parameters: Any, start: np.ndarray, *, max_evaluations: int, tolerance: float) -> Any:
        assert (parameters, max_evaluations, tolerance) == ([], 7, DIAGNOSIS.fit_tolerance)
        return ended

    problem = cast(Any, SimpleNamespace(fit=fit))
    if interrupted:
        with pytest.raises(KeyboardInterrupt):
            fit_within(problem, 7, cast(Any, None), (), np.zeros(0))
    else:
        assert fit_within(problem, 7, cast(Any, None), (), np.zeros(0)) is ended
