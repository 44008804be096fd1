"""From live topics to fitted parameters: a session recorded from the simulator node is fitted."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ros_live import RIG

from sim_core.errors import RecordingError
from sim_core.rigs import Rig, load_rig, with_parameters
from sysid.fit import fit_runs
from sysid.model.load import load_run
from sysid.observations.observations import Run

pytestmark = pytest.mark.ros

RECORDINGS = 3
"""Presses that are recorded at most."""


@pytest.mark.slow
def test_a_recorded_session_gives_back_the_gel(record_press: Callable[[Path], dict[str, int]], tmp_path: Path) -> None:
    """The rig is coarse, for real time: its mesh error is 17 times the noise, and the interval has that in it. How
    wide it is depends on when the messages came; it must tell the truth from where the fit began."""
    rig = load_rig(RIG)
    wrong = with_parameters(rig, {"pad.E_pa": 2.9e5})
    result, _ = fit_runs(wrong, [_recorded(wrong, record_press, tmp_path)], ["pad.E"])
    (stiffness,) = result.estimates
    assert stiffness.ci95[1] < 2.9e5
    assert abs(np.log(stiffness.value / 2.0e5)) < min(0.1, 3.0 * stiffness.sd)


def _recorded(rig: Rig, record_press: Callable[[Path], dict[str, int]], folder: Path) -> Run:
    """A recording of a press; where the machine stood still for over a second meanwhile, of which the reader tells a
    gap, the press is recorded again."""
    for attempt in range(RECORDINGS):
        bag = folder / f"press_{attempt}"
        record_press(bag)
        try:
            return load_run(rig, bag)
        except RecordingError as error:
            if "has a gap" not in str(error) or attempt == RECORDINGS - 1:
                raise
    raise AssertionError
