"""Offset of the tool: an end effector is not quite where its poses say, by a constant shift and turn in its own frame.

T_true = T_nominal * (rho, exp phi)    (:class:`sim_core.rigs.pose_offset.Displaced`)
"""

from __future__ import annotations

from sim_core.effects.base import EffectParameter, Nuisance, Values
from sim_core.effects.hooks import RigMap
from sim_core.effects.scopes import END_EFFECTORS
from sim_core.rigs import Rig
from sim_core.rigs.pose_offset import OFFSETS

OWN = ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")


class ToolOffset(RigMap):
    """A tool that is mounted a little askew."""

    name = "tool_offset"
    title = "the tool is mounted askew"
    words = (
        "The tool is not quite where the robot takes it to be: it is shifted and turned by a constant amount in the "
        "frame of the end effector."
    )
    signature = "Contact begins too early or too late by the same depth everywhere, and loads lean to one side."
    source = "REP 103 (axes); rigid-body transform"
    slot = "robot"
    follows = "robot"
    passive = True
    scope = END_EFFECTORS
    twins = ("end_effector_compliance",)
    separated_by = "Presses to several depths: an offset is the same at all of them, a compliance grows with force."
    parameters = (
        *(EffectParameter(f"{a}_m", "m", -0.1, 0.1, (5e-4,), 0.0, False, 1e-3, f"shift along {a}") for a in "xyz"),
        *(EffectParameter(f"r{a}_deg", "deg", -45.0, 45.0, (0.5,), 0.0, False, 1.0, f"turn about {a}") for a in "xyz"),
    )
    example = {"x_m": 0.0003, "y_m": -0.0002, "z_m": -0.0004, "rx_deg": 0.4, "ry_deg": -0.3, "rz_deg": 0.2}

    def nuisances(self, rig: Rig) -> tuple[Nuisance, ...]:
        """As far as the rig says that the offset is not known."""
        return tuple(
            Nuisance("pose", name, f"{name}.{key}", sd, (own,))
            for name, known in rig.end_effectors.items()
            for key, own, sd in zip(OFFSETS, OWN, (*known.offset_sd_m, *known.offset_sd_deg), strict=True)
        )

    def amend_rig(self, rig: Rig, targets: tuple[str, ...], values: Values) -> Rig:
        if self.vanishes(values):
            return rig
        moved = dict(rig.end_effectors)
        for name in targets:
            before = moved[name]
            shifted = {key: getattr(before, key) + values[own] for key, own in zip(OFFSETS, OWN, strict=True)}
            moved[name] = before.model_copy(update=shifted)
        return rig.model_copy(update={"end_effectors": moved})
