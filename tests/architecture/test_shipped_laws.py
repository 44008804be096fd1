"""What a wheel holds: the laws of all effects of the package, so that rollouts need no compiler."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from sim_core import shipped_laws
from sim_core.core import material, pointwise
from sim_core.core.lowering import Function
from sim_core.core.material import MaterialFormula
from sim_core.core.pointwise import Law
from sim_core.core.record import record_values
from sim_core.core.slopes import NumberSlopes
from sim_core.effects import all_effects
from sim_core.rigs import Rig
from sim_core.scene import build_scene
from sim_core.solve.report import NewtonSettings


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Iterator[set[tuple[str, str]]]:
    """Names and sources of the laws that are asked for; none is compiled."""
    found: set[tuple[str, str]] = set()

    def noted(law: Function, laws: str, main: str, *given: Any) -> None:
        found.add((law.name, main))

    for module in (pointwise, material):
        monkeypatch.setattr(module, "compiled", noted)
    every = [law for effect in all_effects().values() for law in laws_of(effect)]
    for law in every:
        if isinstance(law, Law):
            monkeypatch.delitem(vars(law), "_evaluate", raising=False)
        else:
            monkeypatch.setattr(law, "_at", law._compile)
    yield found
    for law in every:
        vars(law).pop("_evaluate", None)


def laws_of(effect: object) -> list[Law | MaterialFormula]:
    own = [getattr(effect, name, None) for name in dir(type(effect))]
    return [law for law in own if isinstance(law, Law | MaterialFormula)]


@pytest.mark.parametrize("name", [name for name, effect in all_effects().items() if laws_of(effect)])
def test_laws_that_are_shipped_are_those_that_a_rig_needs(
    name: str, asked: set[tuple[str, str]], small_rig: Callable[..., Rig]
) -> None:
    """Of an effect on another rig."""
    assert name in list(shipped_laws.shipped())
    shipped_laws.compile_laws(name)
    shipped = set(asked)
    own = {law._function.__name__ for law in laws_of(all_effects()[name])}
    assert own <= {law for law, _ in shipped}
    asked.clear()
    for law in laws_of(all_effects()[name]):
        vars(law).pop("_evaluate", None)
    scene = build_scene(small_rig(effects={name: dict(all_effects()[name].example)}))
    record_values(scene, NewtonSettings(), np.empty(0, dtype=int), NumberSlopes(), 0)
    assert asked and asked <= shipped
