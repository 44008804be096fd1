"""Settings of ``sysid.setup_check``."""

from __future__ import annotations

from dataclasses import dataclass

from sim_core.settings import setting


@dataclass(frozen=True)
class SetupCheckSettings:
    """Settings of the comparison of a recording with its rig and with mistakes of set-up."""

    # what is looked at
    frames: int = setting(16, "1", "Instants of a recording at which readings are compared.", "cost")
    most_steps: int = setting(400, "1", "Steps of the solver in one rollout.", "cost")
    per_frame: int = setting(8, "1", "Readings that are averaged at an instant.", "cost")
    fewest_frames: int = setting(4, "1", "Instants with readings from which a column is compared.", "judgement")
    first_rollout_s: float = setting(
        60.0,
        "s",
        "Processor time of the rollout of the recording as it is, beyond which the rig cannot follow it.",
        "cost",
    )
    rollout_ratio: float = setting(
        3.0, "1", "Processor time of a rollout with other poses, over that of the recording as it is, at most.", "cost"
    )
    rollout_s: float = setting(
        20.0, "s", "Processor time of such a rollout where the recording as it is cannot be followed.", "cost"
    )
    signal_share: float = setting(
        0.9,
        "1",
        "Share of the largest change of each channel that the instants reach, so that the first contact is in.",
        "judgement",
    )
    most_markers: int = setting(24, "1", "Markers of a sensor or camera that are compared.", "cost")
    most_rollouts: int = setting(24, "1", "Rollouts of mistakes in the poses.", "cost")

    # what is tried
    mount_turns_deg: tuple[float, ...] = setting(
        (30.0, -30.0, 45.0, -45.0, 60.0, -60.0),
        "deg",
        "Turns of a sensor or camera on holes of another pattern.",
        "convention",
    )
    same_turn_deg: float = setting(
        3.0, "deg", "Turn of a first pose below which it is printed without one.", "judgement"
    )
    same_place_m: float = setting(1e-4, "m", "Distance of a first pose from the rig's start that is none.", "judgement")
    size_log_reach: float = setting(
        9.0, "1", "Logarithms of sizes of a prediction that are tried, either way.", "convention"
    )
    size_log_step: float = setting(0.02, "1", "Step of these logarithms: the least error of a model.", "convention")

    # how models err
    model_errors: tuple[float, ...] = setting(
        (0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28, 2.56, 5.12),
        "1",
        "Errors of a model over what was measured, of which each hypothesis has the likeliest.",
        "convention",
    )
    error_length: float = setting(
        0.25, "1", "Length over which the error of a model changes, over the instants that are compared.", "judgement"
    )
    layout_error: float = setting(
        0.1, "1", "Standard deviation of a constant shift of markers, over the size of their layout.", "judgement"
    )
    marker_motion_log_sd: float = setting(
        0.5, "1", "Width of the logarithm of the size of the motion of markers that materials may have.", "judgement"
    )
    marker_modes: int = setting(6, "1", "Independent ways in which markers of one body move.", "judgement")

    # decision
    chance_sd: float = setting(
        4.0, "sd", "Standard deviations of a sum of squares of noise from which a channel has changed.", "statistics"
    )
    immaterial_error: float = setting(
        0.08,
        "1",
        "Error of the model, over what was measured, up to which no other poses are tried: materials and meshes do as "
        "much.",
        "judgement",
    )
    likely_nats: float = setting(
        2.0, "1", "Log likelihood below the largest within which the smallest error of a model is taken.", "statistics"
    )
    prior_of_mistake: float = setting(0.1, "1", "Share of recordings with a mistake of set-up.", "judgement")
    begin_elsewhere: float = setting(
        0.1,
        "1",
        "Share of recordings that begin farther from the rig's start, or turned by more, than hands move from there.",
        "judgement",
    )
    odd_size_log: float = setting(
        1.5, "1", "Logarithm of the size of forces, over that by the rig, that is worth a note.", "judgement"
    )
    unit_size_log: float = setting(
        0.5, "1", "Logarithm of the size of forces within which a unit makes up for it.", "judgement"
    )
    sure_odds: float = setting(100.0, "1", "Odds of a mistake against the rig from which it is named.", "statistics")


SETUP_CHECK = SetupCheckSettings()
