"""``thinshell fit``: estimate parameters of a rig from recordings."""

from __future__ import annotations

from typing import Annotated

import typer

from sysid.cli.bounds import whole_number
from sysid.cli.options import (
    BagsArgument,
    DespiteOption,
    FolderOption,
    FreshBodiesOption,
    HeldOutOption,
    NuisanceOption,
    ParamsOption,
    RigArgument,
    SeedOption,
    WithoutOption,
    check_new,
    parse_names,
    parse_nuisance,
    parse_pairs,
)
from sysid.observations.selection import check_parts
from sysid.progress import interrupts_reported, progress, warn

NOT_CONVERGED = 3
"""Exit code."""

NO_SUCCESS = 4
"""Exit code: the model misses the recordings by far more than their noise."""

KEPT = "Interrupted: what was found so far is put together."


def fit(
    rig: RigArgument,
    bags: BagsArgument,
    params: ParamsOption,
    out: FolderOption,
    held_out: HeldOutOption = None,
    seed: SeedOption = 0,
    nuisance: NuisanceOption = "all",
    without: WithoutOption = None,
    despite: DespiteOption = None,
    fresh_bodies: FreshBodiesOption = False,
    per_bag: Annotated[
        str,
        typer.Option("--per-bag", metavar="A,B", help="Those of --params that each bag has a value of its own of."),
    ] = "",
    prior: Annotated[
        list[str] | None,
        typer.Option("--prior", metavar="A=X+-SD", help="What is known of one of --params before; may be repeated."),
    ] = None,
    bounds: Annotated[
        list[str] | None,
        typer.Option("--bounds", metavar="A=LOW..HIGH", help="Bounds of one of --params; may be repeated."),
    ] = None,
    starts: Annotated[
        int, whole_number("--starts", "Searches from so many starts, the rig's values and others drawn.", 1)
    ] = 1,
    profile: Annotated[
        bool,
        typer.Option(
            "--profile", help="Find each interval from the likelihood itself; takes about as long as the fit."
        ),
    ] = False,
    robust: Annotated[
        bool,
        typer.Option("--robust/--no-robust", help="Leave out mistakes of trackers and single spikes of force sensors."),
    ] = True,
) -> None:
    """Estimate parameters of a rig, their uncertainty, and how well held-out recordings are predicted.

    Exit code 3: the fit did not converge; 4: what it leaves is more than ten times the noise. Ctrl-C keeps what was
    found so far.

    Example: thinshell fit card_press run1 run2 --params card.E,gel.E --held-out run3 --out fit
    """
    from sim_core.preflight import review
    from sim_core.rigs import load_rig, resolve_name
    from sysid.fit import FitOptions
    from sysid.model.parameters import asked_for
    from sysid.observations import rig_topics
    from sysid.report import REPORT
    from sysid.workflow import fit_bags

    chosen = rig_topics.without(load_rig(rig), without or [])
    names = [resolve_name(chosen, name) for name in parse_names(params, "--params")]
    options = FitOptions(
        nuisance=parse_nuisance(nuisance),
        per_bag=parse_names(per_bag, "--per-bag") if per_bag else [],
        priors=parse_pairs(prior or [], "--prior", "+-"),
        bounds=parse_pairs(bounds or [], "--bounds", ".."),
        starts=starts,
        intervals="profiled" if profile else "checked",
        robust=robust,
        seed=seed,
    )
    asked_for(
        chosen, names, priors=options.priors, bounds=options.bounds, per_bag=options.per_bag,
        bags=[str(bag) for bag in bags],
    )  # fmt: skip
    check_parts(bags, held_out or [])
    check_new(out, "folder")
    for finding in review(chosen):
        warn(finding.text)
    with interrupts_reported(KEPT) as pressed, progress("fit") as report:
        result = fit_bags(
            chosen,
            bags,
            names,
            options,
            held_out=held_out or [],
            out=out,
            on_progress=report,
            on_warning=warn,
            despite=despite or [],
            fresh_bodies=fresh_bodies,
        )
        print(f"{result.table()}\n\nReport: {out / REPORT}", flush=True)
    if pressed.is_set():
        raise KeyboardInterrupt
    if not result.converged:
        raise typer.Exit(NOT_CONVERGED)
    if result.no_success:
        raise typer.Exit(NO_SUCCESS)
