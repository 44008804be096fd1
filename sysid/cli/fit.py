"""``thinshell fit``: estimate parameters of a rig from recordings."""

from __future__ import annotations

from typing import Annotated

import typer

from sysid.cli.options import (
    BagsArgument,
    FolderOption,
    HeldOutOption,
    NuisanceOption,
    ParamsOption,
    RigArgument,
    SeedOption,
    WithoutOption,
    check_bags,
    check_new,
    parse_names,
    parse_nuisance,
)
from sysid.cli.progress import progress


def fit(
    rig: RigArgument,
    bags: BagsArgument,
    params: ParamsOption,
    out: FolderOption,
    held_out: HeldOutOption = None,
    seed: SeedOption = 0,
    nuisance: NuisanceOption = "time,bias,camera",
    without: WithoutOption = None,
    per_bag: Annotated[
        str,
        typer.Option("--per-bag", metavar="A,B", help="Those of --params that each bag has a value of its own of."),
    ] = "",
    profile: Annotated[
        bool,
        typer.Option(
            "--profile", help="Find each interval from the likelihood itself; takes about as long as the fit."
        ),
    ] = False,
    robust: Annotated[
        bool, typer.Option("--robust/--no-robust", help="Leave out marker readings that are mistakes of a tracker.")
    ] = True,
) -> None:
    """Estimate parameters of a rig, their uncertainty, and how well held-out recordings are predicted.

    Example: thinshell fit card_press run1 run2 --params card.E,gel.E --held-out run3 --out fit
    """
    from sim_core.rigs import load_rig, resolve_name
    from sysid import rig_topics
    from sysid.fit.parameters import fit_parameters, with_bags

    chosen = rig_topics.without(load_rig(rig), without or [])
    names = [resolve_name(chosen, name) for name in parse_names(params, "--params")]
    kinds = parse_nuisance(nuisance)
    apart = parse_names(per_bag, "--per-bag") if per_bag else []
    with_bags(fit_parameters(chosen, names), apart, [str(bag) for bag in bags], chosen)
    check_bags(bags, held_out or [])
    check_new(out, "folder")
    from sysid.fit import fit_bags

    with progress("fit") as report:
        summary = fit_bags(
            chosen,
            bags,
            names,
            held_out=held_out or [],
            out=out,
            seed=seed,
            nuisance=kinds,
            per_bag=apart,
            intervals="profiled" if profile else "checked",
            robust=robust,
            on_progress=report,
        )
    print(summary)
