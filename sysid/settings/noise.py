"""Settings of ``sysid.noise``."""

from __future__ import annotations

from dataclasses import dataclass

from sim_core.settings import setting


@dataclass(frozen=True)
class NoiseSettings:
    """Settings of the estimation of noise: rests, level, autocorrelation, common modes, quantisation, and data
    quality."""

    # rests
    rest_margin_s: float = setting(
        0.15, "s", "Time after the end of a motion that is not counted as quiet.", "judgement"
    )
    still_window_s: float = setting(
        0.1, "s", "Time over which noisy poses are averaged to see whether they move.", "judgement"
    )
    still_shift_m: float = setting(
        1e-5,
        "m",
        "Shift within ``still_window_s`` from which something moves (0.1 mm/s), and in a whole stretch from which "
        "it creeps: less than arms repeat (20 to 100 um), and on a pad of 1 N/mm about the noise of a force sensor.",
        "judgement",
    )
    still_turn_rad: float = setting(
        1e-4,
        "rad",
        "Turn within ``still_window_s`` from which something moves (1 mrad/s), and likewise creeps.",
        "judgement",
    )
    motion_over_noise: float = setting(
        6.0,
        "1",
        "The least way from one pose to the next that counts as motion, over the noise, from which neighbours "
        "tell it: 4 standard deviations of their difference.",
        "judgement",
    )
    creep_window_s: float = setting(
        1.0, "s", "Time in which a slower motion may get as far as one that counts.", "judgement"
    )

    # level of noise
    unlike_rests_ratio: float = setting(
        2.2, "1", "Ratio of the noise of two recordings at rest from which the louder one is not at rest.", "judgement"
    )
    noise_floor_share: float = setting(
        1e-5,
        "1",
        "Noise is not taken to be below this share of a column group's range (noise-free simulations).",
        "judgement",
    )
    neighbour_intervals: float = setting(
        10.0,
        "sampling intervals",
        "Readings farther apart than this many sampling intervals of their sensor are states of their own: "
        "their differences are motion, not noise, and the noise is the declared one.",
        "judgement",
    )
    smooth_rest_share: float = setting(
        0.1,
        "1",
        "Share of the differences that noise of the level and colour of a stretch has, from which the stretch "
        "is at rest.",
        "judgement",
    )
    trend_crossings: float = setting(
        6.0,
        "1",
        "Crossings of readings with a straight line, up to which a smooth stretch may be a trend.",
        "judgement",
    )
    held_reading_share: float = setting(
        0.2,
        "1",
        "Share of readings that repeat the one before, from which differences say nothing of noise.",
        "judgement",
    )
    trend_over_declared_noise: float = setting(
        100.0,
        "1",
        "Standard deviation of a smooth stretch, over the declared noise, from which its readings are motion.",
        "judgement",
    )
    declared_noise_ratio: float = setting(
        2.0,
        "1",
        "A declared noise of this many times the estimated one takes the place of the latter altogether.",
        "judgement",
    )
    rest_outlier_sd: float = setting(
        8.0, "sd", "Distance in robust standard deviations from which a reading at rest is a mistake.", "judgement"
    )
    rest_outlier_share: float = setting(
        0.1, "1", "Largest share of readings at rest that may be such mistakes.", "judgement"
    )
    min_rest_samples: int = setting(15, "1", "Samples that a quiet stretch must have to be used.", "judgement")
    longest_exact_samples: int = setting(
        400, "1", "Samples of a stretch up to which it matters what a line takes away from coloured noise.", "cost"
    )
    white_correlation: float = setting(0.1, "1", "Correlation up to which noise counts as white.", "judgement")
    largest_correlation: float = setting(0.98, "1", "Largest correlation of noise that is accepted.", "judgement")

    # sampling
    shortest_interval: float = setting(
        0.5,
        "usual intervals",
        "Least time from one sample to the next. Sensors sample evenly and stamps do not: two messages that "
        "were stamped at once are no measurement of how fast noise changes.",
        "judgement",
    )
    gap_interval: float = setting(
        1.5, "usual intervals", "Time from one sample to the next from which one is missing between them.", "convention"
    )

    # quantisation
    same_value_share: float = setting(
        2.5e-7,
        "1",
        "Values closer than this share of the largest of a column are the same: twice what single precision "
        "tells apart.",
        "convention",
    )
    multiple_tolerance: float = setting(
        0.05, "steps", "Distance from a multiple, in steps, up to which a value is one.", "judgement"
    )
    fewest_changes: int = setting(
        3, "1", "Changes of a column from which they tell whether it has a step: a spike alone makes two.", "judgement"
    )
    uneven_triples_share: float = setting(
        0.3,
        "1",
        "Triples of readings that are multiples and go on by another number of steps than before, for each "
        "change, where there is a step: two for each where readings mostly repeat, 0.5 on average where they "
        "do not, few in an even motion.",
        "judgement",
    )

    # autocorrelation and spectra
    shortest_correlation_samples: float = setting(1.5, "samples", "Shortest correlation length.", "judgement")
    correlation_length_ratio: float = setting(
        3.0, "1", "Largest ratio of one correlation length to the next.", "judgement"
    )
    longest_correlation_share: float = setting(
        0.2,
        "1",
        "Longest correlation length, in lengths of the longest recording: slower drift looks like a parameter.",
        "judgement",
    )
    largest_lag_share: float = setting(1.0 / 3.0, "1", "Largest lag, in lengths of the longest recording.", "judgement")
    transformed_at_once: float = setting(4e6, "1", "Numbers that are transformed at a time.", "cost")
    colour_evidence: float = setting(
        6.0,
        "1",
        "By how much colour must lower the sum of squares over lags, in units of their variance by white "
        "noise, to be accepted.",
        "judgement",
    )
    spectrum_frequencies: int = setting(512, "1", "Frequencies that a spectrum is averaged over.", "cost")
    two_spectra_chance: float = setting(
        1e-3, "1", "Share of the sensors with one spectrum of noise that are taken to have two.", "convention"
    )
    white_part_gain: float = setting(
        4.0, "nats", "Log likelihood that a white part in addition to the coloured one must be worth.", "judgement"
    )
    trend_degree: int = setting(
        2,
        "1",
        "Degree of the polynomial that a stretch may follow by itself: a motion that begins slowly is no noise.",
        "judgement",
    )
    mixture_columns: int = setting(
        12, "1", "Columns of a quantity that are asked: they share level and colour.", "cost"
    )
    colour_intervals: float = setting(
        10.0,
        "sampling intervals",
        "Prior median of the sampling intervals over which coloured noise, next to white, is correlated.",
        "judgement",
    )
    colour_intervals_log_sd: float = setting(
        1.0, "1", "Prior standard deviation of the logarithm of ``colour_intervals``.", "judgement"
    )

    # common modes of pictures
    common_mode_markers: int = setting(
        6, "1", "Markers from which a picture tells what they have in common.", "judgement"
    )
    common_mode_least_excess: float = setting(
        0.25,
        "1",
        "Variance that a mode must have beyond what the markers' own noise makes of it, in units of that, to be "
        "weighed: below, the square of a score along it is off by less.",
        "cost",
    )
    common_mode_sizes: tuple[float, float] = setting(
        (0.05, 2e3),
        "1",
        "Least and largest variance of a mode's noise, over that of the markers' own, that its likelihood is "
        "integrated over.",
        "convention",
    )
    common_mode_size_count: int = setting(30, "1", "Number of these variances.", "cost")
    common_mode_outlier_sd: float = setting(
        5.0,
        "sd",
        "Robust standard deviations beyond which a displacement does not count for what markers have in common.",
        "judgement",
    )
    restless_ratio: float = setting(
        1.5,
        "1",
        "Ratio of what is left in a stretch to that in the calmest one from which something moves in it.",
        "judgement",
    )

    # data quality
    few_instants: int = setting(
        10,
        "1",
        "Instants with readings, of all recordings together, below which a fit that explains them says little.",
        "judgement",
    )
    listed_faults: int = setting(
        3, "1", "Faults of a recording that are named; the notes have the others.", "judgement"
    )
    scatter_readings: int = setting(30, "1", "Readings from which their scatter is judged.", "judgement")
    restless_over_declared: float = setting(
        1.3,
        "1",
        "Scatter of readings in a recording without motion, over the declared noise, from which they are not "
        "those of rest.",
        "judgement",
    )
    restless_over_neighbours: float = setting(
        10.0, "1", "The same over the scatter of neighbouring samples, where no noise is declared.", "judgement"
    )
    noise_levels_ratio: float = setting(
        3.0,
        "1",
        "Ratio of the noise of two recordings from which they are not weighed alike without a word.",
        "judgement",
    )


NOISE = NoiseSettings()
