"""The baseline: which parameters of a rig a diagnosis leaves open."""

from __future__ import annotations

from sim_core.errors import ConfigError
from sim_core.rigs import Gel, Rig, Sheet
from sysid.model.parameters import fit_parameters


def open_parameters(rig: Rig) -> list[str]:
    """Material parameters and friction coefficients that a baseline fit adjusts."""
    names: list[str] = []
    for name, body in rig.bodies.items():
        if isinstance(body, Sheet):
            names.append(f"{name}.E_pa")
            # A quasi-static pull shows the lateral contraction, motion shows the mass.
            names.append(f"{name}.density_kg_m3" if rig.solver.inertia else f"{name}.nu")
        elif isinstance(body, Gel):
            names += [f"{name}.E_pa", f"{name}.nu"]
    names += [f"contacts.{c.name}.friction" for c in rig.contacts if c.friction > 0.0]
    if not names:
        raise ConfigError("The rig has nothing to adjust.", "A diagnosis needs a sheet or a gel.")
    return [p.name for p in fit_parameters(rig, names)]
