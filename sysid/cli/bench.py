"""``thinshell bench``: how fast this machine simulates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sim_core.errors import ConfigError
from sysid.cli.bounds import whole_number
from sysid.cli.options import library
from sysid.progress import progress


def bench(
    rig: Annotated[
        str | None, typer.Argument(metavar="[RIG", help="With a recording: only a rollout along its motion.")
    ] = None,
    bag: Annotated[Path | None, typer.Argument(metavar="BAG]", help="Recording of that rig.")] = None,
    columns: Annotated[
        int, whole_number("--columns", "Parameters of that rig to differentiate by, the first ones.", 0)
    ] = 0,
    effects: Annotated[
        bool,
        typer.Option("--effects", help="Of that rig with each effect in turn."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Only the forming rig in one process.")] = False,
    scenes: Annotated[
        bool, typer.Option("--scenes", help="Only the manipulation scenes, and the sizes of published simulations.")
    ] = False,
    gradients: Annotated[
        bool, typer.Option("--gradients", help="Only the adjoint: steps per second backwards, memory by horizon.")
    ] = False,
    gpu: Annotated[
        bool, typer.Option("--gpu", help="Only sheets on a GPU: rollouts at once, their steps per second and counts.")
    ] = False,
) -> None:
    """Measure steps per second, the share of each part of a step, and how both grow with the mesh; or the CPU time of a
    step along a recording, and whether steps run on the compiled core.

    Example: thinshell bench strip.yaml recordings/rec_01 --columns 15 --json
    """
    if rig is not None:
        if bag is None or quick or scenes or gradients or gpu:
            raise ConfigError(
                "The speed along a recording needs a rig and the recording, and nothing of --quick, --scenes, "
                "--gradients and --gpu.",
                "Give RIG BAG, or neither of them.",
            )
        from sim_core.rigs import load_rig

        if effects:
            print(library("sysid.bench", "run_effects_benchmark")(load_rig(rig), bag, as_json))
            return
        print(library("sysid.bench", "run_recording_benchmark")(load_rig(rig), bag, columns, as_json))
        return
    if columns or effects:
        raise ConfigError("--columns and --effects are about a rollout along a recording.", "Give RIG BAG too.")
    if quick + scenes + gradients + gpu > 1:
        raise ConfigError(
            "--quick, --scenes, --gradients and --gpu each leave out what the others measure.", "Give one of them."
        )
    if gpu:
        with progress("variants") as report:
            print(library("sysid.bench", "run_gpu_benchmark")(as_json, lambda done, total: report(done / total, "")))
        return
    if gradients:
        print(library("sysid.bench", "run_gradient_benchmark")(as_json=as_json))
        return
    from sysid.bench.scenes import SCENES

    done = []
    with progress("scenes") as report:

        def on_scene(run: object) -> None:
            done.append(run)
            report(len(done) / len(SCENES), SCENES[len(done) - 1][1])

        text = library("sysid.bench", "run_benchmarks")(as_json=as_json, quick=quick, scenes=scenes, on_scene=on_scene)
    print(text)
