"""Settings of ``sysid.diagnosis``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sim_core.settings import setting


@dataclass(frozen=True)
class DiagnosisSettings:
    """Settings of a diagnosis: baseline, effects, fits of sets, place and time of a mismatch, next experiment."""

    # baseline
    baseline_evaluations: int = setting(8, "1", "Evaluations allowed to the fit of the baseline.", "cost")
    baseline_evaluations_on: int = setting(
        5, "1", "Evaluations allowed to it with the error of mesh and time step, measured where it came to.", "cost"
    )
    fit_tolerance: float = setting(
        2.0,
        "1",
        "Fall of chi-square, in units of the misfit, below which fits of the baseline and of candidate models end.",
        "judgement",
    )
    branch_misfit_ratio: float = setting(
        2.0,
        "1",
        "Misfit over noise from which other branches of contact are looked for, by the upper quartile of what "
        "is left of the readings, over that of normal numbers: a snap or a landing is no other branch.",
        "judgement",
    )
    friction_factors: tuple[float, ...] = setting(
        (0.7, 0.85, 1.15, 1.4), "1", "Friction coefficients that are tried, over where the search ended.", "judgement"
    )
    offset_draws: int = setting(3, "1", "Random places of the hands that are tried as other branches.", "cost")
    better_loss_ratio: float = setting(
        0.98, "1", "Loss below which another branch is better, over that of the first.", "judgement"
    )
    cauchy_width_sd: float = setting(
        3.0, "sd", "Whitened residual that counts as far in the loss by which branches are compared.", "convention"
    )

    # what is known before
    known_sd: Mapping[str, float] = setting(
        {"E_pa": 0.35, "density_kg_m3": 0.05, "nu": 0.05, "friction": 0.15},
        "1",
        "How well a rig's numbers are known where nothing is said: moduli and densities by their logarithm (a "
        "data sheet of a similar product, a balance), Poisson ratios and friction coefficients by themselves.",
        "judgement",
    )
    known_damping_share: float = setting(0.5, "1", "How well a damping is known, in units of its value.", "judgement")
    far_from_known_sd: float = setting(
        3.0,
        "sd",
        "Standard deviations of what was known of a parameter from which its fitted value needs explaining.",
        "statistics",
    )
    drawn_predictions: int = setting(
        6, "1", "Draws of the parameters with which recordings held out are predicted as well.", "cost"
    )

    # which effects are looked at
    grid_points: int = setting(
        4,
        "1",
        "Points of the grid over the shapes and sizes of one effect. Each costs an evaluation of the law a step.",
        "cost",
    )
    threshold_grid_points: int = setting(
        6, "1", "The same of an effect with a threshold, whose misfit has several minima.", "cost"
    )
    amplitude_sizes: int = setting(
        2,
        "1",
        "Typical sizes of an amplitude that stands alone, each looked at by itself: laws are not linear in them.",
        "cost",
    )
    largest_amplitude: float = setting(
        3.0,
        "typical sizes",
        "Largest size, in units of the typical one, to which a response is extrapolated.",
        "judgement",
    )

    hold_out_from: int = setting(
        3, "1", "Number of recordings from which the last is held out where none is.", "judgement"
    )
    refit_evaluations: int = setting(12, "1", "Evaluations allowed to the fit of a set of effects.", "cost")

    # sets that are fitted
    simulated_effects: int = setting(
        12, "1", "Single effects that are simulated where their fits would begin, before the best of them are.", "cost"
    )
    fitted_sets: int = setting(10, "1", "Sets of effects that are fitted at most.", "cost")
    rival_nats: float = setting(
        30.0,
        "nats",
        "Log odds by which a part of the best set may be less probable to be fitted again from where that stands.",
        "cost",
    )
    fitted_together: int = setting(2, "1", "Sets that are fitted side by side.", "cost")
    fitted_share: float = setting(
        0.05, "1", "Share of the probability of all sets of effects from which a set is fitted.", "convention"
    )
    misfit_deviations: float = setting(
        5.0, "sd", "Standard deviations of chance beyond which a mean square of residuals is no noise.", "convention"
    )
    starts_of_a_set: int = setting(3, "1", "Shapes of a set that its fit may begin with.", "cost")

    # place and time of a mismatch
    time_blocks: int = setting(24, "1", "Blocks of time that a run is cut into.", "convention")
    window_sd: float = setting(
        5.0,
        "sd",
        "A block belongs to a mismatch window when its energy exceeds the noise's by this many deviations, "
        "and ``window_energy_share`` of the energy of the recording's largest block.",
        "judgement",
    )
    window_energy_share: float = setting(
        0.2,
        "1",
        "Share of the energy of a recording's largest block that a block of a mismatch window has at least. What a "
        "model misses in contact alone, a fit halves by an offset of all readings, which then are off "
        "without contact too. A misfit like a half sine over a share ``f`` of the time, less its mean ``2 f / "
        "pi``, leaves there ``(2 f / (pi - 2 f))^2`` of the energy of its largest block: 7 % where f is a "
        "third, 20 % where it is a half.",
        "judgement",
    )
    window_parts: int = setting(8, "1", "Parts of a window that are distinguished.", "convention")
    closure_sd: Mapping[str, float] = setting(
        {"E_pa": 0.5, "friction": 0.3, "density_kg_m3": 0.3, "_m": 1e-3, "_deg": 1.0},
        "fitted scale",
        "Standard deviations of a closure of the mechanics, by the end of a parameter's name.",
        "judgement",
    )
    feature_samples: int = setting(200, "1", "Instants at which a feature of a recording is kept.", "cost")
    feature_axes: int = setting(
        3, "1", "Axes of the motion of the hands, and of the forces, that closures go by at most.", "cost"
    )
    feature_axis_share: float = setting(
        0.05, "1", "Share of the motion along the first axis from which a further one has features.", "convention"
    )
    closure_sensor_share: float = setting(
        0.2, "1", "Standard deviation of the closure of a sensor, in units of the range of its readings.", "judgement"
    )
    closure_clock_s: float = setting(0.02, "s", "Standard deviation of the closure of a clock.", "judgement")
    other_shape_ratio: float = setting(
        5.0,
        "1",
        "Misfit at the first rest over what readings may be off, root mean square over markers, from which a "
        "shape is another one, and how many times as large as in another recording it has to be.",
        "judgement",
    )
    other_shape_share: float = setting(
        0.25,
        "1",
        "The same, as a share of the largest: where one recording is far off, the fit of all is off in the others.",
        "judgement",
    )
    shape_readings: int = setting(3, "1", "Readings at rest that tell a shape.", "judgement")

    # what is reported
    limited_sd_share: float = setting(
        0.7,
        "1",
        "Deviation of an amplitude, as a share of that of what is known before, below which recordings limit it.",
        "judgement",
    )

    # next experiment
    path_margin_share: float = setting(
        0.02, "1", "How far the path may leave the recorded one, over its extent.", "judgement"
    )
    speed_quantile: float = setting(0.95, "1", "Quantile of the recorded speeds that is its speed.", "convention")
    slower_factor: float = setting(2.0, "1", "How many times slower the first pass is.", "judgement")
    least_hold_s: float = setting(2.0, "s", "Least rest in each corner.", "judgement")
    most_hold_s: float = setting(30.0, "s", "Longest rest in each corner.", "cost")
    hold_over_time_constant: float = setting(
        3.0, "1", "Rest in each corner over the time constant of an effect of the answer.", "judgement"
    )
    least_speed: float = setting(1e-4, "m/s, rad/s", "Least speed of a motion.", "judgement")
    # what the posterior says
    sure_probability: float = setting(
        0.9, "1", "Probability from which a set of causes is the only answer of the posterior.", "convention"
    )
    sets_shown: int = setting(5, "1", "Sets of causes of the posterior that are written down.", "convention")

    turn_arm_m: float = setting(0.05, "m", "Length by which turns [rad] are compared with shifts.", "judgement")


DIAGNOSIS = DiagnosisSettings()
