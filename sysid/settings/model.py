"""Settings of ``sysid.model``."""

from __future__ import annotations

from dataclasses import dataclass

from sim_core.settings import setting


@dataclass(frozen=True)
class ModelSettings:
    """Settings of the model of recordings: plausible ranges, nuisance parameters, derivatives, and time spans."""

    # parameters
    plausible_log_sd: float = setting(
        2.0, "1", "Width of the plausible range of a logarithm: a factor of e^2 either way.", "judgement"
    )
    at_bound_share: float = setting(
        0.01,
        "1",
        "A value this close to a bound, in units of its standard deviation or of its range, is at the bound.",
        "judgement",
    )
    rig_difference_step: float = setting(
        1e-5,
        "1",
        "Half width, in the fitted scale, of the differences that tell what a parameter changes in the rig.",
        "convention",
    )

    # nuisance parameters
    bias_sd: tuple[float, ...] = setting(
        (5.0, 0.5),
        "N, N m",
        "Least standard deviation of the bias of a force [N] and of a torque [N m]: that of 5 N at 0.1 m.",
        "judgement",
    )
    bias_share: float = setting(
        0.5,
        "1",
        "Least standard deviation of a bias in units of the largest force or torque in the recording, where "
        "that is more.",
        "judgement",
    )

    # rollouts
    kept_paths: int = setting(48, "1", "Rollouts of which paths are kept, of some megabytes each.", "cost")
    kept_states: int = setting(64, "1", "States that are kept.", "cost")
    carried_evaluations: int = setting(5, "1", "Evaluations in a row without derivatives of their own.", "cost")
    fresh_derivatives_sd: float = setting(
        3.0,
        "sd",
        "Step, in standard deviations of what is known of the parameters, from which derivatives are made anew.",
        "judgement",
    )

    # time
    registration_reach_s: float = setting(
        30.0, "s", "Poses so long before and after a first frame are kept with it: no latency is longer.", "cost"
    )
    last_poses_s: float = setting(
        1.0, "s", "Time before the last pose that tells whether the end effector stands still there.", "judgement"
    )
    still_end_s: float = setting(
        0.1,
        "s",
        "An end effector that has not moved for so long before its last pose stands still: it is then taken "
        "to stay for ``max_gap_s``.",
        "judgement",
    )
    window_rest_s: float = setting(
        0.2,
        "s",
        "Time before a window in which nothing should move, and of which readings are compared with those of rest.",
        "judgement",
    )
    window_rest_sd: float = setting(
        6.0, "sd", "Difference from rest, over its standard deviation, that is reported.", "judgement"
    )


MODEL = ModelSettings()
