"""Settings of ``sysid.progress``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sim_core.settings import setting


@dataclass(frozen=True)
class ProgressSettings:
    """Settings of what is said of the time that is left. They change no result."""

    silence_s: float = setting(
        9.0,
        "s",
        "A line comes after so long without one: before the 10 s for which a user's attention lasts (Nielsen 1993).",
        "convention",
    )
    least_time_s: float = setting(
        1.0,
        "s",
        "Time after which shares that are done give the time left: what is shorter does not interrupt a user's thought "
        "(Nielsen 1993).",
        "convention",
    )
    least_pause_s: float = setting(0.5, "s", "Rollouts that run are reported no more often.", "cost")
    most_share: float = setting(
        0.99, "1", "Share that is done at most, until all is: the last whole percentage before 100.", "convention"
    )
    overdue_share: float = setting(
        0.1,
        "1",
        "Share of an estimate, of the time left or of the rollouts of a stage, that is left at least until it is over.",
        "judgement",
    )

    # costs of rollouts before one of the kind has run: geometric means over three rigs
    # (tests/support/costs_of_rollouts.py)
    finer_cost_ratio: float = setting(
        7.0, "1", "Cost of a rollout on cells half as large over that on the rig's, over three rigs.", "measured"
    )
    shorter_cost_ratio: float = setting(
        1.7, "1", "Cost of a rollout with shorter steps over that with the rig's, over three rigs.", "measured"
    )
    derivatives_cost_ratio: float = setting(
        1.8, "1", "Cost of a rollout with derivatives over a plain one, over three rigs.", "measured"
    )
    responses_cost_ratio: float = setting(
        28.0, "1", "Cost of a rollout with responses to all effects over a plain one, over two rigs.", "measured"
    )
    beginning_cost_ratio: float = setting(
        0.4, "1", "Cost of a rollout of the beginning of a recording over a whole one, over three rigs.", "measured"
    )

    # stages
    fit_rollouts: Mapping[str, Mapping[str, float]] = setting(
        {
            "set-up": {"beginning": 2},
            "search": {
                "plain": 2,
                "shorter": 1,
                "finer": 1,
                "derivatives": 14,
                "shorter derivatives": 1,
                "finer derivatives": 1,
            },
            "intervals": {"derivatives": 4},
        },
        "1",
        "Rollouts of each kind for each recording of a fit, by its stage.",
        "measured",
    )
    fit_between_s: Mapping[str, float] = setting(
        {"set-up": 0.5, "search": 7.0, "intervals": 4.5}, "s", "Processor time between rollouts of a fit.", "measured"
    )
    diagnosis_rollouts: Mapping[str, Mapping[str, float]] = setting(
        {
            "set-up": {"beginning": 2},
            "baseline": {"plain": 3, "shorter": 2, "finer": 2, "derivatives": 12},
            "effects": {"responses": 1, "plain": 1, "derivatives": 5},
            "sets of effects": {"plain": 60, "derivatives": 30},
            "report": {},
        },
        "1",
        "Rollouts of each kind for each recording of a diagnosis, by its stage.",
        "measured",
    )
    diagnosis_between_s: Mapping[str, float] = setting(
        {"set-up": 0.6, "baseline": 2.5, "effects": 5.5, "sets of effects": 35.0, "report": 7.5},
        "s",
        "Processor time between rollouts of a diagnosis.",
        "measured",
    )


PROGRESS = ProgressSettings()
