"""Sensors and cameras of a rig: what is measured, where, how often and how well."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from sim_core.rigs.bodies import WORLD
from sim_core.rigs.fields import (
    Cells2,
    Count,
    FloatArray,
    FrameId,
    Name,
    NonNegative,
    Pose,
    Position,
    Real,
    Strict,
    Text,
    Topic,
    each_axis_once,
    of_length,
    trouble,
)
from sim_core.rigs.pose_offset import Displaced, ShiftSds, TurnSds

Rate = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=1e4)]
Latency = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-10.0, le=10.0)]
Spread = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=1e3)]
"""Standard deviation of the stated pose, 0 where it is exact."""
SensorRange = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=1e6)]
Focal = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=1e6)]
Pixel = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]
WrenchComponent = Literal["force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z"]
WRENCH_COMPONENTS: tuple[WrenchComponent, ...] = get_args(WrenchComponent)
"""In the order of a reading."""

MarkerId = Annotated[int, Field(strict=True, ge=0, lt=2**32)]


class Points(Strict):
    """Material points of a body: a regular grid, or local rest coordinates one by one.

    A grid of ``[n, m]`` has n points along the first and m along the second axis of the sheet or of
    the named face (a dome: n rings of m points) and counts row by row. Without ``margin_m`` each
    point is in the middle of its cell; with it the outermost points have that distance to the edge.
    ``ids`` numbers listed positions; otherwise numbers count up from 0 over all that a sensor sees.

    ``placed: first_frame`` is for markers that are put on anew for each recording (pins, stickers): where
    they are on the sheet is then taken from the first frame of the recording, with the sheet at rest
    between its clamps as they stand in that frame. ``positions_m`` still says where they are when the rig
    is simulated without a recording.
    """

    face: Text | None = Field(default=None, description="face of a gel on which the grid lies, as in `bonded`")
    grid: Cells2 | None = Field(
        default=None,
        description="numbers of points along the first and the second axis; on a dome rings and points of a ring",
    )
    margin_m: NonNegative | None = Field(
        default=None,
        description="distance of the outermost points to the edge; left out: each point is in the middle of its cell",
    )
    positions_m: tuple[Position, ...] | None = Field(
        default=None, description="points in local rest coordinates of the body, one by one"
    )
    ids: tuple[MarkerId, ...] | None = Field(
        default=None, description="numbers of the listed positions; left out: they count up from 0"
    )
    placed: Literal["rig", "first_frame"] = Field(
        default="rig", description="whether the rig says where the points are, or the first frame of a recording"
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Points:
        if (self.grid is None) == (self.positions_m is None):
            raise trouble(
                "needs either grid or positions_m.",
                "Write 'grid: [7, 7]' or 'positions_m: [[x, y, z], ...]'.",
            )
        if self.positions_m is not None and not self.positions_m:
            raise trouble("is an empty list.", "Give at least one point.", "positions_m")
        if self.grid is None and (self.face is not None or self.margin_m is not None):
            raise trouble("has face or margin_m without a grid.", "They place a grid; leave them out.")
        if self.ids is not None:
            if self.positions_m is None or len(self.ids) != len(self.positions_m):
                raise trouble("does not number the positions.", "Give positions_m and one id for each.", "ids")
            if len(set(self.ids)) != len(self.ids):
                raise trouble("holds a number twice.", "Number each point once.", "ids")
        if self.placed == "first_frame" and (self.positions_m is None or self.ids is None):
            raise trouble(
                "takes the places of markers from recordings, but does not say which markers.",
                "Give ids, and positions_m for simulations without a recording.",
                "placed",
            )
        return self

    @property
    def count(self) -> int:
        """Number of points asked for (an outline keeps only those that lie inside it)."""
        return self.grid[0] * self.grid[1] if self.grid is not None else len(self.positions_m or ())


Axis = Literal["x", "-x", "y", "-y", "z", "-z"]
Axes = Annotated[tuple[Axis, Axis, Axis], of_length(3), AfterValidator(each_axis_once)]
"""Where recorded components x, y and z point: axes of the frame that the rig has."""

PictureAxis = Literal["u", "-u", "v", "-v"]
PictureAxes = Annotated[tuple[PictureAxis, PictureAxis], of_length(2), AfterValidator(each_axis_once)]
"""Where recorded columns and rows point in the picture of the camera that the rig has."""

ForceUnit = Literal["N", "mN", "gf", "kgf", "lbf"]
"""Of recorded forces, and of the forces in recorded torques."""

LengthUnit = Literal["m", "mm"] | None
"""Of recordings; a unit that is written is used as it is, nothing is taken for m."""


NEWTONS: Mapping[str, float] = {"N": 1.0, "mN": 1e-3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216152605}
"""One of each unit of force [N]."""


class WrenchNoise(Strict):
    """Standard deviation of white noise on each component."""

    force_n: NonNegative = Field(default=0.0, description="standard deviation of each force component")
    torque_nm: NonNegative = Field(default=0.0, description="standard deviation of each torque component")


class MarkerNoise(Strict):
    """Standard deviation of white noise on each coordinate."""

    position_m: NonNegative = Field(default=0.0, description="standard deviation of each coordinate")


class TrackNoise(Strict):
    """Standard deviation of white noise on each image coordinate."""

    position_px: NonNegative = Field(default=0.0, description="standard deviation of each image coordinate")


class WrenchSensor(Strict):
    """Force and torque that act on the sensor, about the origin of its frame and along its axes.

    ``on`` is an end effector (all that it carries), a gel or rigid body, or a named clamp. ``pose``
    puts the sensor's frame into the frame of the end effector, the body's local frame, or the frame
    of the clamp's mount. ``measures``: the components that a real sensor has (a gauge along one axis has
    one); what a recording holds in the others is not compared. ``latency_sd_s``: how well the latency is known, for
    fits. ``length_unit``: of the lengths in recorded torques, where that is not m. ``range_n`` and ``range_nm``: the
    largest force and torque of a component that the sensor can read, as its data sheet says.
    """

    type: Literal["wrench"]
    on: Name = Field(description="end effector, body or named clamp whose load is measured")
    frame_id: FrameId | None = Field(
        default=None, description="frame_id of its messages; left out: the name of the sensor"
    )
    pose: Pose = Field(default=Pose(), description="pose of the sensor's frame in that of what it is on")
    rate_hz: Rate = Field(default=100.0, description="readings per second")
    latency_s: Latency = Field(default=0.0, description="stamp minus instant of the reading")
    latency_sd_s: Spread = Field(
        default=0.03, description="standard deviation of what is known of the latency, for fits"
    )
    noise: WrenchNoise = Field(default=WrenchNoise(), description="white noise of each component")
    measures: Annotated[tuple[WrenchComponent, ...], Field(min_length=1)] = Field(
        default=WRENCH_COMPONENTS,
        description="components that the sensor has; the others of a recording are not compared",
    )
    topic: Topic = Field(default="wrench", description="topic of its readings")
    length_unit: LengthUnit = Field(
        default=None, description="unit of lengths in recorded torques, where that is not m"
    )
    force_unit: ForceUnit = Field(
        default="N", description="unit of recorded forces, and of the forces in recorded torques"
    )
    force_axes: Axes = Field(
        default=("x", "y", "z"),
        description="axes of the sensor's frame along which recorded forces x, y, z are: [-x, -y, -z] where they are "
        "those that act by it",
    )
    torque_axes: Axes = Field(
        default=("x", "y", "z"), description="axes of the sensor's frame about which recorded torques x, y, z are"
    )
    range_n: SensorRange | None = Field(default=None, description="largest force component that the sensor reads")
    range_nm: SensorRange | None = Field(default=None, description="largest torque component that the sensor reads")


class MarkerSensor(Strict):
    """3-D positions of material points.

    ``pose`` puts the sensor's frame into the body's rest frame, which moves with the body's mount (the
    rest frame of a sheet or of a free gel stands still). ``length_unit``: of recorded positions, where that is not m.
    """

    type: Literal["markers"]
    body: Name = Field(description="the body that carries the points")
    points: Points = Field(description="grid or positions_m")
    frame_id: FrameId | None = Field(
        default=None, description="frame_id of its messages; left out: the name of the sensor"
    )
    pose: Pose = Field(default=Pose(), description="pose of the sensor's frame in the rest frame of the body")
    rate_hz: Rate = Field(default=60.0, description="readings per second")
    latency_s: Latency = Field(default=0.0, description="stamp minus instant of the reading")
    latency_sd_s: Spread = Field(
        default=0.03, description="standard deviation of what is known of the latency, for fits"
    )
    noise: MarkerNoise = Field(default=MarkerNoise(), description="white noise of each coordinate")
    topic: Topic = Field(default="markers", description="topic of its readings")
    length_unit: LengthUnit = Field(default=None, description="unit of recorded positions, where that is not m")
    axes: Axes = Field(
        default=("x", "y", "z"), description="axes of the sensor's frame along which recorded x, y, z are"
    )


Sensor = Annotated[WrenchSensor | MarkerSensor, Field(discriminator="type")]


class CameraTopics(Strict):
    """Where the streams of a camera are. ``image`` is read when a bag holds pictures and no tracks."""

    marker_tracks: Topic = Field(default="marker_tracks", description="topic of tracks")
    camera_info: Topic = Field(default="camera_info", description="topic of the calibration")
    image: Topic = Field(
        default="image/compressed", description="topic of pictures, which are read where a bag holds no tracks"
    )


class Sight(Strict):
    """Points of one body that a camera follows."""

    body: Name = Field(description="the body that carries the points")
    points: Points = Field(description="grid or positions_m")


class _Camera(Displaced):
    """``offset_*``: where the camera really is, seen from its ``pose``. How well things are known, for fits, 0 exactly:
    ``offset_sd_*``, ``scale_sd`` (relative, of focal lengths or scale), ``centre_sd_px`` and ``latency_sd_s``."""

    width_px: Count = Field(description="width of the picture in px")
    height_px: Count = Field(description="height of the picture in px")
    pose: Pose = Field(
        default=Pose(), description="pose of the optical frame (z forward, x right, y down) in that of its mount"
    )
    mount: Name = Field(default=WORLD, description="end effector or `world` that carries it")
    sees: tuple[Sight, ...] = Field(min_length=1, description="list of body and points")
    frame_id: FrameId | None = Field(
        default=None, description="frame_id of its messages; left out: the name of the camera"
    )
    rate_hz: Rate = Field(default=30.0, description="pictures per second")
    latency_s: Latency = Field(default=0.0, description="stamp minus instant of the picture")
    latency_sd_s: Spread = Field(
        default=0.03, description="standard deviation of what is known of the latency, for fits"
    )
    noise: TrackNoise = Field(default=TrackNoise(), description="white noise of each image coordinate")
    topics: CameraTopics = Field(default=CameraTopics(), description="topics of its streams")
    picture_axes: PictureAxes = Field(
        default=("u", "v"),
        description="where recorded u and v of tracks point in the picture of the rig: [-u, v] where it is mirrored",
    )
    offset_sd_m: ShiftSds = Field(default=(0.0, 0.0, 0.0), description="standard deviations of the shifts [m]")
    offset_sd_deg: TurnSds = Field(default=(0.0, 0.0, 0.0), description="standard deviations of the turns [deg]")
    scale_sd: Spread = Field(
        default=0.01, description="relative standard deviation of focal lengths or scale, for fits"
    )
    centre_sd_px: Spread = Field(default=5.0, description="standard deviation of the principal point, for fits")


class _Lens(_Camera):
    fx_px: Focal = Field(description="focal length along u in px")
    fy_px: Focal = Field(description="focal length along v in px")
    cx_px: Pixel = Field(description="principal point u in px")
    cy_px: Pixel = Field(description="principal point v in px")

    def matrix(self) -> FloatArray:
        """Intrinsic matrix K [px], shape ``(3, 3)``."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])


class PinholeCamera(_Lens):
    """Pinhole with ROS ``plumb_bob`` distortion k1, k2, p1, p2, k3.

    Optical frame: z forward, x right, y down.
    """

    model: Literal["pinhole"]
    distortion: Annotated[tuple[Real, Real, Real, Real, Real], of_length(5)] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0), description="coefficients k1, k2, p1, p2, k3"
    )


class FisheyeCamera(_Lens):
    """OpenCV fisheye, ROS ``equidistant``, coefficients k1..k4.

    Optical frame: z forward, x right, y down.
    """

    model: Literal["fisheye"]
    distortion: Annotated[tuple[Real, Real, Real, Real], of_length(4)] = Field(
        default=(0.0, 0.0, 0.0, 0.0), description="coefficients k1, k2, k3, k4"
    )


class OrthographicCamera(_Camera):
    """Scaled orthographic: one length per pixel at any depth, for pictures that only have a scale.

    The origin of the camera's frame is at pixel (``cx_px``, ``cy_px``). Where the picture's crop differs
    from recording to recording, or the camera shakes, ``origin_id`` names a tracked marker that sits at
    that origin: positions in the picture are then counted from it, frame by frame (a recorded track
    becomes ``uv - uv[origin_id] + (cx_px, cy_px)``), and the marker itself is not compared.
    """

    model: Literal["scaled_orthographic"]
    scale_m_per_px: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=1.0)] = Field(
        description="length that one px stands for, in m"
    )
    cx_px: Pixel = Field(default=0.0, description="pixel u of the origin of the camera's frame")
    cy_px: Pixel = Field(default=0.0, description="pixel v of the origin of the camera's frame")
    origin_id: MarkerId | None = Field(
        default=None, description="number of a tracked marker from which positions in the picture are counted"
    )


Camera = Annotated[PinholeCamera | FisheyeCamera | OrthographicCamera, Field(discriminator="model")]
