"""Plain values to ROS messages. Needs the message packages, not rclpy."""

from __future__ import annotations

import array
from collections.abc import Iterable, Mapping

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2, PointField
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout
from visualization_msgs.msg import Marker

from sim_core.rigs import FisheyeCamera, PinholeCamera
from thinshell_ros.clouds import Points
from thinshell_ros.health import Report
from thinshell_ros.poses import Floats, Pose

_DATATYPES = {"<f4": PointField.FLOAT32, "<u4": PointField.UINT32}
MESH_COLOUR = (0.45, 0.68, 0.75, 1.0)
"""Of the surfaces of bodies: red, green, blue, alpha, 0 to 1."""

_LEVELS = {"ok": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}


def time_of(stamp_ns: int) -> Time:
    """Time message from nanoseconds."""
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return Time(sec=seconds, nanosec=rest)


def header(stamp_ns: int, frame_id: str) -> Header:
    """Header with a stamp [ns]."""
    return Header(stamp=time_of(stamp_ns), frame_id=frame_id)


def clock(stamp_ns: int) -> Clock:
    """Clock message from nanoseconds."""
    return Clock(clock=time_of(stamp_ns))


def pose(stamp_ns: int, frame_id: str, value: Pose) -> PoseStamped:
    """Pose [m, x y z w] in ``frame_id``."""
    message = PoseStamped(header=header(stamp_ns, frame_id))
    at, turn = message.pose.position, message.pose.orientation
    at.x, at.y, at.z = map(float, value.position)
    turn.x, turn.y, turn.z, turn.w = map(float, value.quaternion)
    return message


def mesh(stamp_ns: int, frame_id: str, name: str, corners: Floats) -> Marker:
    """A surface as a marker of triangles, ``corners`` ``(3 m, 3)`` [m] in ``frame_id``, seen from both sides."""
    marker = Marker(header=header(stamp_ns, frame_id), ns=name, type=Marker.TRIANGLE_LIST, action=Marker.ADD)
    marker.scale.x = marker.scale.y = marker.scale.z = marker.pose.orientation.w = 1.0
    marker.color.r, marker.color.g, marker.color.b, marker.color.a = MESH_COLOUR
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in corners.tolist()]
    return marker


def wrench(stamp_ns: int, frame_id: str, values: Floats) -> WrenchStamped:
    """Force [N] and torque [N m] on the sensor, about the origin of ``frame_id``; ``values`` ``(6,)``."""
    message = WrenchStamped(header=header(stamp_ns, frame_id))
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = map(float, values)
    return message


def cloud(stamp_ns: int, frame_id: str, points: Points) -> PointCloud2:
    """Cloud of one record a point, fields as in the record."""
    fields = dict(points.dtype.fields or {})
    message = PointCloud2(header=header(stamp_ns, frame_id), height=1, width=len(points))
    message.fields = [
        PointField(name=name, offset=offset, datatype=_DATATYPES[kind.str], count=1)
        for name, (kind, offset, *_) in fields.items()
    ]
    message.point_step = points.dtype.itemsize
    message.row_step = points.dtype.itemsize * len(points)
    message.data = array.array("B", points.tobytes())
    message.is_dense = all(bool((points[name] == points[name]).all()) for name in fields)
    return message


def camera_info(stamp_ns: int, frame_id: str, camera: PinholeCamera | FisheyeCamera) -> CameraInfo:
    """Calibration of a camera [px]."""
    k = [float(value) for value in camera.matrix().ravel()]
    return CameraInfo(
        header=header(stamp_ns, frame_id),
        height=camera.height_px,
        width=camera.width_px,
        distortion_model="plumb_bob" if isinstance(camera, PinholeCamera) else "equidistant",
        d=[float(value) for value in camera.distortion],
        k=k,
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
    )


def picture(stamp_ns: int, frame_id: str, grey: NDArray[np.uint8]) -> Image:
    """A grey picture ``(height, width)``."""
    height, width = grey.shape
    message = Image(header=header(stamp_ns, frame_id), height=height, width=width, encoding="mono8", step=width)
    message.data = array.array("B", grey.tobytes())
    return message


def compressed_picture(stamp_ns: int, frame_id: str, grey: NDArray[np.uint8]) -> CompressedImage:
    """A grey picture ``(height, width)`` as PNG, which loses nothing."""
    import cv2

    message = CompressedImage(header=header(stamp_ns, frame_id), format="png")
    message.data = array.array("B", cv2.imencode(".png", grey)[1].tobytes())
    return message


def status(node: str, hardware: str, report: Report) -> DiagnosticStatus:
    """A report as a status named ``node: report``. ``hardware``: what it is about, such as a rig."""
    return DiagnosticStatus(
        level=_LEVELS[report.level],
        name=f"{node}: {report.name}",
        message=report.message,
        hardware_id=hardware,
        values=[KeyValue(key=key, value=value) for key, value in report.values.items()],
    )


def diagnostics(stamp_ns: int, node: str, hardware: str, reports: Iterable[Report]) -> DiagnosticArray:
    """One status a report."""
    return DiagnosticArray(header=header(stamp_ns, ""), status=[status(node, hardware, report) for report in reports])


def event(stamp_ns: int, node: str, hardware: str, name: str, text: str, values: Mapping[str, str]) -> DiagnosticArray:
    """Something that happened to the readings of ``hardware`` at a stamp [ns], as one status named ``node: name``."""
    return diagnostics(stamp_ns, node, hardware, [Report(name, "ok", text, dict(values))])


def named_numbers(values: Mapping[str, float]) -> Float64MultiArray:
    """Numbers in their order, each with its name as the label of a dimension of one element."""
    dimensions = [MultiArrayDimension(label=name, size=1, stride=1) for name in values]
    data = [float(value) for value in values.values()]
    return Float64MultiArray(layout=MultiArrayLayout(dim=dimensions), data=data)
