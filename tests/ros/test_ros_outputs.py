"""When the simulator publishes what it holds back."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("gives_clock", "running", "held", "due_s"),
    [
        (False, True, [], math.inf),
        (False, True, [7.02, 7.5], 0.02),
        (False, True, [6.0], 0.001),  # late: at once, but not without a pause
        (True, False, [], math.inf),
        (True, True, [], 0.005),
        (True, True, [7.002], 0.002),
    ],
)
def test_it_wakes_when_something_is_due(
    ros: None, gives_clock: bool, running: bool, held: list[float], due_s: float
) -> None:
    from thinshell_ros.outputs import Outputs

    class Bare(Outputs):
        def __init__(self) -> None:
            self._clock = SimpleNamespace() if gives_clock else None
            self._held: list[Any] = [(due, number, None) for number, due in enumerate(held)]

    assert Bare().due_in_s(7.0, running) == pytest.approx(due_s)
