"""``thinshell trajectory``: make a trajectory file from an experiment, check one, and write one as a table."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from sim_core.errors import ConfigError
from sysid.cli.bounds import number
from sysid.cli.options import RigArgument, check_new, parse_settings
from sysid.progress import progress, warn


class _MakeByDefault(TyperGroup):
    """``thinshell trajectory RIG EXPERIMENT`` is ``thinshell trajectory make RIG EXPERIMENT``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the command in front that is meant where none is named."""
        named = not args or args[0] in self.commands or args[0].startswith("-")
        return super().parse_args(ctx, args if named else ["make", *args])


app = typer.Typer(
    cls=_MakeByDefault,
    help="Make a trajectory for a robot from an experiment (RIG EXPERIMENT --out FILE), or check one.",
    rich_markup_mode=None,
)

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="Trajectory file (docs/trajectories.md).")]
LimitOption = Annotated[
    list[str] | None,
    typer.Option(
        "--limit",
        metavar="NAME=VALUE",
        help="Limit as the file names it, such as max_force_n=5 or workspace_min_m=-0.1,-0.1,0; may be repeated.",
    ),
]


@app.command("make")
def make(
    rig: RigArgument,
    experiment: Annotated[
        str, typer.Argument(metavar="EXPERIMENT", help="Experiment: a name from 'thinshell rigs' or a YAML file.")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="New trajectory file.")],
    limit: LimitOption = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Value of a parameter of the rig; may be repeated."),
    ] = None,
    prediction: Annotated[
        bool, typer.Option("--prediction/--no-prediction", help="Simulate what wrench and marker sensors will read.")
    ] = True,
) -> None:
    """Make a trajectory from an experiment, with the wrench and the markers that the simulator predicts.

    Example: thinshell trajectory card_press press_hold_release --out press.json --limit max_force_n=5
    """
    from sim_core.preflight import review
    from sim_core.rigs import load_rig, with_parameters
    from sim_core.rigs.motion import compile_experiment, load_experiment
    from sim_core.trajectories import check_trajectory, make_trajectory, planned_path, rollout, write_trajectory

    chosen = with_parameters(load_rig(rig), parse_settings(settings or []))
    plan = load_experiment(experiment)
    poses = {name: planned_path(path.times, path) for name, path in compile_experiment(plan, chosen).items()}
    limits = parse_limits(limit or [])
    check_new(out, "trajectory")
    for finding in review(chosen, poses):
        if finding.kind != "hand limits":  # the check of the trajectory says it
            warn(finding.text)
    traces = []
    if prediction and chosen.sensors:
        with progress("trajectory") as report:
            traces.append(rollout(chosen, poses, lambda done, total: report(done / total, f"step {done} of {total}")))
    trajectory = make_trajectory(
        chosen,
        poses,
        limits=limits,
        traces=traces,
        name=plan.name,
        description=plan.description,
        provenance={"command": " ".join(["thinshell", *sys.argv[1:]])},
    )
    found = check_trajectory(trajectory)
    for text in (*found.warnings, *found.errors):
        warn(text)
    write_trajectory(out, trajectory)
    print(f"{out}: {trajectory.duration_s:.2f} s, {len(trajectory.times_s)} samples of {', '.join(poses)}.")
    for figure in found.figures:
        print(f"  {figure}")


@app.command("check")
def check(
    file: FileArgument,
    rig: Annotated[
        str | None,
        typer.Option("--rig", metavar="RIG", help="Rig to replay it on: a name or a YAML file."),
    ] = None,
    limit: LimitOption = None,
    speed_scale: Annotated[
        float, number("--speed-scale", "Share of the planned speed with which it is replayed.", 1e-3, 1.0)
    ] = 1.0,
) -> None:
    """Check a trajectory as a whole: workspace, speed, acceleration, predicted force, and the rig that it is for.

    The exit code is 2 where it must not be replayed.
    """
    from sim_core.rigs import load_rig
    from sim_core.trajectories import bounded, check_trajectory, read_trajectory

    chosen = None if rig is None else load_rig(rig)
    trajectory = read_trajectory(file) if chosen is None else bounded(read_trajectory(file), chosen)
    found = check_trajectory(trajectory, parse_limits(limit or []), chosen, speed_scale)
    made_for = "an unknown rig" if trajectory.rig is None else f"the rig {trajectory.rig.name}"
    names = ", ".join(trajectory.end_effectors)
    print(f"{file}: {trajectory.duration_s:.2f} s, {len(trajectory.times_s)} samples of {names}, for {made_for}.")
    for figure in found.figures:
        print(f"  {figure}")
    for text in found.warnings:
        warn(text)
    for text in found.errors:
        print(f"error: {text}")
    if found.errors:
        raise typer.Exit(2)
    print("Nothing speaks against its replay within these limits.")


@app.command("csv")
def csv(
    file: FileArgument,
    end_effector: Annotated[str, typer.Argument(metavar="END_EFFECTOR", help="Which one's poses.")],
    out: Annotated[Path, typer.Option("--out", metavar="CSV", help="New table.")],
) -> None:
    """Write the poses of one end effector as a table: time_s, x_m, y_m, z_m, qx, qy, qz, qw."""
    from sim_core.trajectories import read_trajectory, write_csv

    write_csv(out, read_trajectory(file), end_effector)


def parse_limits(words: list[str]) -> Any:
    """Limits from words ``name=value`` or ``name=x,y,z``. Raises ``ConfigError``."""
    from sim_core.rigs.yamlfile import validate
    from sim_core.trajectories import Limits

    values: dict[str, float | list[float]] = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            raise ConfigError(
                f"--limit {word!r} is not of the form name=value.", "Write for example --limit max_force_n=5."
            ) from None
        if name in values:
            raise ConfigError(f"--limit gives {name!r} twice.", "Keep one of the two.")
        values[name] = numbers if len(numbers) > 1 else numbers[0]
    return validate(Limits, values, "--limit")
