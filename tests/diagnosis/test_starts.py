"""Where refits begin."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.effects import effect_by_name
from sysid.diagnosis import starts
from sysid.diagnosis.candidates import Hypothesis
from sysid.diagnosis.starts import Start
from sysid.model.parameters import fit_parameters, start_of
from sysid.solve.optimum import Fitted


def hypothesis(name: str) -> Hypothesis:
    return Hypothesis(name, effect_by_name(name), {}, ())


def test_a_refit_begins_at_the_numbers_of_the_rig_where_they_explain_more(small_rig, monkeypatch) -> None:
    """The baseline has bent a modulus; where a start goes beside no other effect, the rig's own is tried too."""
    rig = small_rig()
    parameters = fit_parameters(rig, ["gel.E_pa"])
    own = start_of(rig, parameters)
    begun = cast(Fitted, SimpleNamespace(centre=rig, parameters=parameters, scaled=own + 0.3))
    bent, straight = (Start((hypothesis(n),), (np.ones(1),), np.zeros(1)) for n in ("air_drag", "gel_relaxation"))
    left = {("air_drag", False): 5.0, ("air_drag", True): 2.0}
    left |= {("gel_relaxation", False): 3.0, ("gel_relaxation", True): 9.0}

    def simulated(base, begun, starts, scales, lost):
        at_home = [(s, bool(np.allclose(begun.scaled + s.shift, own))) for s in starts]
        return [(left[(s.hypotheses[0].effect.name, home)], s) for s, home in at_home]

    monkeypatch.setattr(starts, "_simulated", simulated)
    found = starts.best_starts(cast(Any, None), begun, [bent, straight], cast(Any, None), {})
    assert [(set(s.names), float(s.shift[0])) for s in found] == [
        ({"air_drag"}, pytest.approx(-0.3)), ({"gel_relaxation"}, 0.0),
    ]  # fmt: skip
    beside = replace(bent, earlier=(hypothesis("gel_relaxation"),))
    assert starts.best_starts(cast(Any, None), begun, [beside], cast(Any, None), {}) == [beside]


def test_the_best_set_is_refitted_from_two_shapes(small_rig, monkeypatch) -> None:
    rig = small_rig()
    parameters = fit_parameters(rig, ["gel.E_pa"])
    begun = cast(Fitted, SimpleNamespace(centre=rig, parameters=parameters, scaled=start_of(rig, parameters)))
    names = ("gel_relaxation", "gel_relaxation", "gel_relaxation", "air_drag", "stream_delay", "camera_drift")
    left = dict(enumerate((4.0, 2.0, 3.0, 5.0, 6.0, 7.0)))
    wanted = [
        Start((replace(hypothesis(n), shape={"tau_s": float(k)}),), (np.ones(1),), np.zeros(1))
        for k, n in enumerate(names)
    ]

    def simulated(base, begun, starts, scales, lost):
        return [(left[int(s.hypotheses[0].shape["tau_s"])], s) for s in starts]

    monkeypatch.setattr(starts, "_simulated", simulated)
    found = starts.best_starts(cast(Any, None), begun, wanted, cast(Any, None), {})
    assert [s.hypotheses[0].shape["tau_s"] for s in found] == [1.0, 2.0, 3.0, 4.0]
