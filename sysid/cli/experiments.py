"""``thinshell experiments``: pictures of motions, and a page on what each of them determines."""

from __future__ import annotations

from typing import Annotated

import typer

from sysid.cli.options import FolderOption, check_new
from sysid.progress import progress


def experiments(
    out: FolderOption,
    chosen: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="EXPERIMENT...", help="Experiments that name a rig and what they identify; without any, all."
        ),
    ] = None,
    page: Annotated[
        bool, typer.Option("--page", help="Also write DIR.md: what 'thinshell plan' says of them; takes minutes.")
    ] = False,
) -> None:
    """Draw experiments: the rig from the side at some instants, and what is commanded; one SVG each.

    Example: thinshell experiments slacken press_post --out pictures
    """
    from sim_core.errors import ConfigError
    from sim_core.rigs.motion import load_experiment
    from sysid.report.experiments_page import by_rig, identifying, page_path, write_experiments

    found = [load_experiment(name) for name in chosen or []] or identifying()
    by_rig(found)
    check_new(out, "folder")
    page_file = page_path(out)
    if page and page_file.exists():
        raise ConfigError(f"The page {page_file} already exists.", "Remove it, or name another folder with --out.")
    command = " ".join(["thinshell experiments", *(chosen or []), f"--out {out} --page"])
    with progress("experiments") as report:
        write_experiments(found, out, page, command, report)
    print(f"Pictures: {out}")
    if page:
        print(f"Page: {page_file}")
