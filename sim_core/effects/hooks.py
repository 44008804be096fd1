"""The interfaces through which an effect acts, each with its value and all derivatives that gradients need.

An effect derives from one of them (or from several, where one hypothesis has several places). Methods without a body
are abstract: an effect that lacks one cannot be made, and the registry says which one is missing.

| interface | what it changes | who calls it |
| --- | --- | --- |
| :class:`RigMap` | numbers of the rig: tool pose, gravity, intrinsics | all that reads them |
| :class:`MaterialMap` | numbers of the material of bodies: density, thickness, damping | the same |
| :class:`MechanicsMap` | numbers of terms that a rig has no key for | :meth:`sim_core.scene.scene.Scene.values` |
| :class:`BodyForce` | terms of the incremental potential | :class:`sim_core.scene.scene.Scene` |
| :class:`MaterialLaw` | stress by strain of a sheet or a gel, with memory | :mod:`sim_core.energies.strain_law` |
| :class:`FieldMap` | stiffness from place to place and in time | :mod:`sim_core.energies.grading` |
| :class:`NormalLaw` | contact pressure against the gap | contact terms |
| :class:`FrictionLaw` | the bound of friction | contact terms |
| :class:`CommandMap` | poses to poses, with memory | :mod:`sim_core.commands` |
| :class:`ReadingMap` | readings to readings | :mod:`sysid.model.sensor_streams` |
| :class:`ClockMap` | the instant that a stamp stands for | the same |
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, TypeVar

import numpy as np

from sim_core.core.jets import Jet
from sim_core.core.material import MaterialFormula, PointLayout
from sim_core.core.pointwise import Law
from sim_core.effects.base import Effect, Values

if TYPE_CHECKING:
    from sim_core.energies.term import Term
    from sim_core.rigs import Rig
    from sim_core.scene.scene import Frame, Scene
    from sim_core.scene.scene import Values as SceneValues

__all__ = [
    "Additive",
    "BodyForce",
    "Channel",
    "ClockMap",
    "CommandMap",
    "FrictionLaw",
    "MaterialLaw",
    "MechanicsMap",
    "NormalLaw",
    "Pointwise",
    "ReadingMap",
    "RigMap",
]

Array = np.ndarray

Kind = Literal["wrench", "markers", "tracks"]
"""Of a channel: forces and torques ``(k, 6)``, positions ``(k, n, 3)`` [m], pixels ``(k, n, 2)``."""


class RigMap(Effect):
    """An amendment of numbers that a rig has itself. Derivatives by its parameters and by everything else are those of
    the rig's numbers, which exist already."""

    @abstractmethod
    def amend_rig(self, rig: Rig, targets: tuple[str, ...], values: Values) -> Rig:
        """The rig with its numbers changed; the very same object where the effect vanishes."""


class MaterialMap(RigMap):
    """An amendment of numbers of the material of bodies."""

    @abstractmethod
    def amend_material(self, material: Any, values: Values) -> Mapping[str, float]:
        """New values of some of the numbers of a body's ``material``, by their keys in the rig."""

    def amend_rig(self, rig: Rig, targets: tuple[str, ...], values: Values) -> Rig:
        if self.vanishes(values):
            return rig
        changed = dict(rig.bodies)
        for name in targets:
            material = changed[name].material  # type: ignore[union-attr]
            made = material.model_copy(update=dict(self.amend_material(material, values)))
            changed[name] = changed[name].model_copy(update={"material": made})
        return rig.model_copy(update={"bodies": changed})


class MechanicsMap(Effect):
    """An amendment of the numbers that terms are configured with; the terms know their derivatives by them."""

    @abstractmethod
    def amend_values(self, rig: Rig, targets: tuple[str, ...], found: SceneValues, values: Values) -> None:
        """Change the numbers in place."""


class BodyForce(Effect):
    """Terms of the incremental potential: forces that act on bodies in addition to elasticity, contact and weight.

    A term declares whether it looks at the start of its step or remembers anything
    (:func:`sim_core.energies.term.check_term`); numbers that it is configured with are its own.
    """

    @abstractmethod
    def terms(self, scene: Scene, label: str, targets: tuple[str, ...], values: Values) -> list[Term]:
        """The terms, with names that end with ``.<label>``; none where the effect vanishes."""

    @abstractmethod
    def numbers(self, values: Values) -> Mapping[str, float]:
        """What each of them is configured with, by name."""


Part = Literal["membrane", "bending", "solid"]
"""What of a sheet, or of a gel, a material law amends."""


class MaterialLaw(Effect):
    """An amendment of the constitutive law of a body, with internal state in every element.

    It is one formula (:mod:`sim_core.core.material`) of generalised strains (:mod:`sim_core.energies.strain`), the
    energy of a step and the new internal variables; stress, tangent and all that gradients need are its derivatives.
    The term that hosts it (:mod:`sim_core.energies.strain_law`) does the rest: nodal forces, Hessian, and all
    derivatives by positions, shapes at rest, fields and numbers. Several laws of one body add up.
    """

    parts: ClassVar[tuple[Part, ...]] = ()
    """What it amends of each of its targets."""

    @property
    @abstractmethod
    def formula(self) -> MaterialFormula:
        """Energy per area or volume, and the new internal variables."""

    def state(self) -> Mapping[str, tuple[int, ...]]:
        """Internal variables of one element by name, with their shapes; zero in a virgin body."""
        return {}

    def layout(self, size: int) -> PointLayout:
        """What the formula sees of a point with ``size`` strains."""
        return PointLayout(size, tuple(self.state().items()), tuple(p.name for p in self.parameters))


class FieldMap(Effect):
    """A stiffness that is not the same all over a body, or all the time: a factor on the elastic energy of each
    element, and on its damping and its own memory.

    Places are middles of elements [m] ``(m, 3)`` where the rig has them, in the frame of the body; they stay with the
    material. Masses are as they are.
    """

    parts: ClassVar[tuple[Part, ...]] = ()
    """What it scales of each of its targets."""
    changes: ClassVar[bool] = False
    """Whether it depends on time."""

    @property
    @abstractmethod
    def formula(self) -> Law:
        """The factor, above zero, as a function of the place x, y, z [m], of the time t [s] since the start of the
        rollout, and of parameters of the effect by their names; 1 where the effect vanishes."""

    def factor(self, places: Array, time: float, values: Values) -> Jet:
        """Factors, and their derivatives by all arguments of the formula, ``(m,)`` each."""
        x, y, z = places.T
        return self.formula.at(values, x, y, z, np.asarray(time))

    def factor_by(self, places: Array, time: float, values: Values) -> Mapping[str, Array]:
        """Derivatives of the factors by each parameter ``(m,)``."""
        return dict(zip(self.formula.arguments[4:], self.factor(places, time, values).d[4:], strict=True))


class NormalLaw(Effect):
    """Contact pressure in addition to that which keeps surfaces apart: attraction, a soft layer between them.

    It is one formula, an energy per area; pressure, slope and all that gradients need are its derivatives.
    Friction goes with the pressure that keeps surfaces apart, not with this one, so that attraction adds to the load of
    friction as far as it presses the surfaces together (Derjaguin, Z. Phys. 88, 1934). Gaps may be negative while an
    iteration is on its way; the law must go on there smoothly.

    ``bonds``: it acts at a point from the step after one in which the surfaces have touched there, until they are its
    reach apart. Points of rigid bodies remember that; a law that bonds acts on no other contacts.
    """

    bonds: ClassVar[bool] = False

    @property
    @abstractmethod
    def energy(self) -> Law:
        """Energy [J/m^2] as a function of the gap [m] and of parameters of the effect by their names."""

    @abstractmethod
    def reach(self, values: Values) -> float:
        """Gap [m] from which on it is zero."""


class FrictionLaw(Effect):
    """A factor on the coefficient of friction, in one formula."""

    @property
    @abstractmethod
    def factor(self) -> Law:
        """The factor as a function of pressure [Pa], slip speed [m/s], and parameters of the effect by their names."""


Memory = TypeVar("Memory")


class CommandMap(Effect, Generic[Memory]):
    """What becomes of commanded poses before an end effector is there, with memory. The same code runs along recorded
    poses and step by step in a node.

    Poses are positions [m] ``(3,)`` and rotations in the world. Derivatives by parameters are those of the poses that
    come out, by central differences of the map alone; derivatives by commanded poses are passed back by :meth:`pull`.
    """

    @abstractmethod
    def begin(self, pose: Frame, values: Values) -> Memory:
        """What is remembered where the command has rested at a pose for ever."""

    @abstractmethod
    def advance(self, memory: Memory, pose: Frame, dt: float, values: Values) -> tuple[Memory, Frame]:
        """Where the end effector is after ``dt`` [s], in which the command went to ``pose``, and the new memory."""

    @abstractmethod
    def pull(self, times: Array, poses: Sequence[Frame], weights: Array, values: Values) -> Array:
        """Derivatives of a loss by small motions of the commanded ``poses`` at ``times`` [s] ``(n,)``, ``(n, 6)``: p +
        rho and exp(phi) R, translation [m] and turn [rad] in the world; from those by such motions of the poses that
        come out, ``weights`` ``(n, 6)``."""


@dataclass(frozen=True)
class Channel:
    """One stream of readings. ``stamps`` [s] ``(k,)``: since the start of the rollout; ``since`` [s]: how long the
    sensor had been at work then. ``rig``: with all amendments of its numbers."""

    name: str
    kind: Kind
    stamps: Array
    since: float
    rig: Any


class ReadingMap(Effect):
    """What a sensor makes of the true readings: offsets, gains, filters, distortion, without noise.

    Readings have the channel's shape, ``(k, ...)``; a point that is out of sight is NaN, in sight and out of it.
    """

    @abstractmethod
    def read(self, channel: Channel, readings: Array, values: Values) -> Array:
        """What is reported."""

    @abstractmethod
    def push(self, channel: Channel, readings: Array, change: Array, values: Values) -> Array:
        """Change of what is reported, for changes of the readings ``(k, ..., p)``."""

    @abstractmethod
    def pull(self, channel: Channel, readings: Array, weights: Array, values: Values) -> Array:
        """Derivatives of a loss by the readings, from those by what is reported, ``(k, ...)`` both."""


class Additive(ReadingMap):
    """A sensor that adds something to the readings, whatever they are: derivatives pass it as they are."""

    @abstractmethod
    def added(self, channel: Channel, values: Values) -> Array:
        """What is added, of a shape that fits the readings."""

    def read(self, channel: Channel, readings: Array, values: Values) -> Array:
        return np.asarray(readings + self.added(channel, values))

    def push(self, channel: Channel, readings: Array, change: Array, values: Values) -> Array:
        return change

    def pull(self, channel: Channel, readings: Array, weights: Array, values: Values) -> Array:
        return weights


COMPLEX_STEP = 1e-30
"""Imaginary step of derivatives of analytic functions. Nothing is subtracted, so they are exact to round-off."""


class Pointwise(ReadingMap):
    """A sensor that changes each point by itself: ``(..., m)`` to ``(..., m)``."""

    @abstractmethod
    def point(self, channel: Channel, points: Array, values: Values) -> Array:
        """What is reported of points ``(..., m)``, as an analytic function: it is given complex numbers too."""

    def slope(self, channel: Channel, points: Array, values: Values) -> Array:
        """Its derivative by the points ``(..., m, m)``, by complex steps (Squire & Trapp, SIAM Review 40, 1998)."""
        steps = 1j * COMPLEX_STEP * np.eye(points.shape[-1])
        return np.stack([self.point(channel, points + s, values).imag / COMPLEX_STEP for s in steps], axis=-1)

    def read(self, channel: Channel, readings: Array, values: Values) -> Array:
        return self.point(channel, readings, values)

    def push(self, channel: Channel, readings: Array, change: Array, values: Values) -> Array:
        return np.asarray(np.einsum("...ij,...jp->...ip", self.slope(channel, readings, values), change))

    def pull(self, channel: Channel, readings: Array, weights: Array, values: Values) -> Array:
        return np.asarray(np.einsum("...ij,...i->...j", self.slope(channel, readings, values), weights))


class Linear(Pointwise):
    """A sensor that takes each point to a linear function of it."""

    @abstractmethod
    def matrix(self, channel: Channel, values: Values) -> Array:
        """M of what is reported, M times the point, ``(m, m)``; the identity where the effect vanishes."""

    def point(self, channel: Channel, points: Array, values: Values) -> Array:
        return np.asarray(points @ self.matrix(channel, values).T)

    def slope(self, channel: Channel, points: Array, values: Values) -> Array:
        return self.matrix(channel, values)


class ClockMap(Effect):
    """A clock that is off: a reading stamped t shows the state at another time."""

    @abstractmethod
    def shown_at(self, channel: Channel, values: Values) -> Array:
        """Times [s] ``(k,)`` of the states that readings with the channel's stamps show."""
