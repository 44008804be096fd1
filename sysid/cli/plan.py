"""``thinshell plan``: what experiments would tell, before they are made."""

from __future__ import annotations

from typing import Annotated

import typer

from sysid.cli.options import (
    ExperimentsArgument,
    NuisanceOption,
    ParamsOption,
    RigArgument,
    WithoutOption,
    parse_names,
    parse_nuisance,
    parse_settings,
)
from sysid.progress import progress, warn


def plan(
    rig: RigArgument,
    experiments: ExperimentsArgument,
    params: ParamsOption,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Expected value of a parameter; may be repeated."),
    ] = None,
    nuisance: NuisanceOption = "all",
    without: WithoutOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Tell what experiments can determine and how well, before the robot is touched.

    Example: thinshell plan card_press press_hold_release press_post --params card.E,gel.E,gel.nu
    """
    from sim_core.preflight import review
    from sim_core.rigs import load_rig, resolve_name, with_parameters
    from sim_core.rigs.motion import compile_experiment, load_experiment
    from sysid.observations import rig_topics

    chosen = with_parameters(rig_topics.without(load_rig(rig), without or []), parse_settings(settings or []))
    names = [resolve_name(chosen, name) for name in parse_names(params, "--params")]
    kinds = parse_nuisance(nuisance)
    planned = [load_experiment(name) for name in experiments]
    commanded = [compile_experiment(experiment, chosen) for experiment in planned]
    for text in dict.fromkeys(finding.text for poses in commanded for finding in review(chosen, poses)):
        warn(text)
    from sysid.design.experiment_design import plan_experiments

    with progress("plan") as report:
        found = plan_experiments(chosen, planned, names, report, kinds)
    print(found.to_json() if as_json else found.table())
