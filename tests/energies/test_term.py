"""Terms that lack a derivative are refused before anything is simulated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from shell_terms import X_AXIS, strip

from sim_core.energies import air_drag
from sim_core.energies.membrane import Membrane
from sim_core.energies.term import check_term
from sim_core.rigs import Rig
from sim_core.scene import build_scene


class Draggy(air_drag.AirDragTerm):
    """The drag of air without its derivative by the start of the step, or by areas."""

    linearise: Any = None


class Shapeless(air_drag.AirDragTerm):
    by_areas: Any = None


class Forgetful(Membrane):
    linearise: Any = None

    def initial_internals(self) -> dict[str, np.ndarray]:
        return {"memory": np.zeros(1)}


class Silent(air_drag.AirDragTerm):
    measured_at_rest: Any = None


def drag(kind: type[air_drag.AirDragTerm]) -> air_drag.AirDragTerm:
    mesh = strip("regular", (2, 1))
    return kind("card.other_name", mesh.triangles, mesh.areas)


def membrane(kind: type[Membrane]) -> Membrane:
    mesh = strip("regular", (2, 1))
    return kind("sheet", mesh.nodes, mesh.triangles, X_AXIS)


def half_dynamic() -> Any:
    class Half(Membrane):
        def prepare(self, *given: Any) -> bool:
            return False

    return membrane(Half)


@pytest.mark.parametrize(
    ("term", "said"),
    [
        (lambda: drag(Draggy), r"card.other_name \(Draggy\) depends on the start of its step .* no method linearise"),
        (lambda: membrane(Forgetful), r"sheet \(Forgetful\) .* no method linearise"),
        (lambda: drag(Shapeless), r"\(Shapeless\) is measured at rest and has no derivative by the shape at rest"),
        (lambda: drag(Silent), r"\(Silent\) does not say whether its forces depend on the shape at rest"),
        (half_dynamic, r"\(Half\) has a part of DynamicTerm and lacks .*recouple"),
    ],
    ids=["start of the step", "memory", "shape", "undeclared", "half a capability"],
)
def test_what_lacks_a_derivative_is_refused(term: Callable[[], Any], said: str) -> None:
    with pytest.raises(TypeError, match=said):
        check_term(term())


def test_a_scene_with_such_a_term_is_not_built(monkeypatch: pytest.MonkeyPatch, small_rig: Callable[..., Rig]) -> None:
    monkeypatch.delattr(air_drag.AirDragTerm, "linearise")
    with pytest.raises(TypeError, match=r"AirDragTerm.*no method linearise"):
        build_scene(small_rig(effects={"air_drag": {"drag_coefficient": 1.0}}))


def test_complete_terms_pass() -> None:
    check_term(drag(air_drag.AirDragTerm))
    check_term(membrane(Membrane))
