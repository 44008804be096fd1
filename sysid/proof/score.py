"""Compare the diagnoses with the truth: what was named, what was missed, what the fit gained.

Rates are given for all cases, and apart for those whose truth comes from another formulation than the simulator's
(:mod:`sysid.proof.truths`). Outcomes: :mod:`sysid.proof.outcome`.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sim_core.effects import all_effects, effect_by_name
from sim_core.errors import ConfigError
from sysid.proof.answer import Answer
from sysid.proof.outcome import among_first, kind_of, outcome, sure_and_wrong
from sysid.proof.run import ANSWERS_FILE, ANSWERS_FOLDER, DIAGNOSIS_FILE
from sysid.proof.score_table import sentences, table
from sysid.proof.seal import file_digest, open_seal

SCORE_FILE = "score.json"
RIGHT = ("named", "right set")
NOTICED = ("named", "right set", "one of two", "right slot", "other slot", "unknown", "wrong")


@dataclass(frozen=True)
class CaseScore:
    """One case. ``truth``: simulator that made it; ``signal``: least of its effects; ``held_out_before``,
    ``held_out_after``: mean squared whitened residual on held-out data with the baseline and with the answer;
    ``recovered``: parameters of the effects whose 95 % interval holds the truth, of how many; ``materials``: the same
    for the fitted materials; ``seconds``: time of the diagnosis."""

    case: str
    rig: str
    truth: str
    kind: str
    effects: tuple[str, ...]
    signal: float
    verdict: str
    answer: tuple[str, ...]
    outcome: str
    first_three: bool
    sure_and_wrong: bool
    held_out_before: float | None
    held_out_after: float | None
    recovered: tuple[int, int]
    materials: tuple[int, int]
    seconds: float


def score_cases(folder: Path) -> str:
    """Verify seal and diagnoses, score them, write ``score.json``; the returned text is the table."""
    truth = open_seal(folder)
    diagnoses = _open_answers(folder)
    scores = [_score(case, diagnoses["cases"]) for case in truth["cases"]]
    apart = [s for s in scores if s.truth != "simulator"]
    summary = {"all": summarise(scores), "independent": summarise(apart)}
    data = {"seed": truth["seed"], "summary": summary, "cases": [asdict(s) for s in scores]}
    path = folder / SCORE_FILE
    path.write_text(json.dumps(data, indent=2) + "\n")
    text = f"{table(scores)}\n\n{sentences(summary['all'])}"
    if apart and len(apart) < len(scores):
        text += f"\n\nTruth by another formulation ({len(apart)} cases):\n{sentences(summary['independent'])}"
    return f"{text}\nWritten: {path}"


def _open_answers(folder: Path) -> dict[str, Any]:
    """What all diagnoses say, if neither that nor they have changed since the run. A shard that is kept without its
    diagnoses has only their digests."""
    path = folder / ANSWERS_FILE
    seal = folder / f"{ANSWERS_FILE}.sha256"
    if not path.is_file() or not seal.is_file():
        raise ConfigError(f"{folder} holds no diagnoses.", "Diagnose the cases with 'thinshell prove run DIR'.")
    if file_digest(path) != seal.read_text().strip():
        raise ConfigError(f"{path} has changed since the run.", "Run the cases again.")
    diagnoses = dict(json.loads(path.read_text()))
    for name, entry in diagnoses["cases"].items():
        if "sha256" in entry:
            found = folder / ANSWERS_FOLDER / name / DIAGNOSIS_FILE
            if found.is_file() and file_digest(found) != entry["sha256"]:
                raise ConfigError(f"{found} has changed since the run.", "Run the cases again.")
    return diagnoses


def _score(truth: dict[str, Any], entries: dict[str, Any]) -> CaseScore:
    """Of one case."""
    name, effects = truth["case"], truth["effects"]
    entry = entries.get(name, {"error": "not run", "seconds": math.nan})
    signal = min((e["signal"] for e in effects), default=0.0)
    known = (name, truth["rig"], truth["truth"], kind_of(effects), tuple(e["name"] for e in effects), signal)
    if not entry.get("answer"):
        nothing = (0, 0)
        return CaseScore(*known, "", (), "error", False, False, None, None, nothing, nothing, entry["seconds"])
    answer = Answer(**entry["answer"])
    return CaseScore(
        *known,
        answer.verdict,
        answer.named,
        outcome(effects, answer),
        among_first(effects, answer),
        sure_and_wrong(effects, answer),
        answer.before,
        answer.after,
        _recovered(effects, answer),
        within(truth["materials"], answer.materials),
        entry["seconds"],
    )


def _recovered(effects: Sequence[dict[str, Any]], answer: Answer) -> tuple[int, int]:
    """:func:`within` over the effects that were named, each for the description that the answer comes closest to."""
    held, given = 0, 0
    for effect in effects:
        name, true = effect["name"], effect["parameters"]
        if name not in answer.parameters:
            continue
        same = [true]
        if name in all_effects() and true.keys() == {p.name for p in effect_by_name(name).parameters}:
            same += [dict(e) for e in effect_by_name(name).equivalents(true)]
        best = max(within(values, answer.parameters[name]) for values in same)
        held, given = held + best[0], given + best[1]
    return held, given


def within(truth: dict[str, float], said: list[dict[str, Any]]) -> tuple[int, int]:
    """How many true values lie in the 95 % interval given for them, of those that were given."""
    held, given = 0, 0
    for name, value in truth.items():
        for p in said:
            if p["name"] == name or p["name"].endswith("." + name):
                low, high = p["ci95"]
                given += 1
                held += low <= value <= high
    return held, given


def wilson(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson's 95 % interval of a rate (Wilson 1927); the whole range without trials."""
    if trials == 0:
        return 0.0, 1.0
    share = successes / trials
    middle = share + z * z / (2 * trials)
    half = z * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials**2))
    scale = 1 + z * z / trials
    return max(0.0, (middle - half) / scale), min(1.0, (middle + half) / scale)


def summarise(scores: Sequence[CaseScore]) -> dict[str, Any]:
    """Counts and rates with their intervals, and times [s]. Cases without an answer count as not right."""
    empty, one, two, outside = ([s for s in scores if s.kind == k] for k in ("empty", "one", "two", "outside"))
    concealed = [*one, *two, *outside]
    right = [s for s in concealed if s.outcome in RIGHT]
    amended = [s for s in scores if s.held_out_before is not None and s.held_out_after is not None]
    worse = [s for s in amended if (s.held_out_after or 0.0) > 1.02 * (s.held_out_before or 0.0)]
    halved = [s for s in right if s in amended and _excess_halved(s)]
    times = sorted(s.seconds for s in scores if math.isfinite(s.seconds))
    return {
        "false_alarm": _rate(sum(s.outcome == "false alarm" for s in empty), len(empty)),
        "refine": _rate(sum(s.outcome == "refine" for s in scores), len(scores)),
        "detected": _rate(sum(s.outcome in NOTICED for s in concealed), len(concealed)),
        "named": _rate(sum(s.outcome == "named" for s in one), len(one)),
        "named_or_right_set": _rate(sum(s.outcome in RIGHT for s in one), len(one)),
        "first_three": _rate(sum(s.first_three for s in one), len(one)),
        "both": _rate(sum(s.outcome in RIGHT for s in two), len(two)),
        "two_nothing_false": _rate(sum(s.outcome not in ("wrong", "error") for s in two), len(two)),
        "right_slot": _rate(sum(s.outcome == "right slot" for s in outside), len(outside)),
        "sure_and_wrong": _rate(sum(s.sure_and_wrong for s in outside), len(outside)),
        "wrong": _rate(sum(s.outcome == "wrong" for s in concealed), len(concealed)),
        "errors": sum(s.outcome == "error" for s in scores),
        "held_out_worse": _rate(len(worse), len(amended)),
        "held_out_excess_halved": _rate(len(halved), len(right)),
        "parameters_recovered": _rate(sum(s.recovered[0] for s in right), sum(s.recovered[1] for s in right)),
        "materials_recovered": _rate(sum(s.materials[0] for s in scores), sum(s.materials[1] for s in scores)),
        "seconds": {"median": statistics.median(times) if times else None, "longest": times[-1] if times else None},
    }


def _excess_halved(score: CaseScore) -> bool:
    """Whether the answer takes away more than half of the misfit beyond noise on held-out data."""
    before, after = (score.held_out_before or 0.0) - 1.0, (score.held_out_after or 0.0) - 1.0
    return after < 0.5 * before


def _rate(count: int, of: int) -> dict[str, Any]:
    low, high = wilson(count, of)
    return {"count": count, "of": of, "ci95": [round(low, 4), round(high, 4)]}
