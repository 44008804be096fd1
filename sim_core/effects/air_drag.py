"""Air drag on a sheet: pressure against its normal motion, quadratic in speed (:mod:`sim_core.energies.air_drag`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import BodyForce
from sim_core.effects.scopes import SHEETS, Scope

if TYPE_CHECKING:
    from sim_core.energies.term import Term
    from sim_core.scene.scene import Scene


class AirDrag(BodyForce):
    """Quadratic drag against the normal motion of sheets."""

    name = "air_drag"
    title = "air resists the sheet"
    words = "Air brakes the sheet's fast motion, with a force proportional to the square of its speed."
    signature = "The simulated sheet moves too far and too long in fast phases, and agrees in slow ones."
    source = "Hoerner, Fluid-Dynamic Drag, 1965, ch. 3 (flat plates)"
    slot = "air"
    follows = "environment"
    passive = True
    scope = Scope("a sheet, and a solver with inertia", lambda rig: SHEETS.names(rig) if rig.solver.inertia else ())
    twins = ("viscoelastic_sheet",)
    separated_by = "A slow and a fast run of the same motion: drag goes with the square of the speed."
    parameters = (
        EffectParameter("drag_coefficient", "-", 0.0, 20.0, (1.0,), 0.0, False, 1.0, "C_D on the sheet's area"),
    )
    example = {"drag_coefficient": 1.0}

    def numbers(self, values: Values) -> Mapping[str, float]:
        return {"drag_coefficient": values["drag_coefficient"]}

    def terms(self, scene: Scene, label: str, targets: tuple[str, ...], values: Values) -> list[Term]:
        if values["drag_coefficient"] == 0.0:
            return []
        from sim_core.energies.air_drag import AirDragTerm
        from sim_core.geometry.sheets import SheetMesh

        found: list[Term] = []
        for name in targets:
            body = scene.bodies[name]
            assert isinstance(body.mesh, SheetMesh)
            found.append(AirDragTerm(f"{name}.{label}", body.mesh.triangles + int(body.nodes[0]), body.mesh.areas))
        return found
