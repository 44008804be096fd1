"""Diagnoses recordings and writes the results with their report: the function behind ``thinshell diagnose``."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path

import yaml

from sim_core.errors import ConfigError
from sim_core.rigs import Gel, Rig, rig_to_yaml
from sim_core.settings import values
from sysid.diagnosis.diagnose import diagnose_runs
from sysid.diagnosis.next_motion import MOTION_FILE, experiment_to_yaml
from sysid.diagnosis.result import Diagnosis
from sysid.io.atomic_folder import whole_file, whole_folder, write_results
from sysid.io.checkpoints import Checkpoints, checkpoints, program_digest
from sysid.model.load import load_runs
from sysid.observations.observations import Run
from sysid.progress.callback import Progress
from sysid.progress.work import work_of
from sysid.report import REPORT, write_diagnosis_report
from sysid.settings import all_settings
from sysid.settings.progress import PROGRESS
from sysid.setup_check.check import refuse_mistaken_setups


def diagnose_bags(
    rig: Rig,
    bags: Sequence[Path],
    *,
    held_out: Sequence[Path] = (),
    out: Path,
    on_progress: Progress | None = None,
    on_warning: Callable[[str], None] | None = None,
    despite: Collection[str] = (),
    fresh_bodies: bool = False,
    resumable: bool = False,
) -> Diagnosis:
    """Diagnose bags; write ``diagnosis.json``, ``ledger.npz``, ``report.html``, ``rig.yaml`` (as given),
    ``amended_rig.yaml``, and where there is one ``next_experiment.yaml``.

    ``on_warning``: hears what speaks against the recordings before anything is simulated; ``despite``: findings that do
    not stop it (:func:`sysid.model.load.read_run`); ``fresh_bodies``: recordings do not show the same bodies in turn
    (:mod:`sysid.model.sequence`); ``resumable``: what is found is kept in ``out`` from stage to stage, with a page that
    says what is known until then, and a second start with the same inputs goes on from it
    (:mod:`sysid.io.checkpoints`)."""
    if not resumable:
        with whole_folder(out) as folder:
            runs, kept = load_runs(rig, bags, held_out, on_warning, despite, fresh_bodies)
            return _diagnosed(rig, runs, kept, folder, out, on_progress, on_warning, despite)
    runs, kept = load_runs(rig, bags, held_out, on_warning, despite, fresh_bodies)
    inputs = {
        "rig": rig,
        "recordings": [(run.name, run.sha256, run.since, run.until) for run in (*runs, *kept)],
        "options": (len(runs), sorted(despite), fresh_bodies),
        "settings": {room: values(settings) for room, settings in all_settings().items()},
        "program": program_digest(),
    }
    with checkpoints(out, inputs, on_warning) as stages, whole_folder(out) as folder:
        return _diagnosed(rig, runs, kept, folder, out, on_progress, on_warning, despite, stages)


def _diagnosed(
    rig: Rig,
    runs: Sequence[Run],
    kept: Sequence[Run],
    folder: Path,
    out: Path,
    on_progress: Progress | None,
    on_warning: Callable[[str], None] | None,
    despite: Collection[str],
    stages: Checkpoints | None = None,
) -> Diagnosis:
    """The diagnosis of recordings, written into a folder that becomes ``out``."""

    def show(known: Diagnosis) -> None:
        if stages is not None:
            with suppress(ConfigError, OSError), whole_file(out / REPORT) as page:
                write_diagnosis_report(known, page)

    work = work_of(on_progress, PROGRESS.diagnosis_rollouts, PROGRESS.diagnosis_between_s, len(runs) + len(kept))
    checked = partial(refuse_mistaken_setups, rig, [*runs, *kept], despite, on_warning, work)
    tried = checked() if stages is None else stages.stage("set-up", checked)
    diagnosis, amended = diagnose_runs(rig, runs, kept, on_progress=work, kept=stages, on_known=show)
    diagnosis.setups_tried = tuple(tried)
    write_results(
        folder,
        out,
        [
            lambda place: diagnosis.write(place / "diagnosis.json"),
            lambda place: diagnosis.ledger.write(place / "ledger.npz") if diagnosis.ledger is not None else None,
            lambda place: write_rigs(rig, diagnosis, amended, place),
            lambda place: write_diagnosis_report(diagnosis, place / REPORT),
        ],
    )
    work.done()
    return diagnosis


def write_rigs(rig: Rig, diagnosis: Diagnosis, amended: Rig, folder: Path) -> None:
    """Write the rig as it was given, with the cells of the diagnosis, and what that changes in it as an overlay. What
    recordings have for themselves, as the delay of a clock, is none of the rig."""
    bodies = dict(rig.bodies)
    for name, body in amended.bodies.items():
        given = rig.bodies[name]
        if isinstance(body, Gel) and isinstance(given, Gel):
            bodies[name] = given.model_copy(update={"shape": body.shape})
    overlay = {
        "overlay_of": "rig.yaml",
        "name": f"{rig.name}_amended",
        "description": diagnosis.sentence,
        "parameters": {
            p.name: p.value
            for p in (diagnosis.amended_parameters or diagnosis.baseline_parameters)
            if not p.name.startswith("effects.") and not p.name.endswith("]")
        },
        "effects": {name: dict(values) for name, values in amended.effects.items()},
    }
    (folder / "rig.yaml").write_text(rig_to_yaml(rig.model_copy(update={"bodies": bodies})))
    (folder / "amended_rig.yaml").write_text(yaml.safe_dump(overlay, sort_keys=False))
    if diagnosis.next_motion is not None:
        (folder / MOTION_FILE).write_text(experiment_to_yaml(diagnosis.next_motion))
