"""Settings of ``sysid.solve``."""

from __future__ import annotations

from dataclasses import dataclass

from sim_core.settings import setting


@dataclass(frozen=True)
class SolveSettings:
    """Settings of estimation: searches, the error of mesh and time step, outliers, and covariance."""

    # Gauss-Newton
    sharper_tolerance_share: float = setting(
        0.5,
        "1",
        "A search that ends where chance makes less than this of what was thought before goes on from there.",
        "judgement",
    )
    resumed_radius: float = setting(
        0.1,
        "plausible widths",
        "Least radius, in plausible widths, with which a search goes on after another one.",
        "judgement",
    )
    in_sight_share: float = setting(
        0.9,
        "1",
        "Least share of the readings that were in sight anywhere that a point must have in sight, since those "
        "of it that are not say nothing of it.",
        "judgement",
    )
    calibration_first_share: float = setting(
        0.5,
        "1",
        "Share of the sum of squares at the start that the calibration of sensors has to promise to be "
        "searched for first.",
        "judgement",
    )
    calibration_radius: float = setting(
        30.0,
        "plausible widths",
        "Radius of the trust region of the calibration of sensors: readings are nearly linear in it.",
        "judgement",
    )
    calibration_evaluations: int = setting(4, "1", "Evaluations allowed to the calibration of sensors.", "cost")
    short_step_sd: float = setting(
        0.2,
        "sd",
        "Step that is too short to be taken, in standard deviations of each parameter that is asked for.",
        "judgement",
    )

    # trust region over kinks
    good_fall_share: float = setting(
        0.75, "1", "Share of the promised fall of the sum of squares above which the region grows.", "convention"
    )
    poor_fall_share: float = setting(
        0.25, "1", "Share of the promised fall of the sum of squares below which the region shrinks.", "convention"
    )
    radius_after_refusal: float = setting(
        0.5, "1", "Radius, as a share of the last step, after one step that was refused.", "convention"
    )
    radius_after_refusals: float = setting(0.25, "1", "The same after more than one refused step.", "convention")
    negligible_change_share: float = setting(
        0.25,
        "1",
        "A step was too short to matter if it changes residuals, in squares, by less than this share of the tolerance.",
        "judgement",
    )
    beyond_kink_share: float = setting(
        0.5,
        "1",
        "A point lies beyond a kink if the derivatives at the best miss its sum of squares by this share of "
        "the change.",
        "judgement",
    )
    model_radii: float = setting(2.0, "radii", "Points within this many radii take part in the model.", "judgement")
    cut_step_share: float = setting(
        0.99, "1", "A step of more than this share of the radius may have been cut by it.", "judgement"
    )
    model_points: int = setting(6, "1", "Points other than the best that take part in the model, the newest.", "cost")
    kept_points: int = setting(12, "1", "Points that are kept, the newest.", "cost")
    final_steps: int = setting(
        3, "1", "Steps within the tolerance that are taken, since they are not short, before the search ends.", "cost"
    )
    serious_fall: float = setting(
        8.0,
        "tolerances",
        "Promised fall within radius 1, in tolerances, from which a jump before it matters: with a tolerance "
        "of half of what chance makes of the sum of squares, where a 95 % interval of one parameter ends.",
        "judgement",
    )
    smallest_radius: float = setting(1e-7, "plausible widths", "Radius at which the search ends.", "judgement")
    step_ridge: float = setting(
        1e-4, "1", "Weight of the square of the step: what no residual sees stays where it is.", "judgement"
    )

    # error of mesh and time step
    expected_error_size: float = setting(
        0.5, "1", "Expected size of a direction, in units of the extrapolated error.", "judgement"
    )
    error_size_sd: float = setting(
        0.5,
        "1",
        "Standard deviation of the constant part of the size of a direction, and of its drift in time.",
        "judgement",
    )
    error_course_levels: tuple[tuple[int, float], ...] = setting(
        ((6, 2**-0.5), (12, 0.5), (24, 8**-0.5)),
        "1",
        "Instants of a run between which the size of a direction is interpolated, and how strong each level is.",
        "judgement",
    )
    error_patterns: int = setting(
        3, "1", "Principal components of a direction that may take a course of their own.", "judgement"
    )
    pattern_levels: int = setting(2, "1", "Levels of which the course of such a component is made.", "judgement")
    faint_pattern_share: float = setting(
        1e-3, "1", "Share of the strongest component below which others are left out.", "judgement"
    )
    rough_error_share: float = setting(
        0.25,
        "1",
        "Part of the error that follows no shape, in units of the largest error thereabouts: once of what "
        "lasts, once of what is new with every sample.",
        "judgement",
    )
    allowed_error_factor: float = setting(
        2.0,
        "1",
        "Discretisation error that is allowed for where what is left is judged, in units of the largest error "
        "thereabouts: one refinement tells its size to within a factor of two.",
        "judgement",
    )

    # mistaken readings of markers
    outlier_sd: float = setting(
        6.0,
        "sd",
        "Distance, in noise deviations of a vector's component, below which nothing is a mistake.",
        "judgement",
    )
    outlier_frames: int = setting(9, "1", "Frames before and after that a reading is compared with.", "judgement")
    outlier_frame_share: float = setting(
        1.0 / 3.0,
        "1",
        "Share of the markers of a frame that may stand out at once (one always may, and two exchanged ones).",
        "judgement",
    )
    outlier_channel_share: float = setting(
        0.2, "1", "Share of the readings of a channel from which they are no exceptions.", "judgement"
    )
    exchanged_marker_share: float = setting(
        0.3, "1", "A reading this much nearer to another marker's place than to its own is of that marker.", "judgement"
    )
    outlier_markers: int = setting(5, "1", "Markers of a frame below which nothing is a mistake.", "judgement")
    alike_vector_share: float = setting(
        0.5, "1", "Vectors are alike that differ by less than this share of the longer one.", "judgement"
    )
    outlier_neighbours: int = setting(4, "1", "Nearest markers that a reading is compared with.", "judgement")
    outlier_chance: float = setting(
        0.01,
        "1",
        "Probability below which as many alike, or as many times the same marker, are no chance.",
        "statistics",
    )
    outlier_repetitions: int = setting(
        4, "1", "Times that a marker stands out from which it may be physics.", "judgement"
    )

    # spikes of wrenches
    spike_sd: float = setting(10.0, "sd", "Distance, in noise deviations, below which nothing is a spike.", "judgement")
    lone_spike_ratio: float = setting(
        10.0, "1", "A spike is this many times as far from the line as its neighbours are.", "judgement"
    )
    spike_side_samples: int = setting(
        4, "samples", "Samples before and after that a reading is compared with.", "judgement"
    )
    level_change_sd: float = setting(
        6.0,
        "sd",
        "Change of level across a reading, in noise deviations, from which it is an event (its own deviation is 1.7).",
        "judgement",
    )
    predicted_spike_share: float = setting(
        0.1, "1", "Share of a spike from which an event of the prediction explains it.", "judgement"
    )
    alike_spike_share: float = setting(
        0.5, "1", "Spikes are alike that differ by less than this share of the longer one.", "judgement"
    )
    alike_spikes: int = setting(3, "1", "Number of alike spikes that are no accident.", "judgement")

    # covariance
    sandwich_blocks: int = setting(
        12,
        "1",
        "Blocks of neighbouring samples that each run and channel is cut into for the sandwich estimate.",
        "judgement",
    )
    undetermined_share: float = setting(
        0.5,
        "1",
        "A direction whose standard deviation exceeds this share of what it is judged by, "
        "``FitParameter.width``, is not determined.",
        "judgement",
    )
    widest_sd: float = setting(
        10.0,
        "plausible ranges",
        "Largest standard deviation that is reported, in plausible ranges: beyond it nothing is known anyway.",
        "judgement",
    )
    uninformative_ratio: float = setting(
        0.95,
        "1",
        "Standard deviation, over that of what was known before, from which recordings add nothing.",
        "judgement",
    )
    poor_reduced_chi2: float = setting(
        4.0,
        "1",
        "Reduced chi-square from which a rig misses recordings by so much that what was known decides alone.",
        "judgement",
    )
    combined_correlation: float = setting(
        0.97, "1", "Correlation from which two parameters are reported as known only in combination.", "judgement"
    )


SOLVE = SolveSettings()
