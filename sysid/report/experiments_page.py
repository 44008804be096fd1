"""The page that says which motion determines what: pictures of experiments, and what ``thinshell plan`` finds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from sim_core.errors import ConfigError
from sim_core.rigs import EndEffector, Rig, load_rig, resolve_name
from sim_core.rigs.load import names_in
from sim_core.rigs.motion import Experiment, load_experiment
from sysid.design.experiment_design import Outlook, plan_experiments
from sysid.io.atomic_folder import whole_file, whole_folder
from sysid.progress.callback import Progress
from sysid.report.motion_picture import draw_experiment

PICTURES = 0.1
"""Share of the time that the pictures take where there is a page too."""

HEAD = """# Experiments that identify materials

Each picture shows the rig from the side at some instants, the paths of the end effectors, and the commanded
displacement and turn against time. Each table says how well the readings of an experiment would determine each
parameter: the relative standard deviation, which `thinshell plan` prints as `sd` next to the 95 % interval that follows
from it, about twice that either way. It allows for the noise that the rig declares, the error of mesh and time step,
and all nuisances of a fit (time, bias, camera, pose); a dash where the readings do not tell. Values are those of the
rig.

Made by `{command}`.
"""


def identifying() -> list[Experiment]:
    """The experiments that come with the package and are meant to identify materials."""
    found = [load_experiment(name) for name in names_in("experiments")]
    return [experiment for experiment in found if experiment.rig is not None]


def by_rig(experiments: Sequence[Experiment]) -> dict[str, list[Experiment]]:
    """The experiments of each rig. Raises ``ConfigError`` for one that names none, and for two of one name."""
    groups: dict[str, list[Experiment]] = {}
    names: set[str] = set()
    for experiment in experiments:
        if experiment.rig is None:
            raise ConfigError(
                f"The experiment {experiment.name!r} names no rig and no parameters that it identifies.",
                "Add rig and identifies to its file.",
            )
        if experiment.name in names:
            raise ConfigError(
                f"Two experiments are named {experiment.name!r}, after which their pictures are named.",
                "Name each once, and give each a name of its own in its file.",
            )
        names.add(experiment.name)
        groups.setdefault(experiment.rig, []).append(experiment)
    return groups


def parameters_of(rig: Rig, experiments: Sequence[Experiment]) -> list[str]:
    """Full names of what the experiments are to identify, each once."""
    return list(dict.fromkeys(resolve_name(rig, name) for e in experiments for name in e.identifies))


def page_path(pictures: Path) -> Path:
    """The page of a folder of pictures: ``DIR.md`` next to ``DIR``."""
    pictures = pictures.absolute()
    return pictures.with_name(f"{pictures.name}.md")


def write_experiments(
    experiments: Sequence[Experiment], out: Path, page: bool, command: str, on_progress: Progress
) -> None:
    """One SVG an experiment into the new folder ``out``; ``page``: also the page on them (:func:`page_path`), which
    says that ``command`` made it. All appear together, when all is done."""
    groups = [(load_rig(rig), members) for rig, members in by_rig(experiments).items()]
    with ExitStack() as together:
        folder = together.enter_context(whole_folder(out))
        sheet = together.enter_context(whole_file(page_path(out))) if page else None
        drawn = PICTURES if page else 1.0
        done = 0
        for rig, members in groups:
            for experiment in members:
                on_progress(drawn * done / len(experiments), f"picture of {experiment.name}")
                (folder / f"{experiment.name}.svg").write_text(draw_experiment(rig, experiment))
                done += 1
        if sheet is not None:

            def planned(share: float, text: str) -> None:
                on_progress(drawn + (1.0 - drawn) * share, text)

            sheet.write_text(_page(groups, out.absolute().name, command, planned))


def _page(
    groups: Sequence[tuple[Rig, Sequence[Experiment]]], pictures: str, command: str, on_progress: Progress
) -> str:
    parts = [HEAD.format(command=command)]
    for k, (rig, members) in enumerate(groups):
        names = parameters_of(rig, members)

        def share(done: float, text: str, k: int = k) -> None:
            on_progress((k + done) / len(groups), text)

        plan = plan_experiments(rig, members, names, share)
        parts.append(_section(rig, members, names, plan.outlooks, pictures))
    return "\n".join(parts)


def _section(
    rig: Rig, experiments: Sequence[Experiment], names: Sequence[str], outlooks: Sequence[Outlook], folder: str
) -> str:
    """All of one rig: the pictures, then the table with a column for each experiment and one for all together."""
    lines = [f"\n## {rig.name}\n", f"{' '.join(rig.description.split())}\n", *_calibrated(rig)]
    for experiment in experiments:
        lines += [f"**{experiment.name}.** {experiment.description}\n"]
        lines += [f"![{experiment.name}: side views and commands]({folder}/{experiment.name}.svg)\n"]
    titles = [o.experiments[0] if len(o.experiments) == 1 else "all together" for o in outlooks]
    lines += [f"| parameter | value | {' | '.join(titles)} | from |", f"| --- | --- |{' --- |' * (len(titles) + 1)}"]
    for k, name in enumerate(names):
        cells = [outlook.parameters[k].spread() or "\u2013" for outlook in outlooks]
        last = outlooks[-1].parameters[k]
        sources = ", ".join(f"{c} {100 * s:.0f} %" for c, s in last.from_channels.items() if s >= 0.05)
        sources_text = sources if last.determined else ""
        lines.append(
            f"| `{name}` | {last.value:.4g} {last.unit} | {' | '.join(cells)} | {sources_text} |".replace("  ", " ")
        )
    lines += ["", *_stiffnesses(rig, outlooks[-1])]
    words = " ".join(e.name for e in experiments)
    lines += [f"`thinshell plan {rig.name} {words} --params {','.join(names)}`", ""]
    return "\n".join(lines)


def _calibrated(rig: Rig) -> list[str]:
    """A sentence for each end effector whose offset is not as uncertain as usual."""
    usual = EndEffector()
    return [
        f"The offset of the {name} is known to {', '.join(f'{1e3 * sd:g}' for sd in e.offset_sd_m)} mm and "
        f"{', '.join(f'{sd:g}' for sd in e.offset_sd_deg)} deg along and about its axes before.\n"
        for name, e in rig.end_effectors.items()
        if (e.offset_sd_m, e.offset_sd_deg) != (usual.offset_sd_m, usual.offset_sd_deg)
    ]


def _stiffnesses(rig: Rig, outlook: Outlook) -> list[str]:
    """For each sheet whose modulus and thickness are both asked for: how well its two stiffnesses would be known."""
    known = {p.name: k for k, p in enumerate(outlook.parameters)}
    lines = []
    for body in rig.bodies:
        pair = known.get(f"{body}.E_pa"), known.get(f"{body}.thickness_m")
        if pair[0] is None or pair[1] is None:
            continue
        modulus, thickness = (outlook.parameters[k] for k in pair if k is not None)
        if modulus.determined and thickness.determined:
            both = outlook.correlation[pair[0]][pair[1]] * modulus.sd * thickness.sd
            stretch, bend = (
                100.0 * math.sqrt(modulus.sd**2 + (n * thickness.sd) ** 2 + 2.0 * n * both) for n in (1, 3)
            )
            lines.append(
                f"All together, the stretching stiffness E t of the {body}: {stretch:.2g} %, its bending stiffness "
                f"E t\u00b3/12: {bend:.2g} % (at a given Poisson's ratio).\n"
            )
    return lines
