"""Loads of a rig: forces, weights, tractions and pressures on parts of bodies, constant or by a table of times."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from sim_core.rigs.fields import Name, NonNegative, Real, Strict, Text, of_length, trouble
from sim_core.rigs.regions import Region

ForceComponent = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]
Force = Annotated[tuple[ForceComponent, ForceComponent, ForceComponent], of_length(3)]
StressComponent = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e10, le=1e10)]
Stress = Annotated[tuple[StressComponent, StressComponent, StressComponent], of_length(3)]
Mass = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=1e5)]


class _Load(Strict):
    """What all loads have. ``times_s`` and ``values``: the load is what its number says times the value at the end of
    each time step, linear between the times and held beyond them."""

    number: ClassVar[str] = ""

    name: Name = Field(description="name of the load, by which its numbers are set and fitted")
    body: Name = Field(description="the body that is loaded")
    region: Region = Field(
        default=Region(), description="box in the body's local rest coordinates; left out: all of the body's surface"
    )
    face: Text | None = Field(default=None, description="face of a gel on which it acts, within the region")
    times_s: tuple[NonNegative, ...] = Field(
        default=(), description="times since the start of the motion; left out: the load is constant"
    )
    values: tuple[Real, ...] = Field(default=(), description="what the load is multiplied by at these times")

    @model_validator(mode="after")
    def _table(self) -> _Load:
        if len(self.times_s) != len(self.values):
            raise trouble(
                f"has {len(self.times_s)} times and {len(self.values)} values.",
                "Give 'times_s' and 'values' of the same length, or neither.",
                "values" if self.times_s else "times_s",
            )
        steps = np.diff(self.times_s)
        if (steps <= 0.0).any():
            k = int(np.argmax(steps <= 0.0))
            raise trouble(
                f"has {self.times_s[k + 1]:g} s after {self.times_s[k]:g} s.", "Let times increase.", "times_s", k + 1
            )
        return self


class ForceLoad(_Load):
    """A dead force: its direction does not follow the body. It is spread evenly over the area of the elements inside
    the region; of a sheet in which the region holds no whole triangle, over the length of the edges inside, or over the
    nodes."""

    number: ClassVar[str] = "force_n"

    type: Literal["force"] = Field(description="`force`, `weight`, `traction` or `pressure`")
    force_n: Force = Field(description="components of the whole force along x, y, z of the base frame")


class WeightLoad(_Load):
    """A dead weight: the force of gravity on a mass that hangs from the region, without its inertia. It is spread as a
    force is."""

    number: ClassVar[str] = "mass_kg"

    type: Literal["weight"] = Field(description="`force`, `weight`, `traction` or `pressure`")
    mass_kg: Mass = Field(description="mass that hangs from the region")


class TractionLoad(_Load):
    """A dead force per area of the body as the rig draws it. It acts on whole elements inside the region: triangles of
    a sheet or an affine body, faces of a gel."""

    number: ClassVar[str] = "traction_pa"

    type: Literal["traction"] = Field(description="`force`, `weight`, `traction` or `pressure`")
    traction_pa: Stress = Field(description="components of the force per area along x, y, z of the base frame")


class PressureLoad(_Load):
    """A pressure that follows the surface: normal to it and per area as they are now. It pushes a sheet along its
    normal (local +z at rest), and a gel inwards. It acts on whole elements inside the region."""

    number: ClassVar[str] = "pressure_pa"

    type: Literal["pressure"] = Field(description="`force`, `weight`, `traction` or `pressure`")
    pressure_pa: StressComponent = Field(description="pressure, of a sheet that below it less that above it")


Load = Annotated[ForceLoad | WeightLoad | TractionLoad | PressureLoad, Field(discriminator="type")]
