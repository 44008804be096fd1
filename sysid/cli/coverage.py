"""``thinshell coverage``: how often 95 % intervals hold the truth."""

from __future__ import annotations

from typing import Annotated

import typer

from sysid.cli.bounds import number, whole_number
from sysid.cli.options import ExperimentsArgument, ParamsOption, RigArgument, SeedOption, parse_names
from sysid.progress import progress


def coverage(
    rig: RigArgument,
    experiments: ExperimentsArgument,
    params: ParamsOption,
    cases: Annotated[int, whole_number("--cases", "How many cases.", 1)] = 20,
    first: Annotated[int, whole_number("--first", "Number of the first case.", 0)] = 0,
    spread: Annotated[float, number("--spread", "Factor either way within which truths are drawn.", 1.01, 10.0)] = 1.5,
    refine: Annotated[
        int,
        whole_number(
            "--refine",
            "How much finer, in mesh and step, the truth is simulated than the fit. Fits learn their discretisation "
            "error by halving both, so with 2 the truth differs from their model by just what they have learnt",
            1,
            8,
        ),
    ] = 3,
    colour: Annotated[
        float,
        number("--colour", "Correlation of the noise of wrenches from sample to sample, as by a filter.", 0.0, 0.99),
    ] = 0.0,
    seed: SeedOption = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Draw true values, simulate, fit, and count how often the intervals hold the truth.

    Example: thinshell coverage strip_coarse pull_taut --params strip.E,strip.nu --cases 40
    """
    from sim_core.rigs import load_rig, resolve_name
    from sim_core.rigs.motion import compile_experiment, load_experiment

    chosen = load_rig(rig)
    names = [resolve_name(chosen, name) for name in parse_names(params, "--params")]
    planned = [load_experiment(name) for name in experiments]
    for experiment in planned:
        compile_experiment(experiment, chosen)
    from sysid.fit.coverage import measure_coverage

    with progress("coverage") as report:
        found = measure_coverage(
            chosen,
            planned,
            names,
            cases=range(first, first + cases),
            spread=spread,
            refine=refine,
            seed=seed,
            colour=colour,
            on_progress=report,
        )
    print(found.to_json() if as_json else found.table())
