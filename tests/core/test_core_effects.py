"""Which effects the compiled core covers."""

from __future__ import annotations

import pytest
from strip_over_table import strip_rig
from test_core_gels import gel_rig

from sim_core.core.covers import covers
from sim_core.effects import all_effects
from sim_core.effects.hooks import BodyForce, FieldMap, FrictionLaw, MaterialLaw, MechanicsMap, NormalLaw
from sim_core.scene import build_scene

MECHANICAL = [
    n
    for n, e in all_effects().items()
    if isinstance(e, BodyForce | FieldMap | FrictionLaw | MaterialLaw | MechanicsMap | NormalLaw)
]


@pytest.mark.parametrize("name", MECHANICAL)
def test_an_effect_is_covered_or_a_sentence_says_why_not(name):
    effect = all_effects()[name]
    rigs = [make() for make in (strip_rig, gel_rig)]
    acting = [rig for rig in rigs if effect.targets(rig)]
    assert acting
    for rig in acting:
        reason = covers(build_scene(rig.model_copy(update={"effects": {name: dict(effect.example)}})))
        assert reason is None
