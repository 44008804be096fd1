"""Message types of the contract, the topics that may have each, and their definitions."""

from __future__ import annotations

from rosbags.typesys import Stores, get_typestore

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
"""Definitions of the types of ROS 2."""

POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
PLAIN_POSE = "geometry_msgs/msg/Pose"
COVARIANCE_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
JOINTS = "sensor_msgs/msg/JointState"
TEXT = "std_msgs/msg/String"
TF = "tf2_msgs/msg/TFMessage"
WRENCH = "geometry_msgs/msg/WrenchStamped"
PLAIN_WRENCH = "geometry_msgs/msg/Wrench"
CLOUD = "sensor_msgs/msg/PointCloud2"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
EVENTS = "diagnostic_msgs/msg/DiagnosticArray"

POSES = (POSE, TRANSFORM, COVARIANCE_POSE, PLAIN_POSE)
"""Types that hold one pose. What has no header has no stamp: the time of recording stands for it."""
WRENCHES = (WRENCH, PLAIN_WRENCH)

ROLES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "current_pose": (("current_pose",), POSES),
    "target_pose": (("target_pose",), POSES),
    "joints": (("joint_states",), (JOINTS,)),
    "wrench": (("wrench",), WRENCHES),
    "markers": (("markers",), (CLOUD,)),
    "tracks": (("marker_tracks",), (CLOUD,)),
    "camera_info": (("camera_info",), (CAMERA_INFO,)),
    "images": (
        ("image", "image_raw", "image/compressed", "image_raw/compressed"),
        (IMAGE, COMPRESSED),
    ),
}
"""Per role: the topic names of the contract, in any namespace, and the message types it may have."""
