"""``thinshell simulate``: run an experiment on a rig and record it as a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.bounds import whole_number
from sysid.cli.options import RigArgument, check_new, parse_settings
from sysid.progress import progress, warn


def simulate(
    rig: RigArgument,
    experiment: Annotated[
        str,
        typer.Argument(metavar="EXPERIMENT", help="Experiment: a name from 'thinshell rigs' or a YAML file."),
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="BAG", help="New rosbag2 folder to write, or a single file: NAME.mcap.")
    ],
    seed: Annotated[int | None, whole_number("--seed", "Seed of the noise; default: the experiment's.", 0)] = None,
    refine: Annotated[
        int,
        whole_number(
            "--refine",
            "Cells in each direction and steps in time, as a multiple of the rig's: less error of mesh and step.",
            1,
            8,
        ),
    ] = 1,
    contact_forces: Annotated[
        bool,
        typer.Option(
            "--contact-forces",
            help="Also write force and torque of each declared contact, on the first body that it names, without "
            "noise: topics contacts/FIRST/SECOND.",
        ),
    ] = False,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Value of a parameter (see 'thinshell params'); may be repeated.",
        ),
    ] = None,
) -> None:
    """Simulate an experiment on a rig and write what its sensors would have recorded.

    Example: thinshell simulate card_press press_hold_release --out press --set card.E=1e9
    """
    from sim_core.preflight import review
    from sim_core.rigs import load_rig, with_parameters
    from sim_core.rigs.motion import compile_experiment, load_experiment
    from sysid.recording.writer import check_name

    chosen = with_parameters(load_rig(rig), parse_settings(settings or []))
    plan = load_experiment(experiment)
    poses = compile_experiment(plan, chosen)
    check_new(out, "recording")
    check_name(out)
    for finding in review(chosen, poses):
        warn(finding.text)
    from sysid.simulate import simulate_to_bag

    with progress("simulate") as report:
        summary = simulate_to_bag(
            chosen,
            plan,
            out,
            seed=plan.seed if seed is None else seed,
            refine=refine,
            contact_forces=contact_forces,
            on_progress=report,
        )
    print(summary)
