"""Faults of recordings, and too few readings, are said before the values of a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sysid.fit.doubts import FEW, doubts
from sysid.fit.runs import Measured, Run


def run_of(instants: int, *faults: str) -> Run:
    """A recording with so many instants of one reading, and one more without any."""
    t = np.linspace(0.0, 1.0, instants + 1)
    values = np.append(np.zeros(instants), np.nan)[:, None]
    return Run("press", "press", (), {}, (Measured("gauge", "wrench", t, values, ("force z",)),), 1.0, doubts=faults)


def test_a_recording_without_faults_gives_no_doubt() -> None:
    assert doubts([run_of(FEW)]) == []


@pytest.mark.parametrize(("faults", "said"), [(1, "1 fault that"), (5, "5 faults that")])
def test_faults_are_said_and_counted(faults: int, said: str) -> None:
    (sentence,) = doubts([run_of(FEW, *(f"/wrench: fault {k}" for k in range(faults)))])
    assert sentence.startswith(f"press was read with {said} may change the result: /wrench: fault 0")
    assert ("and 2 more, in the notes" in sentence) == (faults == 5)


def test_few_instants_of_all_recordings_together_are_said() -> None:
    assert "readings of 4 instants only" in doubts([run_of(2), replace(run_of(2), name="other")])[0]
    assert doubts([run_of(FEW // 2), run_of(FEW // 2)]) == []
