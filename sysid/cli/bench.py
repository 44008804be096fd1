"""``thinshell bench``: how fast this machine simulates."""

from __future__ import annotations

from typing import Annotated

import typer

from sysid.cli.options import library


def bench(
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Measure steps per second and the share of each part of a step."""
    print(library("sim_core.bench", "run_benchmarks")(as_json=as_json))
