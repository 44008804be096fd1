"""``thinshell optimise``: a motion for a task."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.bounds import number, whole_number
from sysid.cli.options import ClusterOption, SeedOption
from sysid.progress import progress


def optimise(
    task: Annotated[
        str, typer.Argument(metavar="TASK", help="A name from 'thinshell tasks' (lifting, lifting:paper) or a file.")
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder of the run: a new one, or one that goes on.")
    ],
    rig: Annotated[
        str | None, typer.Option("--rig", metavar="RIG", help="In place of the task's: a name or a file.")
    ] = None,
    method: Annotated[
        str, typer.Option("--method", metavar="NAME", help="hybrid, gradient, adam, cma or cem.")
    ] = "hybrid",
    budget: Annotated[int, whole_number("--budget", "Rollouts; one with a gradient counts as one.", 1)] = 200,
    minutes: Annotated[
        float | None, number("--minutes", "Wall time after which no rollout begins.", 0.0, metavar="MINUTES")
    ] = None,
    seed: SeedOption = 0,
    workers: Annotated[int, whole_number("--workers", "Rollouts at once; 0: one a core.", 0)] = 0,
    cluster: ClusterOption = "",
    stop_at_success: Annotated[bool, typer.Option("--stop-at-success", help="End with the first success.")] = False,
    posterior: Annotated[
        Path | None,
        typer.Option("--posterior", metavar="FIT", help="fit.json: seek the mean over what that fit leaves open."),
    ] = None,
    draws: Annotated[int, whole_number("--draws", "Sets of parameters from the posterior.", 1)] = 8,
    quantile: Annotated[
        float,
        number("--quantile", "Mean of the worst share of the draws; 0: of all.", 0.0, 1.0, metavar="Q"),
    ] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Search for a motion that does a task, and write it with the way it was found.

    Example: thinshell optimise lifting --method hybrid --budget 100 --out runs/lifting
    """
    from sim_core.optimise import Settings
    from sim_core.optimise import method as method_named
    from sim_core.optimise.posterior import posterior_draws
    from sim_core.tasks import load_task
    from sysid.workflow.optimise import optimise_task

    made = load_task(task, rig=rig)
    method_named(method)
    chosen = posterior_draws(posterior, made.rig, draws, seed) if posterior is not None else ()
    settings = Settings(
        method=method,
        rollouts=budget * max(1, len(chosen)),
        seconds=float("inf") if minutes is None else 60.0 * minutes,
        seed=seed,
        workers=workers or os.cpu_count() or 1,
        draws=tuple(chosen),
        quantile=quantile,
        stop_at_success=stop_at_success,
        cluster=cluster,
    )
    with progress(f"optimise {made.name}") as report:
        result = optimise_task(made, settings, out, report)
    if as_json:
        print(result.to_json())
        return
    verdict = "success" if result.success else "no success"
    print(f"{made.name}, {method}, seed {seed}: reward {result.reward:.5g}, {verdict} (from {made.variant.success:g})")
    for words in result.failures:
        print(f"  no success, since {words}")
    print(f"  success is: {made.variant.words}")
    if chosen:
        print(f"  over {len(chosen)} draws: {result.searched_reward:.5g}, {100 * result.success_share:.0f} % successes")
    elif made.has_coarse:
        print(f"  with the coarser cells of the search: {result.searched_reward:.5g}")
    first = "none had the reward" if result.to_success is None else f"the first with the reward: {result.to_success}"
    print(
        f"  {result.rollouts} rollouts ({first}), {result.cpu_s:.0f} s of process time and "
        f"{result.check_s:.0f} s for checks, {result.wall_s:.0f} s in all"
    )
    print(f"  largest force on a finger {result.force_n:.3g} N; written: {out}")
    if result.interrupted:
        print("  interrupted: the same command goes on from here")
