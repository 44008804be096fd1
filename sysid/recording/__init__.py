"""Recordings: a bag as arrays with units, frames, provenance and remarks; and contract bags written.

``read_recording`` turns a rosbag2 recording (MCAP or sqlite3) into a ``Recording``; ``RecordingWriter``
writes one. Neither needs ROS.
"""

from sysid.recording.images import ImageStream
from sysid.recording.notes import Note
from sysid.recording.reader import read_recording
from sysid.recording.recording import FileRecord, Provenance, Recording
from sysid.recording.streams import CameraInfo, MarkerStream, PoseStream, Stream, TrackStream, WrenchStream
from sysid.recording.topics import EETopics, SensorTopic, TopicNames
from sysid.recording.writer import RecordingWriter

__all__ = [
    "CameraInfo",
    "EETopics",
    "FileRecord",
    "ImageStream",
    "MarkerStream",
    "Note",
    "PoseStream",
    "Provenance",
    "Recording",
    "RecordingWriter",
    "SensorTopic",
    "Stream",
    "TopicNames",
    "TrackStream",
    "WrenchStream",
    "read_recording",
]
