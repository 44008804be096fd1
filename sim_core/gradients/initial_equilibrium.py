"""The way to the first equilibrium, linearised.

An equilibrium in which nothing remembers does not depend on how it was found. Where points rub or sheets flow while
bodies settle it does, and all steps of settling are differentiated, each of which begins at rest, from where the mounts
put the bodies.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace

from sim_core.gradients.step import LinearStep
from sim_core.gradients.step_record import Made
from sim_core.scene.scene import Frame, Scene
from sim_core.simulate import Settling
from sim_core.solve.hessian_store import Keeper
from sim_core.solve.system import System


def linearised(
    scene: Scene, keeper: Keeper, settling: Sequence[Settling], frames: Mapping[str, Frame], backwards: bool
) -> Iterator[tuple[Made, LinearStep]]:
    """The steps of settling that the equilibrium depends on, in the order in which they were made or ``backwards``.
    While one is there the system holds its end, and has inertia if the step had."""

    def entered(step: Settling) -> tuple[Made, LinearStep]:
        made = Made(step.before, step.after, step.dt, frames, step.unknowns)
        made.enter(scene)
        linear = LinearStep(scene, keeper, made.before, made.after, made.dt)
        return replace(made, linear=linear), linear

    *others, last = settling
    with with_inertia(scene.system, last.inertia):
        found = entered(last)
        if backwards or not found[1].remembers:
            yield found
    if found[1].remembers:
        for step in reversed(others) if backwards else settling:
            with with_inertia(scene.system, step.inertia):
                yield entered(step)


@contextmanager
def with_inertia(system: System, inertia: bool) -> Iterator[None]:
    """Let a system have inertia or not for a while."""
    given = system.inertia
    try:
        system.inertia = inertia
        yield
    finally:
        system.inertia = given
