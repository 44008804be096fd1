"""``thinshell robust``: motions over what a fit leaves open."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.bounds import whole_number
from sysid.cli.options import SeedOption
from sysid.progress import progress


def robust(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Folders that 'thinshell optimise' wrote.")],
    posterior: Annotated[Path, typer.Option("--posterior", metavar="FIT", help="fit.json, from which rigs are drawn.")],
    draws: Annotated[int, whole_number("--draws", "Number of rigs.", 1)] = 100,
    seed: SeedOption = 1,
) -> None:
    """On how many rigs, drawn from what a fit leaves open, motions do their task.

    A search with --posterior draws by its seed, 0 by default: draw by another one here.

    Example: thinshell robust runs/nominal runs/robust --posterior fit.json --draws 100
    """
    import json

    import numpy as np

    from sim_core.errors import ConfigError
    from sim_core.optimise.posterior import posterior_draws
    from sim_core.optimise.robustness import robustness
    from sim_core.optimise.run import RESULT, RUN
    from sim_core.tasks import load_task

    found = []
    with progress("robust") as report:
        for at, run in enumerate(runs):
            try:
                about = json.loads((run / RUN).read_text(encoding="utf-8"))
                action = np.array(json.loads((run / RESULT).read_text(encoding="utf-8"))["action"], dtype=float)
            except (OSError, ValueError, KeyError) as error:
                raise ConfigError(
                    f"{run} is no folder of a search that came to its end: {error}.",
                    "Name one of 'thinshell optimise'.",
                ) from None
            made = load_task(f"{run / 'task.yaml'}:{about['variant']}")

            def tell(done: int, at: int = at, name: str = run.name) -> None:
                report((at + done / draws) / len(runs), f"{name}: {done} of {draws}")

            found.append(robustness(made, action, posterior_draws(posterior, made.rig, draws, seed), tell))
    for run, one in zip(runs, found, strict=True):
        low, high = one.interval
        finite = one.rewards[np.isfinite(one.rewards)]
        mean = f"reward {finite.mean():.4g} ± {finite.std():.2g}" if len(finite) else "no rollout came to its end"
        print(f"{run}: {one.successes} of {draws} successes (95 %: {100 * low:.0f} to {100 * high:.0f} %), {mean}")
        if one.common_failure:
            print(f"  most often no success, since {one.common_failure}")
