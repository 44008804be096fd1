"""What is known of a rig's numbers before anything is recorded, and which of them a baseline adjusts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sim_core.errors import ConfigError
from sim_core.rigs import Gel, Rig, Sheet
from sysid.model.parameters import FitParameter, fit_parameters, start_of
from sysid.settings.diagnosis import DIAGNOSIS


def open_parameters(rig: Rig) -> list[str]:
    """Material parameters and friction coefficients that a baseline fit adjusts."""
    names: list[str] = []
    for name, body in rig.bodies.items():
        if isinstance(body, Sheet):
            names.append(f"{name}.E_pa")
            # A quasi-static pull shows the lateral contraction, motion shows the mass.
            names.append(f"{name}.density_kg_m3" if rig.solver.inertia else f"{name}.nu")
            if rig.solver.inertia and body.material.stiffness_damping_s > 0.0:
                names.append(f"{name}.stiffness_damping_s")
        elif isinstance(body, Gel):
            names += [f"{name}.E_pa", f"{name}.nu"]
    names += [f"contacts.{c.name}.friction" for c in rig.contacts if c.friction > 0.0]
    if not names:
        raise ConfigError("The rig has nothing to adjust.", "A diagnosis needs a sheet or a gel.")
    return [p.name for p in fit_parameters(rig, names)]


def with_known_priors(rig: Rig, parameters: Sequence[FitParameter]) -> list[FitParameter]:
    """The parameters with what is known of each beforehand; of a damping that the rig has, half its value."""
    found = []
    for p, at in zip(parameters, start_of(rig, parameters), strict=True):
        quantity = p.target.rsplit(".", 1)[1]
        sd = (
            DIAGNOSIS.known_damping_share * at
            if quantity == "stiffness_damping_s" and at > 0.0
            else DIAGNOSIS.known_sd.get(quantity, p.prior_sd)
        )
        found.append(p if p.pulled else replace(p, known_sd=float(sd)))
    return found
