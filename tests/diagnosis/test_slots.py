"""Places of the model where physics may hide."""

from __future__ import annotations

from collections.abc import Callable

from sim_core.rigs import Rig
from sysid.diagnosis.slots import mechanical_slots


def test_every_body_contact_and_hand_is_a_place(small_rig: Callable[..., Rig]) -> None:
    places = {(s.place, s.name) for s, _ in mechanical_slots(small_rig())}
    assert {("gel", "gel"), ("sheet", "card"), ("robot", "finger"), ("contact", "gel-card")} <= places
