"""What a task file may say: a rig, the hands that act on it, what is observed, when it ends early, and what success is.

Conventions: as those of rigs (:mod:`sim_core.rigs.schema`). A hand is one end effector, or several that move as one (a
gripper). It acts by small motions, one a step, whose velocity is given at ``knots`` in time; ``step_m``, ``step_deg``
and ``close_m`` bound what a step does to each component, and a component with the bound 0 is left out.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from sim_core.errors import ConfigError, nearest_match
from sim_core.rigs import Affine, Box, Rectangle, Rig, Rigid, Sheet
from sim_core.rigs.fields import FloatArray, Interval, Name, NonNegative, Real, Strict, Text, Vector, of_length, trouble
from sim_core.rigs.motion import Motion

Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]
StepLength = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=0.01)]
StepTurn = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=10.0)]
StepLengths = Annotated[tuple[StepLength, StepLength, StepLength], of_length(3)]
StepTurns = Annotated[tuple[StepTurn, StepTurn, StepTurn], of_length(3)]
Reals = Annotated[tuple[Real, Real], of_length(2)]
Seconds = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=60.0)]
Share = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=1.0)]
Steps = Annotated[int, Field(strict=True, ge=1, le=5000)]
Grid = Annotated[tuple[Annotated[int, Field(strict=True, ge=1, le=200)], ...], Field(min_length=1, max_length=3)]


class Hand(Strict):
    """End effectors that move as one about the mean of their origins, and what one step may do at most.

    Six components: a translation along [m] and a turn about [deg] the axes of the base frame. ``close_m`` is the
    seventh: by how much each finger goes towards that mean.
    """

    fingers: tuple[Name, ...] = Field(min_length=1, description="end effectors of the rig")
    step_m: StepLengths = Field(description="largest translation of one step along x, y, z in m")
    step_deg: StepTurns = (0.0, 0.0, 0.0)
    close_m: StepLength = 0.0

    @model_validator(mode="after")
    def _acts(self) -> Hand:
        if not self.bounds().any():
            raise trouble("has only bounds of 0, so that nothing moves.", "Give at least one above 0.", "step_m")
        if self.close_m > 0.0 and len(self.fingers) < 2:
            raise trouble("closes a hand of one finger.", "Name two fingers, or leave it out.", "close_m")
        return self

    def bounds(self) -> FloatArray:
        """Largest motion of one step: translation [m], turn [rad], closing [m], ``(7,)``."""
        return np.array([*self.step_m, *np.deg2rad(self.step_deg), self.close_m])


class Actions(Strict):
    """``steps`` motions of the hands, of which ``knots`` velocities are chosen.

    ``profile``: between knots the velocity is ``linear`` and begins and ends at 0, as a robot's does, or it is
    ``constant`` from one knot to the next.
    """

    steps: Steps = Field(description="number of steps in which the hands act")
    knots: Steps = Field(description="number of velocities that are chosen of each component")
    profile: Literal["linear", "constant"] = "linear"
    hands: dict[Name, Hand] = Field(min_length=1, description="hands by name")

    @model_validator(mode="after")
    def _knots_fit(self) -> Actions:
        if self.knots > self.steps:
            raise trouble(f"is {self.knots}, more than the {self.steps} steps.", "Choose fewer knots.", "knots")
        return self


class ObservedPoints(Strict):
    """Material points of a body, whose positions in the base frame the reward is made of.

    ``grid``: of a rectangle n x m points, of a box n x m x l, the outermost ones on its border; without it the centre.
    """

    body: Name = Field(description="a sheet or an affine body")
    grid: Grid | None = None
    row: Interval | None = Field(default=None, description="only points of the sheet with x in this interval, in m")


class FoldLine(Strict):
    """The plastic fold angle of a sheet across a line along its width: (1 / width) times the integral of the plastic
    curvature along x over the band ``over_m`` about ``at_m``, [rad], positive where the sheet closes towards +z."""

    body: Name = Field(description="a sheet that may yield in bending")
    at_m: Real = Field(description="place of the line along the sheet's x in m")
    over_m: Positive = Field(description="width of the band in m")


class Stop(Strict):
    """When a rollout ends early and does not count: a finger bears more than ``most_force_n`` or than its hand is
    allowed to; or, from the step ``touching_from`` of the actions on, no finger bears more than ``least_force_n``; or
    the middle of observed points is not ``over`` a rigid body: next to it, or below its top."""

    most_force_n: Positive = 10.0
    least_force_n: NonNegative = 0.0
    touching_from: Annotated[int, Field(strict=True, ge=0)] = 10
    over: dict[Name, Name] = Field(default={}, description="rigid bodies by names of observed points")


class Afterwards(Strict):
    """What the hands do when the motion is done, before the reward counts: each end effector is drawn back by
    ``retreat_m`` within ``retreat_s``, and then all rest for ``rest_s``."""

    retreat_m: dict[Name, Vector] = Field(default={}, description="in the base frame, by end effector, in m")
    retreat_s: Seconds = Field(default=0.0, description="in s")
    rest_s: Seconds = Field(default=0.0, description="in s")

    @model_validator(mode="after")
    def _retreats(self) -> Afterwards:
        if bool(self.retreat_m) != bool(self.retreat_s):
            raise trouble("stands without retreat_s, or that without it.", "Give both or neither.", "retreat_m")
        return self


class Conditions(Strict):
    """What a person would see at the end, besides the reward. ``rests_on``: bodies of which another one bears more than
    half of the weight; ``apart``: pairs of bodies that do not touch."""

    rests_on: dict[Name, Name] = Field(default={}, description="by body: what it rests on")
    apart: tuple[tuple[Name, Name], ...] = Field(default=(), description="pairs of bodies")

    def words(self) -> list[str]:
        """Each of them in words."""
        rest = [f"{body} rests on {under}" for body, under in self.rests_on.items()]
        return [*rest, *(f"{one} and {other} are apart" for one, other in self.apart)]


class Published(Strict):
    """What the source of a variant says of it: rewards that a person reached and that could be reached at best, and the
    share of searches that had a success."""

    human: Real
    oracle: Real
    success_rate: Share


class Start(Strict):
    """Changes of an affine body at the start."""

    velocity_m_s: Vector | None = None
    position_m: Vector | None = None


class Variant(Strict):
    """Numbers with which a task is made. ``parameters``: of the rig (``card.E_pa``); ``weightless``: bodies on which
    gravity does not act; ``settings``: of the reward; ``success``: the reward from which on it is a success."""

    words: Text = Field(description="what a person calls success")
    success: Real = Field(description="least reward of a success")
    source: Text = ""
    parameters: dict[Text, Real] = Field(default={})
    weightless: tuple[Name, ...] = ()
    start: dict[Name, Start] = Field(default={})
    settings: dict[Name, Real | tuple[Real, ...]] = Field(default={})
    actions: Actions | None = Field(default=None, description="actions in place of those of the task")
    stop: Stop | None = Field(default=None, description="early stop in place of that of the task")
    conditions: Conditions | None = Field(default=None, description="conditions in place of those of the task")
    published: Published | None = Field(default=None, description="what the source says")


class Task(Strict):
    """One task. It begins at rest: with the hands where the rig has them, from where they make the ``approach``,
    motions by end effector as in experiments; or, what they have to hold, with the approach made (``begins: held``).
    ``conditions``: what is asked of a success besides the reward, at the end of what is done ``afterwards``.
    """

    name: Name = Field(description="short name, as in the file's name")
    title: Text = Field(description="what is to be done, in a sentence")
    rig: Text = Field(description="name of a rig, or the path of its file")
    target_rig: Text = Field(default="", description="rig on which a drawn motion makes the target, if not 'rig'")
    reward: Name = Field(description="module in sim_core.tasks.rewards")
    step_s: Positive = Field(description="time of one step in s")
    approach: dict[Name, tuple[Motion, ...]] = Field(default={})
    begins: Literal["free", "held"] = Field(default="free", description="free: with the approach; held: after it")
    actions: Actions
    afterwards: Afterwards = Afterwards()
    conditions: Conditions = Conditions()
    points: dict[Name, ObservedPoints] = Field(default={})
    folds: dict[Name, FoldLine] = Field(default={})
    stop: Stop = Stop()
    best: Real | None = Field(default=None, description="reward that no motion exceeds, more than that of a success")
    coarse: dict[Name, tuple[int, ...]] = Field(
        default={}, description="cells of sheets in searches; the best is scored with those of the rig"
    )
    family: dict[Text, Reals] = Field(
        default={}, description="parameters of the rig and their intervals, over which one policy is learnt"
    )
    variants: dict[Name, Variant] = Field(min_length=1, description="numbers by variant: real, paper")

    @model_validator(mode="after")
    def _observes(self) -> Task:
        if not self.points and not self.folds:
            raise trouble("has neither points nor folds.", "Say what the reward is made of.", "points")
        for name, variant in self.variants.items():
            if self.best is not None and not variant.success < self.best:
                raise trouble(
                    f"is {self.best:g}, but a success of the variant {name!r} has {variant.success:g} and more.",
                    "Give a higher one, or leave it out.",
                    "best",
                )
        return self


def check_names(task: Task, variant: Variant, rig: Rig, source: str) -> None:
    """Raise ``ConfigError`` where the task names an end effector or a body that the rig does not have, or one of
    another kind than is needed."""

    def known(name: str, place: str, of: dict[str, object] | list[str], what: str) -> None:
        if name not in of:
            remedy = nearest_match(name, of) if of else f"The rig {rig.name!r} has none."
            raise ConfigError(f"{source}: {place} names {name!r}, which is no {what} of the rig {rig.name!r}.", remedy)

    effectors, sheets = list(rig.end_effectors), [n for n, b in rig.bodies.items() if isinstance(b, Sheet)]
    affine = [n for n, b in rig.bodies.items() if isinstance(b, Affine)]
    taken: dict[str, str] = {}
    actions = variant.actions or task.actions
    for name, hand in actions.hands.items():
        for finger in hand.fingers:
            known(finger, f"actions.hands.{name}.fingers", effectors, "end effector")
            if finger in taken:
                raise ConfigError(
                    f"{source}: actions.hands.{name}.fingers names {finger!r}, which the hand {taken[finger]!r} moves.",
                    "Let each end effector be of one hand.",
                )
            taken[finger] = name
    for place, names in (("approach", task.approach), ("afterwards.retreat_m", task.afterwards.retreat_m)):
        for name in names:
            known(name, place, effectors, "end effector")
    for name, points in task.points.items():
        known(points.body, f"points.{name}.body", sheets + affine, "sheet or affine body")
        shape = rig.bodies[points.body].shape
        if points.grid is not None and not (
            (isinstance(shape, Rectangle) and len(points.grid) == 2)
            or (isinstance(shape, Box) and len(points.grid) == 3)
        ):
            raise ConfigError(
                f"{source}: points.{name}.grid is {list(points.grid)}, but {points.body} is a {shape.type}.",
                "Give [n, m] for a rectangle and [n, m, l] for a box, or leave it out for the centre.",
            )
        if points.grid is None and points.body in sheets:
            raise ConfigError(f"{source}: points.{name} has no grid.", "Add 'grid: [n, m]'.")
    for name, fold in task.folds.items():
        known(fold.body, f"folds.{name}.body", sheets, "sheet")
        if not any(key.partition("@")[0] == "bending_plasticity" for key in rig.effects):
            raise ConfigError(
                f"{source}: folds.{name} is a plastic fold angle, but nothing of the rig {rig.name!r} yields.",
                "Add the effect bending_plasticity to the rig.",
            )
    for name in variant.weightless:
        known(name, "weightless", list(rig.bodies), "body")
    for name in variant.start:
        known(name, "start", affine, "affine body")
    for name in task.coarse:
        known(name, "coarse", sheets, "sheet")
    rigid = [n for n, b in rig.bodies.items() if isinstance(b, Rigid)]
    for name, under in (variant.stop or task.stop).over.items():
        known(name, "stop.over", list(task.points), "set of observed points of the task, and no body")
        known(under, f"stop.over.{name}", rigid, "rigid body")
    conditions = variant.conditions or task.conditions
    for place, pairs in (("rests_on", conditions.rests_on.items()), ("apart", conditions.apart)):
        for pair in pairs:
            for name in pair:
                known(name, f"conditions.{place}", list(rig.bodies), "body")
            if rig.contact(*pair) is None:
                raise ConfigError(
                    f"{source}: conditions.{place} names {pair[0]!r} and {pair[1]!r}, between which the rig "
                    f"{rig.name!r} has no contact.",
                    "Declare the contact in the rig.",
                )
