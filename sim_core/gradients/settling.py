"""The way to the first equilibrium, linearised.

An equilibrium in which nothing remembers does not depend on how it was found. Where points rub or sheets flow while
bodies settle it does, and all steps of settling are differentiated, each of which begins at rest, from where the mounts
put the bodies.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from sim_core.gradients.step import LinearStep
from sim_core.gradients.tape import Made
from sim_core.scene.scene import Frame, Scene
from sim_core.simulate import Settling
from sim_core.solve.stiffness import Keeper


def linearised(
    scene: Scene, keeper: Keeper, settling: Sequence[Settling], frames: Mapping[str, Frame], backwards: bool
) -> Iterator[tuple[Made, LinearStep]]:
    """The steps of settling that the equilibrium depends on, in the order in which they were made or ``backwards``.
    While one is there the system holds its end, and has inertia if the step had."""
    system = scene.system
    inertia = system.inertia
    steps = [(Made(s.before, s.after, s.dt, frames, s.unknowns), s.inertia) for s in settling]
    try:
        made, system.inertia = steps[-1]
        made.enter(scene)
        linear = LinearStep(scene, keeper, made.before, made.after, made.dt)
        if backwards or not linear.remembers:
            yield made, linear
        if not linear.remembers:
            return
        for made, system.inertia in reversed(steps[:-1]) if backwards else steps:
            made.enter(scene)
            yield made, LinearStep(scene, keeper, made.before, made.after, made.dt)
    finally:
        system.inertia = inertia
