"""Settings of ``sysid.observations``."""

from __future__ import annotations

from dataclasses import dataclass

from sim_core.settings import setting


@dataclass(frozen=True)
class ObservationsSettings:
    """Settings of the checks of recordings, by the check."""

    # cameras
    camera_apart_sd: float = setting(
        5.0,
        "sd",
        "Standard deviations of focal length and centre (``scale_sd``, ``centre_sd_px``) from which a camera "
        "is another.",
        "statistics",
    )
    camera_focal_difference: float = setting(
        0.2, "1", "Relative difference of focal lengths from which no fit can mend it.", "judgement"
    )
    camera_same_focal: float = setting(
        1e-3,
        "1",
        "Relative difference of focal lengths of one calibration, rounded when it was written down.",
        "judgement",
    )
    camera_same_centre_px: float = setting(
        1.0,
        "px",
        "Difference of the centre, or of distorted places where the rig states no noise, within one calibration: "
        "columns are counted from 0, 1 or one half.",
        "judgement",
    )
    camera_rays: int = setting(
        9, "1", "Rays along each side of the picture by which two distortions are compared.", "cost"
    )
    camera_turn_deg: float = setting(
        0.1, "deg", "Turn of rectified pictures against the camera below which both are one.", "judgement"
    )
    outside_picture_share: float = setting(
        0.02, "1", "Share of tracks outside of the picture from which they are not of this picture.", "judgement"
    )

    # clipped
    clipped_in_a_row: int = setting(
        3,
        "1",
        "Readings in a row at one extreme level from which a sensor is taken to have been at its limit.",
        "judgement",
    )

    # clocks
    clock_messages: int = setting(30, "1", "Messages of a stream from which its clock is judged.", "judgement")
    clock_step_s: float = setting(
        0.05, "s", "A change of the delay from stamp to recorder that stays: a clock that was set.", "judgement"
    )
    clock_drift_s: float = setting(
        0.01,
        "s",
        "A change of the least delay over a recording, steadily: a clock that is too fast or too slow. "
        "Sensors and poses are then shifted by as much against each other.",
        "judgement",
    )
    clock_offset_s: float = setting(
        0.5,
        "s",
        "A difference of the delays of two streams: two computers whose clocks were not set by each other.",
        "judgement",
    )
    clock_parts: int = setting(12, "1", "Parts of a recording of which the least delays are compared.", "judgement")

    # findings
    named_spans: int = setting(3, "1", "Spans of time that a sentence names.", "judgement")

    # frozen
    frozen_in_a_row: int = setting(5, "1", "Readings in a row that are the same.", "judgement")
    frozen_chance: float = setting(
        1e-4,
        "1",
        "Expected number of stretches of repeated readings in a recording, by how often its readings repeat otherwise, "
        "below which one is no chance.",
        "statistics",
    )
    changed_over_noise: float = setting(3.0, "1", "Change over its noise that is one.", "convention")
    frozen_pose_block: int = setting(16, "1", "Poses in a row that are looked at together.", "judgement")
    frozen_pose_rests: int = setting(
        3, "1", "Such blocks at rest, with noise, from which poses have noise at rest.", "judgement"
    )
    noisy_repeated_share: float = setting(
        0.5, "1", "Share of repeated readings at rest below which a sensor has noise that shows.", "judgement"
    )

    # lost markers
    lost_at_one_place: int = setting(
        3, "1", "Readings at one exact place from which it is none of a marker.", "judgement"
    )
    lost_repeated_share: float = setting(
        0.2, "1", "Share of readings that repeat at rest below which an exact repetition is no reading.", "judgement"
    )
    lost_chance: float = setting(
        1e-3,
        "1",
        "Expected number of stretches of repetitions in a recording below which one is no chance.",
        "statistics",
    )
    no_step_share: float = setting(
        0.05, "1", "Step of a marker, over the usual one, that is as good as none.", "judgement"
    )
    lost_repetitions_ratio: float = setting(
        2.0,
        "1",
        "Exact repetitions, over such steps, from which they are none of a tracker that goes on. A tracker "
        "that stops where it gains little repeats itself exactly, and hardly moves as often.",
        "judgement",
    )
    lost_distance_ratio: float = setting(
        10.0,
        "1",
        "Distance from where a marker is otherwise, over how far it usually is from its median place, from "
        "which it is not there.",
        "judgement",
    )

    # identity of markers
    same_detection_share: float = setting(
        1e-4,
        "1",
        "Distance of two markers, over the usual distance of neighbours, from which they are one detection.",
        "judgement",
    )
    same_detection_frames: int = setting(2, "1", "Frames in a row in which two markers are one detection.", "judgement")
    exchanged_jump_share: float = setting(
        0.5,
        "1",
        "Motion from one frame to the next, over the distance of neighbours, from which a marker may be another one.",
        "judgement",
    )
    exchanged_place_share: float = setting(
        0.2,
        "1",
        "Distance from where another marker was, over how far it jumped, at which it has taken the other's place.",
        "judgement",
    )

    # layout of markers
    layout_markers: int = setting(6, "1", "Markers from which their layout is compared.", "judgement")
    layout_scale: float = setting(
        1.5, "1", "Factor between the sizes from which a unit or a focal length is wrong.", "judgement"
    )
    layout_turn_deg: float = setting(45.0, "deg", "Turn of the layout from which axes are exchanged.", "judgement")
    layout_rounds: int = setting(8, "1", "Turns of matching and mapping.", "cost")
    layout_line_share: float = setting(
        0.05, "1", "Extent across a layout, over that along it, below which it is a line.", "judgement"
    )
    layout_fit_share: float = setting(
        0.35,
        "1",
        "Distance from the map, over the distance of neighbours, within which numbers are those of the rig.",
        "judgement",
    )

    # motion
    noise_over_step: float = setting(
        0.03, "1", "Noise over the usual step from one reading to the next from which it shows.", "judgement"
    )

    # pictures
    pictures_looked_at: int = setting(
        24, "1", "Pictures of a stream that are decoded, evenly over the recording; the tracker looks at all.", "cost"
    )
    blank_grey_sd: float = setting(
        1.0, "grey levels", "Standard deviation of grey levels below which a picture shows nothing.", "judgement"
    )

    # rates
    rate_ratio: float = setting(
        4.0, "1", "Factor between the rates from which stamps, or the rig, are wrong.", "judgement"
    )
    rate_samples: int = setting(20, "1", "Samples from which a rate is estimated.", "judgement")

    # repeated readings
    repeated_share: float = setting(
        0.1,
        "1",
        "Share of messages that repeat the one before from which a publisher is faster than its sensor.",
        "judgement",
    )
    repeated_fewest: int = setting(10, "1", "Repeated messages from which that is reported.", "judgement")
    repeated_chance: float = setting(
        1e-2, "1", "Share of the repetitions that chance may make, by how often single columns repeat.", "statistics"
    )
    repeated_regular_share: float = setting(
        0.9, "1", "Share of the turns of repetitions and new readings that are alike in a regular stream.", "judgement"
    )
    coarse_stamp_share: float = setting(
        0.1,
        "1",
        "Step of the stamps, over the usual interval, from which their rounding shifts readings in time.",
        "judgement",
    )
    stamp_multiple_share: float = setting(
        1e-3, "1", "Distance of stamps from multiples of a step, over the step, that is none.", "convention"
    )

    # displacements of markers
    at_rest_share: float = setting(
        0.1, "1", "Change of positions, over that of displacements, below which they are those at rest.", "judgement"
    )

    # resolution
    coarse_step_share: float = setting(
        0.05, "1", "Step over the range of what was measured from which it limits what is known.", "judgement"
    )

    # restarts
    settled_after_reset_s: float = setting(
        0.3, "s", "Time after a reset at which a window of the recording may begin.", "judgement"
    )
    time_left_out_s: float = setting(0.1, "s", "Time left out, in all, that is worth a word.", "judgement")

    # spikes
    spike_distance_ratio: float = setting(
        20.0, "1", "Distance from the middle of the neighbours, over the usual one, of a spike.", "judgement"
    )
    spike_return_share: float = setting(
        0.2,
        "1",
        "Distance of the two neighbours from each other (of the vector: a force that turns peaks in one "
        "component), over the height of a spike, at most.",
        "judgement",
    )
    spike_resolution_steps: float = setting(
        5.0, "1", "Height of a spike over the step in which a sensor reads, at least.", "judgement"
    )
    marker_spike_share: float = setting(
        0.1, "1", "Least height of a spike of a marker, over the distance of its neighbours.", "judgement"
    )
    pose_spike_m: float = setting(
        1e-3, "m", "Spikes of poses are at least so high: less is noise of a pose that hardly has any.", "judgement"
    )

    # start poses
    start_chance_sd: float = setting(
        4.0, "sd", "Standard deviations of a mount by which a hand may be off the rig's start by chance.", "statistics"
    )
    start_far_deg: float = setting(
        45.0,
        "deg",
        "Angle of the first pose from the start of the rig from which quaternions are read in other ways.",
        "judgement",
    )
    start_near_deg: float = setting(
        10.0, "deg", "Angle within which another reading of the numbers agrees with the rig.", "judgement"
    )
    unit_position_m: float = setting(
        1e-3, "m", "Sizes of positions below which units cannot be recognised.", "judgement"
    )
    fast_turn_rad_s: float = setting(
        30.0,
        "rad/s",
        "Usual angular speed, while it turns, beyond that of any robot's wrist: angles were in degrees.",
        "judgement",
    )

    # tares
    tare_side_readings: int = setting(
        12, "1", "Readings on each side that are compared; the two next to the step are left out.", "judgement"
    )
    tare_step_ratio: float = setting(
        12.0, "1", "Height of a step, over the scatter on both sides, from which it is none of noise.", "judgement"
    )
    tare_jump_over_step: float = setting(
        4.0,
        "1",
        "With ``tare_step_ratio`` over it: jump in motion over the largest step near by, at least.",
        "judgement",
    )
    tare_zero_sd: float = setting(
        4.0, "sd", "Standard deviations of its mean within which a reading is zero.", "statistics"
    )

    # two publishers
    two_source_samples: int = setting(40, "1", "Samples from which two sources are recognised.", "judgement")
    two_source_variance_share: float = setting(
        0.05,
        "1",
        "Squared median second difference within each of the two levels, over that of all samples, below which "
        "there are two: the variance within two halves of normal noise is 0.36 of the whole, of uniform noise 0.25.",
        "judgement",
    )
    two_source_share: float = setting(0.2, "1", "Least share of samples of each source. Fewer are spikes.", "judgement")
    two_source_turns_share: float = setting(
        0.25,
        "1",
        "Share of samples at which the source is another one than before, at least. Fewer are steps of what "
        "is measured.",
        "judgement",
    )
    two_source_distance: float = setting(
        1e-9,
        "m, N",
        "Distance between the levels below which they are round-off of a simulated recording: no sensor resolves it.",
        "judgement",
    )

    # units of wrenches
    unit_noise_factor: float = setting(
        1.6, "1", "Factor within which the noise, over that of the rig, may be that of another unit.", "judgement"
    )
    loud_noise_ratio: float = setting(
        8.0, "1", "Noise over that of the rig from which it is another sensor, or another unit.", "judgement"
    )
    lever_arm_ratio: float = setting(
        2.0,
        "1",
        "Lever arm of the wrench, over the size of the rig, from which torques and forces are not of one unit "
        "of length.",
        "judgement",
    )
    beyond_range_factor: float = setting(
        1.05, "1", "Readings over the range of a sensor that it cannot have: ranges are rounded.", "judgement"
    )
    lever_arm_signal_ratio: float = setting(
        10.0, "1", "Forces over their noise from which a lever arm is looked at.", "judgement"
    )


OBSERVATIONS = ObservationsSettings()
