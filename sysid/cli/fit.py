"""``thinshell fit``: estimate parameters of a rig from recordings."""

from __future__ import annotations

from typing import Annotated

import typer

from sysid.cli.options import (
    BagsArgument,
    FolderOption,
    HeldOutOption,
    NuisanceOption,
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
    params: Annotated[
        str,
        typer.Option("--params", metavar="A,B", help="Parameters to estimate, as 'thinshell params' lists them."),
    ],
    out: FolderOption,
    held_out: HeldOutOption = None,
    seed: SeedOption = 0,
    nuisance: NuisanceOption = "all",
    without: WithoutOption = None,
) -> None:
    """Estimate parameters of a rig, their uncertainty, and how well held-out recordings are predicted.

    Example: thinshell fit card_press run1 run2 --params card.E,gel.E --held-out run3 --out fit
    """
    from sim_core.rigs import load_rig, resolve_name
    from sysid import rig_topics

    chosen = rig_topics.without(load_rig(rig), without or [])
    names = [resolve_name(chosen, name) for name in parse_names(params, "--params")]
    kinds = parse_nuisance(nuisance)
    check_bags(bags, held_out or [])
    check_new(out, "folder")
    from sysid.fit import fit_bags

    with progress("fit") as report:
        summary = fit_bags(
            chosen, bags, names, held_out=held_out or [], out=out, seed=seed, nuisance=kinds, on_progress=report
        )
    print(summary)
