"""Fits recordings and writes the results with their report: the function behind ``thinshell fit`` and the node."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from sim_core.rigs import Rig, rig_to_yaml
from sysid.fit.fit import USUAL_OPTIONS, fit_runs
from sysid.fit.multistart import Step
from sysid.fit.options import FitOptions
from sysid.fit.result import FitResult
from sysid.io.atomic_folder import whole_folder, write_results
from sysid.model.load import load_runs
from sysid.model.parameters import bounds_cut
from sysid.progress.callback import Progress
from sysid.progress.work import work_of
from sysid.report import REPORT, write_fit_report
from sysid.settings.progress import PROGRESS
from sysid.setup_check.check import refuse_mistaken_setups
from sysid.solve.interruption import interrupts_ignored


def fit_bags(
    rig: Rig,
    bags: Sequence[Path],
    names: Sequence[str],
    options: FitOptions = USUAL_OPTIONS,
    *,
    held_out: Sequence[Path] = (),
    out: Path,
    on_progress: Progress | None = None,
    on_step: Callable[[Step], None] | None = None,
    on_warning: Callable[[str], None] | None = None,
    despite: Collection[str] = (),
    fresh_bodies: bool = False,
) -> FitResult:
    """Fit bags (:func:`fit_runs`) and write ``fit.json``, ``fitted_rig.yaml`` and ``report.html`` into ``out``.
    ``on_warning``: hears which bounds are cut and what speaks against the recordings before anything is simulated;
    ``despite``: findings that do not stop the fit (:func:`sysid.model.load.read_run`); ``fresh_bodies``: recordings do
    not show the same bodies in turn (:mod:`sysid.model.sequence`)."""
    if on_warning is not None:
        for text in bounds_cut(rig, names, options.bounds):
            on_warning(text)
    with whole_folder(out) as folder:
        runs, kept = load_runs(rig, bags, held_out, on_warning, despite, fresh_bodies)
        work = work_of(on_progress, PROGRESS.fit_rollouts, PROGRESS.fit_between_s, len(runs))
        tried = refuse_mistaken_setups(rig, [*runs, *kept], despite, on_warning, work)
        result, fitted = fit_runs(rig, runs, names, options, held_out=kept, on_progress=work, on_step=on_step)
        result.tried = tried
        with interrupts_ignored():
            write_results(
                folder,
                out,
                [
                    lambda place: result.write(place / "fit.json"),
                    lambda place: (place / "fitted_rig.yaml").write_text(rig_to_yaml(fitted)),
                    lambda place: write_fit_report(result, place / REPORT),
                ],
            )
    work.done()
    return result
