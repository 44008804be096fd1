"""Settings of ``sysid.discretisation``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sim_core.settings import setting


@dataclass(frozen=True)
class DiscretisationSettings:
    """Settings of meshes and time steps: budgets of their error, refinement at contacts, and how far they are
    extrapolated."""

    # error of mesh and time step
    error_rounds: int = setting(8, "1", "Times that the error is measured and the fit repeated.", "cost")
    remeasured_sd: float = setting(
        1.0,
        "sd",
        "Rounds end when a search has moved no parameter by more than a standard deviation from where the "
        "error and its slopes were measured.",
        "judgement",
    )
    slopes_reach: float = setting(
        0.25,
        "plausible ranges",
        "How far derivatives of the discretisation error are extrapolated, in plausible ranges of a parameter.",
        "judgement",
    )
    loud_error_ratio: float = setting(
        10.0,
        "1",
        "Error of mesh and time step over noise from which a result says that it rests on that error.",
        "judgement",
    )
    mesh_order: int = setting(
        2, "1", "Power of the size of cells that the error of the mesh is proportional to.", "convention"
    )
    coarse_range_share: float = setting(
        0.1,
        "1",
        "Error of mesh and time step, in units of the range of the readings, from which a mesh is too coarse "
        "to ask what is missing; ``coarse_noise_ratio`` has to be reached as well.",
        "judgement",
    )
    coarse_noise_ratio: float = setting(3.0, "1", "The same in units of the noise of the readings.", "judgement")

    # named approximations
    approximation_sizes: Mapping[str, tuple[float, float]] = setting(
        {
            "contact range": (1.0, 0.3),
            "touching surface": (0.5, 0.5),
            "gel extent": (0.0, 0.1),
            "averaging of a sensor": (1.0 / 6.0, 0.269),
        },
        "1",
        "Mean and standard deviation of the size of each approximation, in units of the extrapolated error.",
        "judgement",
    )
    drawn_motions: int = setting(48, "1", "Motions that are drawn from what the noise of poses leaves open.", "cost")
    rolled_motions: int = setting(6, "1", "Of them those along which a rollout is made as well.", "cost")
    faint_motion: float = setting(
        0.3,
        "sd",
        "Singular value of their responses, in standard deviations of the noise, from which one is kept: a fainter one "
        "changes evidence by 0.04 nats at most where it has its expected size.",
        "convention",
    )

    # time steps
    interpolation_over_noise: float = setting(
        1.0 / 3.0,
        "1",
        "Error of the interpolation over the noise, rms over the columns of a quantity, from which a step is halved.",
        "judgement",
    )
    step_halvings: int = setting(4, "1", "Times that steps are halved: to a sixteenth of the rig's.", "cost")
    halving_over_noise: float = setting(
        1.0,
        "1",
        "Change by halved steps over the noise, rms over the columns of a quantity, from which all steps of a "
        "run with inertia are halved.",
        "judgement",
    )
    halving_quantile: float = setting(
        0.75, "1", "Quantile over time of that change that counts: impacts never agree.", "judgement"
    )
    largest_misfit_ratio: float = setting(
        30.0, "1", "Misfit over noise from which it counts no more: a few readings do not decide.", "judgement"
    )

    # budgets
    budget_over_noise: float = setting(
        1.0 / 3.0,
        "1",
        "Error over noise that mesh, time step and contact constants each have to be below.",
        "judgement",
    )
    budget_rounds: int = setting(8, "1", "Times that the errors of mesh, time step and contact are measured.", "cost")
    contact_order: int = setting(
        1, "1", "Power of the range of contact that its error is proportional to.", "convention"
    )
    least_contact_range_m: float = setting(1e-8, "m", "Range of contact below which a rig may not go.", "judgement")
    timed_twice_s: float = setting(60.0, "s", "Wall time up to which a simulation is timed twice.", "cost")

    # cells of searches, cells at contacts, and extent of pads
    searched_nodes: int = setting(
        2500,
        "1",
        "Nodes of gels above which searches of a diagnosis are made with coarser cells than the rig's: with 5,000 "
        "a baseline takes over half an hour.",
        "cost",
    )
    edge_over_contact_radius: float = setting(
        1.25,
        "1",
        "Longest edge in the contact over its radius: the force of a sphere on a bonded layer is then within 1 %.",
        "measured",
    )
    most_edge_ratio: float = setting(
        2.5, "1", "Longest edge of the rig over that of the refined cells, at most: finer ones take too long.", "cost"
    )
    least_edge_ratio: float = setting(
        1.2,
        "1",
        "Longest edge of the rig over that of the refined cells, from which cells are made finer at all.",
        "judgement",
    )
    contact_margin: float = setting(
        0.2, "1", "What the box reaches beyond what is touched, over the radius of the contact.", "judgement"
    )
    contact_instants: int = setting(60, "1", "Instants of a recording at which contacts are looked for.", "cost")
    wide_pad_ratio: float = setting(
        6.0,
        "1",
        "Extent over thickness of a pad that is as good as infinite, by the Fourier integral of a layer "
        "(tests/discretisation/test_gel_extent.py).",
        "measured",
    )
    wide_enough_share: float = setting(
        0.8, "1", "Share of ``wide_pad_ratio`` from which a pad is not made wider.", "judgement"
    )
    added_cells: int = setting(4, "1", "Cells that are added along an axis.", "judgement")

    # finer models that recordings follow
    follow_outlier_rms: float = setting(
        5.0, "1", "Misfit over its root mean square from which a reading is taken for a mistake.", "judgement"
    )
    followed_share_sd: float = setting(
        0.1,
        "1",
        "Standard deviation of the share up to which recordings tell of two models which they follow.",
        "judgement",
    )
    largest_followed_share: float = setting(
        2.5, "1", "Share up to which it is one of these two models that recordings follow.", "judgement"
    )
    follow_blocks: int = setting(
        8, "1", "Parts of the time of a recording that tell of a share independently of each other.", "judgement"
    )
    confounded_sd_ratio: float = setting(
        3.0,
        "1",
        "Standard deviation of a share as its parts of the time tell it, over that of noise alone, above "
        "which what is missing decides on it.",
        "judgement",
    )


DISCRETISATION = DiscretisationSettings()
