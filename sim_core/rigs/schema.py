"""What a rig file may say: bodies, clamps, loads, end effectors, contacts, sensors, cameras, effects.

Conventions: SI units, each named in its key. Every shape has its origin at its own centre and lies in
local rest coordinates; a pose puts it into the frame of its mount (``world`` is the base frame).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sim_core.rigs.bodies import WORLD, Body
from sim_core.rigs.check import check_references
from sim_core.rigs.fields import (
    Direction,
    EffectKey,
    Flag,
    FrameId,
    Name,
    Pose,
    Position,
    Real,
    Strict,
    Text,
    Topic,
    Vector,
    of_length,
    trouble,
)
from sim_core.rigs.limits import HandLimits
from sim_core.rigs.loads import Load
from sim_core.rigs.observers import Axes, Camera, Sensor
from sim_core.rigs.pose_offset import Displaced, ShiftSds, TurnSds
from sim_core.rigs.regions import Region

Deviation = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=1e12)]
Friction = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=5.0)]
Range = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-8, le=1e-2)]
Stiffness = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=1e15)]
Standoff = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e-2, le=1e-2)]


class Clamp(Strict):
    """Holds the nodes of a body inside a region; they follow ``mount`` rigidly from the start.

    ``axes``: the components that are held, along the world's axes (all three: nodes on a point or a line are a
    pin or a hinge); without it, all three of a region of whole cells.
    """

    name: Name | None = Field(default=None, description="name by which a wrench sensor refers to it")
    body: Name = Field(description="the body that is held")
    region: Region = Field(description="box in the body's local rest coordinates")
    mount: Name = Field(default=WORLD, description="end effector or `world` that the held nodes follow")
    axes: Annotated[tuple[Literal["x", "y", "z"], ...], Field(min_length=1)] | None = Field(
        default=None, description="components that are held, along the axes of the world; left out: all three"
    )

    @model_validator(mode="after")
    def _each_once(self) -> Clamp:
        if self.axes is not None and len(set(self.axes)) < len(self.axes):
            raise trouble("names an axis twice.", "Name each axis once.", "axes")
        return self

    @property
    def held(self) -> tuple[bool, bool, bool]:
        """Which components are held."""
        axes = self.axes or ("x", "y", "z")
        return "x" in axes, "y" in axes, "z" in axes


class Joint(Strict):
    """Connects an affine body with another one, or with a mount.

    ``at_m`` and ``axis`` are in the local rest coordinates of ``body``. ``ball``: the two share the point; ``hinge``:
    the line through the point along the axis; ``slider``: the body moves along the axis and does not turn against
    what it is connected ``to``.
    """

    type: Literal["ball", "hinge", "slider"] = Field(description="`ball`, `hinge` or `slider`")
    name: Name | None = Field(default=None, description="name of the joint")
    body: Name = Field(description="an affine body")
    to: Name = Field(default=WORLD, description="another affine body, an end effector, or `world`")
    at_m: Position = Field(
        default=(0.0, 0.0, 0.0), description="point of the joint, in local rest coordinates of the body"
    )
    axis: Direction | None = Field(
        default=None, description="axis of a hinge or slider, in local rest coordinates of the body"
    )

    @model_validator(mode="after")
    def _axis(self) -> Joint:
        if (self.axis is None) != (self.type == "ball"):
            if self.axis is None:
                raise trouble(f"has no axis, which a {self.type} needs.", "Add 'axis: [0, 0, 1]' or the like.")
            raise trouble("has an axis, but a ball joint turns about all.", "Leave it out.", "axis")
        return self


class JointPoses(Strict):
    """Joints by whose positions the URDF of a robot tells the pose of an end effector.

    The chain between the links ``base`` and ``tip`` has fixed, revolute, continuous and prismatic joints, which may
    mimic others. ``angle_unit`` and ``length_unit`` are for positions that are not in rad and m, or that
    look as if they were not.
    """

    topic: Topic = Field(default="joint_states", description="topic of `sensor_msgs/msg/JointState`")
    tip: Text = Field(description="link of the URDF that is the end effector")
    base: Text | None = Field(
        default=None, description="link of the URDF that is the base frame; left out: `base_frame` of the end effector"
    )
    urdf: Text | None = Field(
        default=None, description="file of the URDF; left out: what the recording has on the topic `description`"
    )
    description: Topic = Field(default="robot_description", description="topic of the URDF as text")
    angle_unit: Literal["rad", "deg"] | None = Field(
        default=None, description="unit of positions of turning joints, where they are not, or seem not to be, in rad"
    )
    length_unit: Literal["m", "mm"] | None = Field(
        default=None, description="unit of positions of sliding joints, where they are not, or seem not to be, in m"
    )


class PoseTopics(Strict):
    """Where the poses of an end effector are, in a bag and on a live system.

    ``length_unit`` and ``quaternion_order`` are for recordings that do not keep to m and x, y, z, w, or that look as if
    they did not: what is written is used as it is.
    ``axes``, ``base`` and ``tool`` are for recordings of another frame, as where the flange was recorded: the pose is
    base * P_recorded * tool, with positions along ``axes`` first.
    ``tf``: parent and child frame of the transforms ``/tf`` and ``/tf_static`` that are the measured pose, for robots
    that publish no pose of their own; ``joints``: joints whose positions are, likewise.
    ``max_gap_s``: longest gap in a recorded pose stream that is bridged by a straight line; a longer one
    is an error, unless the motion is known to be slow and steady there.
    """

    target_pose: Topic = Field(default="target_pose", description="topic of commanded poses")
    current_pose: Topic = Field(default="current_pose", description="topic of measured poses")
    tf: Annotated[tuple[FrameId, FrameId], of_length(2)] | None = Field(
        default=None, description="parent and child frame of the transforms that are the measured pose"
    )
    joints: JointPoses | None = Field(
        default=None, description="joints by whose positions a URDF tells the measured pose"
    )
    length_unit: Literal["m", "mm"] | None = Field(
        default=None, description="unit of recorded positions, where the recording does not say or does not keep to m"
    )
    quaternion_order: Literal["xyzw", "wxyz"] | None = Field(
        default=None, description="order of recorded quaternions; left out: x, y, z, w"
    )
    axes: Axes = Field(
        default=("x", "y", "z"), description="axes of the base along which recorded positions x, y, z are"
    )
    base: Pose = Field(default=Pose(), description="pose, in the base frame, of the frame that recorded poses refer to")
    tool: Pose = Field(
        default=Pose(), description="pose of the end effector in the frame of the tool that recorded poses are of"
    )
    max_gap_s: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=3600.0)] = Field(
        default=1.0, description="longest gap of a recorded pose stream that a straight line bridges"
    )

    @model_validator(mode="after")
    def _one_source(self) -> PoseTopics:
        if self.tf is not None and self.joints is not None:
            raise trouble(
                "has tf and joints, of which each would be the measured pose.", "Leave one of them out.", "tf"
            )
        return self


class EndEffector(Displaced):
    """Something that moves as commanded. Its start pose is in ``base_frame``, which is the world.

    ``offset_*``: where it really is, seen from where its poses say (a tool that is mounted askew). What it carries
    follows the true pose (:mod:`sim_core.scene.offset`); start poses, commands and recordings are nominal.
    ``offset_sd_*``: how well that is known, for fits, 0 exactly; usually as of a tool that is mounted by hand.
    ``ready``: where it waits before and after a motion, clear of everything; relative to its start pose along the
    axes of the base frame.
    """

    base_frame: FrameId = Field(default="base_link", description="frame_id of its poses")
    start: Pose = Field(default=Pose(), description="pose at the start, in the base frame")
    topics: PoseTopics = Field(default=PoseTopics(), description="topics of its poses")
    driven_by: Literal["measured", "commanded"] = Field(
        default="measured",
        description="poses of recordings that it follows: measured ones, smoothed by their noise (commanded where no "
        "measured ones were recorded), or commanded ones",
    )
    limits: HandLimits = Field(default=HandLimits(), description="what it may do: optimised motions keep to it")
    ready: Pose = Field(default=Pose(), description="where it waits, relative to its start pose")
    offset_sd_m: ShiftSds = Field(default=(5e-4, 5e-4, 5e-4), description="standard deviations of the shifts [m]")
    offset_sd_deg: TurnSds = Field(default=(0.5, 0.5, 0.5), description="standard deviations of the turns [deg]")


class Contact(Strict):
    """Two bodies that may touch (twice the same sheet: it may touch itself)."""

    between: Annotated[tuple[Name, Name], of_length(2)] = Field(description="the two bodies")
    friction: Friction = Field(default=0.0, description="coefficient of Coulomb friction")
    stiffness_pa_per_m: Stiffness | None = Field(
        default=None,
        description="contact pressure per approach within the range; left out: a quarter of Young's modulus of the "
        "softer gel over the range, without a gel 150 kPa over the range",
    )
    range_m: Range | None = Field(
        default=None,
        description="gap over which contact pressure sets in; left out: 0.5 % of the shortest edges of a gel's "
        "surface, 30 % of the thickness of a sheet, 30 um, whichever is least",
    )
    standoff_m: Standoff = Field(
        default=0.0,
        description="how far apart the surfaces are where they touch: a coating; below zero: they are as if thinner",
    )

    @property
    def name(self) -> str:
        """``first-second``, as parameters are named."""
        return "-".join(self.between)


class Solver(Strict):
    """The time step. Without ``inertia`` every step is an equilibrium (quasi-static).

    ``integrator``: ``implicit_euler`` damps what moves, the more the longer the step; ``bdf2`` is of second order,
    for what swings or is thrown.
    """

    dt_s: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-6, le=10.0)] = Field(
        default=0.01, description="time step"
    )
    inertia: Flag = Field(
        default=True, description="whether mass resists acceleration; without it every step is an equilibrium"
    )
    integrator: Literal["implicit_euler", "bdf2"] = Field(
        default="implicit_euler", description="time integration of what moves"
    )

    @property
    def order(self) -> int:
        """Power of the time step that its error is proportional to, of smooth motions. An equilibrium looks back on
        no step before, whatever the integrator."""
        return 2 if self.inertia and self.integrator == "bdf2" else 1


class Known(Strict):
    """How well a number of the rig is known beforehand: a standard deviation, one of the two."""

    sd: Deviation | None = Field(default=None, description="standard deviation in the unit of the number")
    relative_sd: Deviation | None = Field(default=None, description="standard deviation over the number's value")

    @model_validator(mode="after")
    def _one(self) -> Known:
        if (self.sd is None) == (self.relative_sd is None):
            raise trouble("has neither sd nor relative_sd, or both.", "Give one of the two.")
        return self

    def of(self, value: float) -> float:
        """Standard deviation of a number that has the given value, in its unit."""
        return self.sd if self.sd is not None else float(self.relative_sd or 0.0) * abs(value)


class Rig(Strict):
    """Everything that stands on the table, what moves it and what looks at it."""

    name: Name = Field(description="short name, as in the file's name")
    description: Text = Field(default="", description="one sentence that `thinshell rigs` prints")
    gravity_m_s2: Vector = Field(default=(0.0, 0.0, -9.81), description="acceleration of gravity in the base frame")
    solver: Solver = Field(default=Solver(), description="time step and integrator")
    bodies: dict[Name, Body] = Field(min_length=1, description="name -> body")
    clamps: tuple[Clamp, ...] = Field(default=(), description="parts of sheets and gels that are held")
    loads: tuple[Load, ...] = Field(default=(), description="forces, weights, tractions and pressures on bodies")
    joints: tuple[Joint, ...] = Field(default=(), description="joints of affine bodies")
    end_effectors: dict[Name, EndEffector] = Field(default={}, description="name -> end effector")
    contacts: tuple[Contact, ...] = Field(
        default=(), description="pairs of bodies that may touch; what is not listed passes through each other"
    )
    sensors: dict[Name, Sensor] = Field(default={}, description="name -> sensor")
    cameras: dict[Name, Camera] = Field(default={}, description="name -> camera")
    effects: dict[EffectKey, dict[Text, Real]] = Field(
        default={}, description="key -> parameters of an effect; see the catalogue of effects"
    )
    known: dict[Text, Known] = Field(
        default={}, description="parameter -> how well its value is known, by which fits and diagnoses are held to it"
    )
    recording_clock: Literal["header", "log"] = Field(
        default="header", description="clock of recordings: stamps of headers, or the time at which the recorder wrote"
    )
    table_columns: dict[Text, Text] = Field(
        default={},
        description="name of a column in tables of recordings -> what it is, as `wrench.force_z` or, where the name "
        "has no unit, `wrench.force_z [mN]`; other columns that are not known are not read then",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Rig:
        check_references(self)
        return self

    def contact(self, first: str, second: str) -> Contact | None:
        """The contact between two bodies, in either order."""
        for contact in self.contacts:
            if set(contact.between) == {first, second}:
                return contact
        return None
