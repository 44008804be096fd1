"""Settings of ``sysid.fit``."""

from __future__ import annotations

from dataclasses import dataclass

from sim_core.settings import setting


@dataclass(frozen=True)
class FitSettings:
    """Settings of a fit: starts, searches from elsewhere, ways back to the start, comparisons with given values."""

    # course of a fit
    interval_looks: int = setting(
        3,
        "1",
        "Times that a fit is looked at where its intervals end; where it is better there it is searched for "
        "on from there.",
        "cost",
    )
    outlier_looks: int = setting(
        3, "1", "Times that mistaken readings are looked for and the fit repeated without them.", "cost"
    )
    search_evaluations: int = setting(30, "1", "Evaluations after which one search ends, converged or not.", "cost")

    # starts
    most_restarts: int = setting(4, "1", "Searches that a whole fit starts near the best so far.", "cost")
    restart_width: float = setting(
        0.05, "unit steps", "Standard deviation of restarts about the best so far.", "judgement"
    )
    start_width: float = setting(
        0.7,
        "plausible widths",
        "Standard deviation of starts about the rig's values in units of the plausible width: e^1.4 either "
        "way for a modulus, 0.35 for friction.",
        "judgement",
    )
    draws_per_start: int = setting(
        4, "1", "Draws, without derivatives, for each start other than the rig's own.", "cost"
    )
    offset_draws: int = setting(32, "1", "Draws, without derivatives, of the offsets of all end effectors.", "cost")
    offset_searches: int = setting(
        3, "1", "Searches from other offsets, of which each must bring something for the next to be made.", "cost"
    )
    better_chi2_ratio: float = setting(
        0.98,
        "1",
        "A search from elsewhere has brought something if it leaves less than this share of chi-square.",
        "judgement",
    )
    far_start_ratio: float = setting(
        0.5,
        "1",
        "A search that leaves less than this share of the chi-square where it began is far from there.",
        "judgement",
    )
    patience_evaluations: int = setting(3, "1", "Evaluations by whose progress a search is judged.", "judgement")
    slow_chi2_ratio: float = setting(
        0.8,
        "1",
        "A search comes on slowly while ``patience_evaluations`` leave more than this share of chi-square.",
        "judgement",
    )
    same_chi2: float = setting(
        4.0,
        "1",
        "Two searches have ended equally well if their chi-squares differ by less than this, in units of what "
        "chance makes of it.",
        "statistics",
    )
    same_place_sd: float = setting(
        4.0,
        "sd",
        "Two searches have ended in one place if no parameter that is asked for differs by this many standard "
        "deviations.",
        "statistics",
    )

    # nearest of all equally good values
    chi2_rise: float = setting(
        2.0,
        "1",
        "Rise of chi-square, in units of what chance makes of it, that a value nearer to the start may cost. "
        "A look along intervals calls a fit better from 3.8 on.",
        "judgement",
    )
    distance_weights: tuple[float, ...] = setting(
        (1.0, 0.1, 0.01), "1", "Weights of the distance from the start, tried in turns.", "judgement"
    )
    way_back_steps: int = setting(8, "1", "Steps on the way back, for each weight.", "cost")
    way_back_fall: float = setting(
        0.05,
        "1",
        "Fall of the penalised sum of squares, promised by the next step, below which the way back to the start ends.",
        "cost",
    )
    step_shares: tuple[float, ...] = setting(
        (1.0, 0.5, 0.25), "1", "Shares of a step that are tried in turns.", "convention"
    )

    # comparisons
    worse_error_ratio: float = setting(
        1.1,
        "1",
        "Factor by which the error of a channel must rise to be called larger than before; it must also stand "
        "out of the noise.",
        "judgement",
    )
    explained_over_noise: float = setting(
        1.25, "1", "Error over noise up to which a channel is explained.", "judgement"
    )
    explained_over_discretisation: float = setting(
        1.0 / 3.0,
        "1",
        "Error over that of mesh and time step up to which a channel is explained as well: no recording of "
        "anything else than this mesh and step is.",
        "judgement",
    )
    field_markers: int = setting(4, "1", "Markers in sight below which there is no field to look at.", "judgement")
    coverage_refinement: int = setting(
        3,
        "1",
        "How much finer the truth is than the fit, in cells in each direction and in steps: no 2, with which "
        "fits learn their discretisation error.",
        "judgement",
    )
    coverage_progress_s: float = setting(1.0, "s", "Progress is reported at least as often.", "judgement")


FIT = FitSettings()
