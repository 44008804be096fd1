"""Steps that run into contact are made in part."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.solve.contact_step_limit import contact_share


def test_a_step_into_a_hard_stop_ends_near_it():
    """A spring pulls by 1 (energy 1/2 (x - 1)^2 from x = 0), and from x = 0.4 on a stop of stiffness 1e3 resists:
    balance is at x - 1 + 1e3 (x - 0.4) = 0."""
    seen = []

    def along(share):
        seen.append(share)
        return 1e3 * max(0.0, share - 0.4)

    share, tries = contact_share(along, before=-1.0)
    assert tries == len(seen)
    residual = share - 1.0 + along(share)
    assert abs(residual) <= 0.3
    assert share == pytest.approx(401.0 / 1001.0, abs=0.3 / 1001.0)


@pytest.mark.parametrize("stiffness", [0.0, 5.0, 1e4])
def test_contact_that_answers_as_linearised_ends_nothing(stiffness):
    """What the tangent knew of is no surprise, however stiff it is."""
    assert contact_share(lambda share: 3.0 + stiffness * share, before=-1.0)[0] == 1.0


def test_contact_that_lets_go_ends_nothing():
    assert contact_share(lambda share: 2.0 * np.exp(-5.0 * share), before=-1.0)[0] == 1.0
