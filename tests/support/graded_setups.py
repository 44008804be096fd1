"""Mistakes of set-up, drawn at random and made in sound recordings of several rigs, and how the check names each.

    python tests/support/graded_setups.py --count 100 --seed 7

prints a line for each mistake, and a table of kinds by outcomes:

- ``first``: a finding names it, or it is the likeliest;
- ``equal``: the recording shows it and another one alike, and the sentence tells both;
- ``note``: forces of another unit, which a material may make too, or a start that is not the rig's;
- ``refused``: the recording cannot be lined up with the rig;
- ``other``: something else is named; ``silent``: nothing is;
- ``no effect``: readings and predictions are changed by less than their noise, whatever the check says.

Whether a mistake has an effect is computed from the sound recording and the truth, without the check: readings by what
they differ, poses by a rollout along the wrong ones and one along the right ones.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mistaken_setups import MistakenRecording, makers

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig, load_rig
from sim_core.rigs.motion import load_experiment
from sysid.model.load import lined_up
from sysid.noise.estimate import channel_noise, quantities
from sysid.observations.checks import Finding, examine
from sysid.observations.observations import Run
from sysid.observations.rig_topics import topics_of
from sysid.recording import Recording, read_recording
from sysid.recording.bag import open_bag
from sysid.recording.notes import Notes
from sysid.setup_check.check import likeliest_of_each_kind, notes_of
from sysid.setup_check.compare import Comparison, compare
from sysid.setup_check.probe import Probe, Rollouts, averaged
from sysid.simulate import simulate_to_bag

SHARED = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
FOREIGN = SHARED / "data" / "foreign"

SETUPS = (
    ("strip_coarse", "pull_taut"),
    ("gel_sensor", "press_twist"),
    ("card_press", "press_post"),
    ("glove_finger", "press_far"),
    ("material_bench", "rub_post"),
)
"""Shipped rigs and the experiments that are recorded with them."""

FOREIGN_SETUPS = (("gel_a", "rec_02"), ("strip_a", "rec_02"), ("gel_b", "rec_03"), ("strip_b", "rec_05"))
"""Rigs and recordings of other simulators."""

STARTS = ("start_position", "start_orientation")
"""Notes that say that poses may be of another frame."""

INSTANTS = 40
"""At which an effect is looked for."""

CHANCE = 2.5
"""Mean square of a change, in units of its own variance, below which it is chance, or as good as that."""


@dataclass(frozen=True)
class Setup:
    """A rig, and a sound recording that was made with it."""

    rig: Rig
    recording: Recording
    run: Run
    path: Path


@dataclass(frozen=True)
class Graded:
    """What became of a mistake. ``effect``: root mean square of what it changes in units of the noise of means over
    :data:`INSTANTS`, of the quantity that it changes most; ``said``: in one sentence."""

    rig: str
    made: MistakenRecording
    outcome: str
    effect: float
    said: str


def sound(rig: Rig, experiment: str, folder: Path) -> Recording:
    """A sound recording of an experiment."""
    bag = folder / f"{rig.name}+{experiment}"
    if not bag.exists():
        simulate_to_bag(rig, load_experiment(experiment), bag)
    return recorded(rig, bag)


def recorded(rig: Rig, bag: Path) -> Recording:
    """A recording of a rig as it was made."""
    return read_recording(bag, topics_of(rig, open_bag(bag, Notes()).topics)[0])


def setups(folder: Path, only: str = "", foreign: bool = False) -> list[Setup]:
    """The rigs with their sound recordings; those of other simulators where they are there."""
    found = []
    for name, experiment in SETUPS:
        if only in name:
            rig = load_rig(name)
            found.append((rig, sound(rig, experiment, folder), folder / name))
    for name, bag in FOREIGN_SETUPS if foreign else ():
        if only in name and FOREIGN.is_dir():
            rig = load_rig(str(FOREIGN / name / "rig.yaml"))
            found.append((rig, recorded(rig, FOREIGN / name / bag), FOREIGN / name / bag))
    return [Setup(rig, r, lined_up(rig, examine(r, rig)[1], (), path), path) for rig, r, path in found]


def judged(rig: Rig, recording: Recording, path: Path) -> tuple[tuple[Finding, ...], Comparison | None, Run | None]:
    """All findings, the comparison with the rig, and what was compared; None where it cannot be lined up."""
    findings, seen = examine(recording, rig)
    try:
        run = lined_up(rig, seen, findings, path)
        return findings, compare(rig, run), run
    except ThinshellError:
        return findings, None, None


def graded(setup: Setup, made: MistakenRecording) -> Graded:
    """What the check says of a mistake."""

    def grade(outcome: str, said: str = "", effect: float = np.inf) -> Graded:
        return Graded(setup.rig.name, made, outcome, effect, said)

    findings, comparison, run = judged(setup.rig, made.recording, setup.path)
    for f in findings:
        if f.name in made.names and f.severity != "note":
            return grade("first", f"{f.name}: {f.problem}")
    stopped = [f for f in findings if f.severity == "stops a fit"]
    if comparison is None or run is None:
        return grade("refused")
    named = comparison.named
    sentence = "; or ".join(t.mistake.words for t in likeliest_of_each_kind(named))
    if named and named[0].mistake.kind in made.names:
        return grade("first", sentence)
    effect = effect_of(setup, run)
    if effect**2 < CHANCE:
        return grade("no effect", sentence, effect)
    if any(t.mistake.kind in made.names for t in likeliest_of_each_kind(named)):
        return grade("equal", sentence, effect)
    if named or stopped:
        return grade("other", sentence or stopped[0].problem, effect)
    wanted = made.names if made.kind not in ("tool turned", "flange for tool", "base for base_link") else STARTS
    notes = [f for f in (*notes_of(comparison), *findings) if f.name in wanted]
    if notes:
        return grade("note", notes[0].problem, effect)
    return grade("silent", str({c: (round(e.error, 3), round(e.size, 2)) for c, e in comparison.as_written.items()}),
                 effect)  # fmt: skip


def effect_of(setup: Setup, wrong: Run) -> float:
    """What a mistake changes in the quantity that it changes most, in standard deviations of that change: readings with
    and without the mistake have each their noise, and one that is reversed differs by twice its own."""
    rig, right = setup.rig, setup.run
    noise = channel_noise(rig, [right])
    moved = any(
        right.poses[name].positions.shape != wrong.poses[name].positions.shape
        or not np.allclose(right.poses[name].positions, wrong.poses[name].positions, atol=1e-9)
        or not np.allclose(right.poses[name].quaternions, wrong.poses[name].quaternions, atol=1e-9)
        for name in right.poses
    )
    before = after = None
    if moved:
        rollouts = Rollouts(rig, Probe(right, rig.solver.dt_s, {}, {}))
        before, after = rollouts.along(right.poses), rollouts.along(wrong.poses)
        if before is None or after is None:
            return float("inf")
    largest = 0.0
    for m in right.measured:
        other = next((w for w in wrong.measured if w.channel == m.channel), None)
        if other is None or other.values.shape != m.values.shape:
            return float("inf")
        change = other.values - m.values
        reversed_ = np.isfinite(m.values).any(axis=0) & np.all(
            np.isclose(np.nan_to_num(other.values), -np.nan_to_num(m.values), rtol=1e-9, atol=0.0), axis=0
        )
        if before is not None and after is not None:
            change = change + before[m.channel] - after[m.channel]
        bins = np.minimum((m.t / max(m.t[-1], 1e-9) * INSTANTS).astype(int), INSTANTS - 1)
        bins = np.unique(bins, return_inverse=True)[1]
        means = averaged(change, bins)
        sigma = noise[m.channel].sigma * np.sqrt(noise[m.channel].long_run / np.bincount(bins).min())
        sigma = sigma * np.where(reversed_, 2.0, np.sqrt(2.0))
        for _, columns in quantities(m):
            own = means[:, columns]
            if m.kind == "wrench":
                own = own - np.nanmean(own, axis=0)  # fits have biases
            seen = np.isfinite(own).any(axis=0)
            if seen.any():
                largest = max(largest, float(np.sqrt(np.nanmean((own / sigma[columns])[:, seen] ** 2, axis=0).max())))
    return largest


def cases(count: int, seed: int, folder: Path, only: str = "", foreign: bool = False) -> Iterator[Graded]:
    """So many random mistakes, in turn on every rig."""
    found = setups(folder, only, foreign)
    for k in range(count):
        draw = np.random.default_rng([seed, k])
        setup = found[k % len(found)]
        possible = makers(setup.recording)
        yield graded(setup, possible[int(draw.integers(len(possible)))](setup.rig, setup.recording, draw))


def table(found: list[Graded]) -> str:
    """Kinds by outcomes, and the share that is named."""
    counts = Counter((g.made.kind, g.outcome) for g in found)
    outcomes = [o for o in ("first", "equal", "note", "refused", "other", "silent", "no effect")
                if any(key[1] == o for key in counts)]  # fmt: skip
    lines = [f"{'mistake':<22}" + "".join(f"{o:>11}" for o in outcomes)]
    for kind in [*sorted({key[0] for key in counts}), "all"]:
        row = [sum(n for (k, o), n in counts.items() if kind in (k, "all") and o == out) for out in outcomes]
        lines.append(f"{kind:<22}" + "".join(f"{n:>11}" for n in row))
    seen = [g for g in found if g.outcome != "no effect"]
    first, named = (sum(g.outcome in which for g in seen) for which in (("first",), ("first", "equal", "note")))
    silent = sum(g.outcome == "silent" for g in seen)
    lines.append(f"Of {len(seen)} with an effect {first} are named first, {named} named or noted, {silent} silent.")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rig", default="", help="rigs with this in their names")
    parser.add_argument("--foreign", action="store_true", help="recordings of other simulators too")
    parser.add_argument("--folder", type=Path, help="keep simulated recordings there")
    given = parser.parse_args()
    found = []
    with tempfile.TemporaryDirectory() as temporary:
        begun = time.process_time()
        for g in cases(given.count, given.seed, given.folder or Path(temporary), given.rig, given.foreign):
            found.append(g)
            line = f"{g.rig:<16}{g.made.kind:<20}{g.made.detail:<30}{g.outcome:<10}{g.effect:9.3g}"
            print(f"{line}{time.process_time() - begun:7.0f} s", flush=True)
            if g.outcome != "first":
                print(f"    {g.said[:600]}", flush=True)
    print(f"\n{table(found)}")


if __name__ == "__main__":
    import warnings

    warnings.simplefilter("ignore")
    main()
