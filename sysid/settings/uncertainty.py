"""Settings of ``sysid.uncertainty``."""

from __future__ import annotations

from dataclasses import dataclass

from sim_core.settings import setting


@dataclass(frozen=True)
class UncertaintySettings:
    """Settings of goodness of fit, prior-data conflicts and profile likelihoods."""

    # goodness of fit
    good_misfit: float = setting(
        1.5,
        "1",
        "Mean square of a whitened residual up to which noise, whose size is estimated from a rest, may have left it.",
        "judgement",
    )
    failed_noise_multiple: float = setting(
        10.0,
        "1",
        "Root mean square of what a model leaves, over the noise, from which it is no success: noise is then a "
        "hundredth of what is missed, and intervals widened by it rest on an error of which no law is known.",
        "convention",
    )
    chance_sd: float = setting(
        4.0,
        "sd",
        "Where readings are few: standard deviations by which the mean square of white noise may be above 1.",
        "statistics",
    )
    fewest_readings: int = setting(
        20,
        "1",
        "Readings of a run from which one of its quantities is judged by itself; fewer are judged with those "
        "of other runs.",
        "judgement",
    )

    # estimates of nuisance parameters and conflicts with priors
    nuisance_far_sd: float = setting(
        3.0,
        "sd",
        "Standard deviations from the value of the rig from which a nuisance parameter is worth a sentence.",
        "statistics",
    )
    conflict_sd: float = setting(
        3.0,
        "sd",
        "Standard deviations of the difference from which a prior and the data contradict each other.",
        "statistics",
    )

    # profile likelihood
    deviance_root: float = setting(
        1.959964, "sd", "Root of the deviance at the ends of an interval of 95 %.", "statistics"
    )
    accepted_roots: tuple[float, ...] = setting(
        (1.5, 2.5),
        "sd",
        "Roots of the deviance at the ends of a quadratic interval that is accepted: 23 % off at the most.",
        "judgement",
    )
    farthest_ranges: float = setting(3.0, "plausible ranges", "Farthest that a parameter is taken.", "cost")
    most_points: int = setting(10, "1", "Points on each side of the optimum.", "cost")
    most_steps: int = setting(4, "1", "Evaluations of the rig at one point.", "cost")
    worth_evaluating: float = setting(
        0.1, "1", "Promised fall of the deviance from which another evaluation is worth its time.", "cost"
    )
    beyond_root: float = setting(
        2.1, "sd", "Root of the deviance that a point beyond the end of the interval aims at.", "cost"
    )
    bracket_share: float = setting(
        0.05,
        "1",
        "Share of its distance from the optimum to which an end is bracketed when it counts as known.",
        "judgement",
    )
    typical_evaluations: float = setting(
        2.5, "1", "Evaluations that a side usually takes; progress is scaled with it.", "judgement"
    )


UNCERTAINTY = UncertaintySettings()
