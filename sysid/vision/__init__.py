"""Markers in tactile images: detection, identity over a recording, checks, pictures.

``track_recording`` turns the images of a recording into marker tracks with a report;
``write_tracked_recording`` writes them as a new recording.
"""

from sysid.vision.detect import DetectionParameters, Detections, detect_markers
from sysid.vision.from_recording import TrackingResult, track_recording, write_tracked_recording
from sysid.vision.match import LayoutMatch, MatchParameters, match_layout
from sysid.vision.motion import (
    PatternMotion,
    PoseCheck,
    SlideSign,
    explain_by_poses,
    pattern_motion,
    slide_sign,
)
from sysid.vision.overlay import contact_sheet, overlay
from sysid.vision.reference import Reference, choose_reference
from sysid.vision.report import TrackingReport
from sysid.vision.track import FrameTracks, TrackParameters, track_frames

__all__ = [
    "DetectionParameters",
    "Detections",
    "FrameTracks",
    "LayoutMatch",
    "MatchParameters",
    "PatternMotion",
    "PoseCheck",
    "Reference",
    "SlideSign",
    "TrackParameters",
    "TrackingReport",
    "TrackingResult",
    "choose_reference",
    "contact_sheet",
    "detect_markers",
    "explain_by_poses",
    "match_layout",
    "overlay",
    "pattern_motion",
    "slide_sign",
    "track_frames",
    "track_recording",
    "write_tracked_recording",
]
