"""``thinshell check-gradients``: forward sensitivities and adjoint against central differences of whole rollouts."""

from __future__ import annotations

from typing import Annotated

import typer

from sysid.cli.bounds import number
from sysid.cli.options import RigArgument, library, parse_names, parse_settings
from sysid.progress import progress


def check_gradients(
    rig: RigArgument,
    experiment: Annotated[
        str,
        typer.Argument(metavar="EXPERIMENT", help="Experiment: a name from 'thinshell rigs' or a YAML file."),
    ],
    params: Annotated[
        str | None,
        typer.Option(
            "--params",
            metavar="A,B",
            help="Parameters, as 'thinshell params' lists them, and 'poses' at every step, 'start' (positions, "
            "velocities, memory) and 'fields' over elements and nodes, or 'fields.gel.E' alone; default: all of these.",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Value of a parameter; may be repeated."),
    ] = None,
    until: Annotated[
        float | None, number("--until", "End of the rollout; default: of the motion", 0.0, metavar="SECONDS")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Check the gradients of a rollout; exit code 1 if one is off by more than its bound, or none could be judged.

    Example: thinshell check-gradients card_press press_post --params gel.E,gel-post.friction
    """
    from sim_core.rigs import load_rig, with_parameters
    from sim_core.rigs.motion import load_experiment

    chosen = with_parameters(load_rig(rig), parse_settings(settings or []))
    names = None if params is None else parse_names(params, "--params")
    check = library("sysid.gradients", "check_gradients")
    with progress("check-gradients") as report:
        passed, text = check(
            chosen, load_experiment(experiment), names, until_s=until, as_json=as_json, on_progress=report
        )
    print(text)
    if not passed:
        raise typer.Exit(1)
