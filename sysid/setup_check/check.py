"""What a comparison of a recording with its rig says, as findings: one function for inspect, fit and diagnose."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.errors import RecordingError
from sim_core.rigs import Rig
from sysid.observations.checks.finding import Finding
from sysid.observations.observations import Run
from sysid.progress.rollout_costs import RolloutCosts
from sysid.progress.work import Work
from sysid.settings.setup_check import SETUP_CHECK
from sysid.setup_check.compare import Comparison, Tried, compare

SETUP = "setup"
"""Name of the finding, as ``--despite`` takes it."""


@dataclass(frozen=True)
class SetupCheck:
    """``findings``: at most one mistake that is named, or a note; ``tried``: what was tried, in words."""

    findings: tuple[Finding, ...]
    tried: str


def check_setup(rig: Rig, run: Run, costs: RolloutCosts | None = None) -> SetupCheck:
    """What speaks for a mistake of set-up in a run: the likeliest mistake, how much it explains, the line that mends
    the rig, and what explains the run as well. ``costs``: hears of each rollout."""
    comparison = compare(rig, run, costs=costs)
    named = comparison.named
    if named:
        found = _finding(comparison, named)
        return SetupCheck((found,), f"{run.name}: {found.problem} {found.remedy}")
    kinds = sorted({t.mistake.kind for t in comparison.tried})
    tried = (
        f"{run.name}: {len(comparison.tried)} mistakes of set-up ({', '.join(kinds)}), of which none explains the "
        "first readings materially better than the rig as written."
    )
    return SetupCheck(tuple(notes_of(comparison)), tried if kinds else "")


def _finding(comparison: Comparison, named: Sequence[Tried]) -> Finding:
    best, *others = likeliest_of_each_kind(named)
    shown = [f"{t.mistake.words} ({t.mistake.line})" for t in others]
    as_well = f" The recording would be explained as well if {'; or if '.join(shown)}." if shown else ""
    line = best.mistake.line
    in_rig = line.startswith(("sensors.", "cameras.", "end_effectors."))
    return Finding(
        SETUP,
        best.mistake.part,
        "stops a fit",
        f"It looks as if {best.mistake.words}. {_explains(comparison, best)}{as_well}",
        f"Write into the rig {line}." if in_rig else f"{line[0].upper()}{line[1:]}.",
        values=(best.log_odds,),
        bound=float(np.log(SETUP_CHECK.sure_odds)),
        part=best.mistake.part,
    )


def likeliest_of_each_kind(named: Sequence[Tried]) -> list[Tried]:
    """The likeliest mistake, and the likeliest of each other kind that explains the recording as well."""
    firsts = {t.mistake.kind: t for t in reversed(named)}
    return sorted(firsts.values(), key=lambda t: -t.among_mistakes)


def refuse_mistaken_setups(
    rig: Rig,
    runs: Sequence[Run],
    despite: Collection[str] = (),
    on_warning: Callable[[str], None] | None = None,
    work: Work | None = None,
) -> list[str]:
    """Compare recordings with their rig before they are fitted; what was tried, in words. Raises ``RecordingError``
    where a mistake of set-up is named, unless ``despite`` has ``setup``; notes go to ``on_warning``, how far it is to
    ``work``."""
    tried = []
    for run in runs:
        if work is not None:
            work.say(f"{run.name} is compared with the rig")
        checked = check_setup(rig, run, None if work is None else work.costs)
        for found in checked.findings:
            text = f"{run.name}: {found.channel}: {found.problem}"
            if found.severity == "stops a fit" and SETUP not in despite:
                raise RecordingError(text, f"{found.remedy} If the rig is right: --despite {SETUP}.")
            if on_warning is not None:
                on_warning(f"{text} {found.remedy}")
        tried += [checked.tried] if checked.tried else []
    return tried


def _explains(comparison: Comparison, best: Tried) -> str:
    """How much of what changed in each channel is left by the rig as written, and with the mistake."""
    parts = []
    for channel, after in best.channels.items():
        before = comparison.as_written[channel]
        if before.log == after.log:
            continue
        size = f", predicted {before.size:.2g} times as large," if abs(np.log(before.size)) > 1.0 else ""
        parts.append(
            f"{100 * before.left:.0f} % of what changes in {channel} is left by the rig as written{size} and "
            f"{100 * after.left:.0f} % so, noise included"
        )
    words = "; ".join(parts)
    followed = "" if comparison.followed else "The simulator cannot follow the recording with the rig as written. "
    return f"{followed}With the material that suits it best, {words}."


def notes_of(comparison: Comparison) -> list[Finding]:
    """What is worth a word where no mistake is named: forces of the size that they have in another unit, which a
    material may make too."""
    found = []
    for t in comparison.tried:
        channel = t.mistake.part
        if t.mistake.kind != "force unit":
            continue
        before, after = comparison.as_written[channel], t.channels[channel]
        if abs(np.log(before.size)) > SETUP_CHECK.odd_size_log and abs(np.log(after.size)) < SETUP_CHECK.unit_size_log:
            found.append(t)
    if not found:
        return []
    t = max(found, key=lambda each: each.log_odds)
    return [
        Finding(
            "force_size",
            t.mistake.part,
            "note",
            f"The forces of {t.mistake.part} are {comparison.as_written[t.mistake.part].size:.3g} times those that the "
            f"rig predicts. So stiff or soft may a material be; it may also be that {t.mistake.words}.",
            f"If so, write into the rig {t.mistake.line}.",
            values=(comparison.as_written[t.mistake.part].size,),
            bound=float(np.exp(SETUP_CHECK.odd_size_log)),
            part=t.mistake.part,
        )
    ]
