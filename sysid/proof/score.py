"""Compare the answers with the truth: what was named, what was missed, what the fit gained.

Outcomes. Without an effect: ``clear`` or ``false alarm``. With one: ``named`` (it alone), ``right set`` (one
of several said to be indistinguishable, the true one among them), ``wrong`` (others), ``unknown`` (noticed,
not named), ``missed`` (nothing noticed). Either: ``error`` (no answer).
"""

from __future__ import annotations

import json
import math
import statistics
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sim_core.effects import effect_by_name
from sim_core.errors import ConfigError
from sysid.proof.run import ANSWERS_FILE, ANSWERS_FOLDER, DIAGNOSIS_FILE
from sysid.proof.seal import file_digest, open_seal

SCORE_FILE = "score.json"
RIGHT = ("named", "right set")


@dataclass(frozen=True)
class CaseScore:
    """One case. ``held_out_before``, ``held_out_after``: mean squared whitened residual on held-out data with
    the baseline and with the effect; ``recovered``: the effect's parameters whose 95 % interval holds the
    truth, of how many; ``materials``: the same for the fitted materials; ``seconds``: time of the diagnosis."""

    case: str
    effect: str | None
    signal: float
    verdict: str
    answer: list[str]
    outcome: str
    held_out_before: float | None
    held_out_after: float | None
    recovered: tuple[int, int]
    materials: tuple[int, int]
    seconds: float


def score_cases(folder: Path) -> str:
    """Verify seal and answers, score them, write ``score.json``; the returned text is the table."""
    truth = open_seal(folder)
    answers = _open_answers(folder)
    scores = [_score(folder, case, answers["cases"]) for case in truth["cases"]]
    summary = summarise(scores)
    data = {"seed": truth["seed"], "summary": summary, "cases": [asdict(s) for s in scores]}
    path = folder / SCORE_FILE
    path.write_text(json.dumps(data, indent=2) + "\n")
    return f"{table(scores)}\n\n{_sentences(summary)}\nWritten: {path}"


def _open_answers(folder: Path) -> dict[str, Any]:
    """The answers, if neither they nor the diagnoses have changed since the run."""
    path = folder / ANSWERS_FILE
    seal = folder / f"{ANSWERS_FILE}.sha256"
    if not path.is_file() or not seal.is_file():
        raise ConfigError(f"{folder} holds no answers.", "Diagnose the cases with 'thinshell prove run DIR'.")
    if file_digest(path) != seal.read_text().strip():
        raise ConfigError(f"{path} has changed since the run.", "Run the cases again.")
    answers = dict(json.loads(path.read_text()))
    for name, entry in answers["cases"].items():
        if "sha256" in entry:
            found = folder / ANSWERS_FOLDER / name / DIAGNOSIS_FILE
            if not found.is_file() or file_digest(found) != entry["sha256"]:
                raise ConfigError(f"{found} has changed since the run.", "Run the cases again.")
    return answers


def _score(folder: Path, truth: dict[str, Any], entries: dict[str, Any]) -> CaseScore:
    name, effect = truth["case"], truth["effect"]
    entry = entries.get(name, {"error": "not run", "seconds": math.nan})
    if "sha256" not in entry:
        return CaseScore(name, effect, truth["signal"], "", [], "error", None, None, (0, 0), (0, 0), entry["seconds"])
    diagnosis = json.loads((folder / ANSWERS_FOLDER / name / DIAGNOSIS_FILE).read_text())
    fit = diagnosis["fit"]
    amended = fit["amended"]
    said = [p for e in diagnosis["effects"] if e["name"] == effect for p in e["parameters"]]
    materials = diagnosis["amended_parameters"] or diagnosis["baseline_parameters"]
    return CaseScore(
        name,
        effect,
        truth["signal"],
        diagnosis["verdict"],
        entry["effects"],
        outcome(effect, diagnosis["verdict"], entry["effects"]),
        fit["baseline"]["held_out"],
        amended["held_out"] if amended else None,
        _recovered(effect, truth["parameters"], said),
        within(truth["materials"], materials),
        entry["seconds"],
    )


def outcome(effect: str | None, verdict: str, answer: list[str]) -> str:
    """Outcome of one case in a word or two (see the module)."""
    if effect is None:
        return "clear" if verdict == "nothing_missing" else "false alarm"
    if verdict == "nothing_missing":
        return "missed"
    if verdict == "unknown":
        return "unknown"
    if verdict == "named":
        return "named" if answer == [effect] else "wrong"
    return "right set" if effect in answer else "wrong"


def _recovered(effect: str | None, truth: dict[str, float], said: list[dict[str, Any]]) -> tuple[int, int]:
    """:func:`within` for the description of the effect's law that the answer comes closest to."""
    if effect is None:
        return within(truth, said)
    same = [truth, *(dict(e) for e in effect_by_name(effect).equivalents(truth))]
    return max(within(values, said) for values in same)


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


def summarise(scores: list[CaseScore]) -> dict[str, Any]:
    """Counts and rates with their intervals, and times [s]."""
    nulls = [s for s in scores if s.effect is None]
    concealed = [s for s in scores if s.effect is not None]
    right = [s for s in concealed if s.outcome in RIGHT]
    known = [s for s in right if s.held_out_before is not None and s.held_out_after is not None]
    lower = [s for s in known if (s.held_out_after or 0.0) < (s.held_out_before or 0.0)]
    times = sorted(s.seconds for s in scores if math.isfinite(s.seconds))
    return {
        "false_alarm": _rate(sum(s.outcome == "false alarm" for s in nulls), len(nulls)),
        "detected": _rate(sum(s.outcome not in ("missed", "error") for s in concealed), len(concealed)),
        "named": _rate(sum(s.outcome == "named" for s in concealed), len(concealed)),
        "named_or_right_set": _rate(len(right), len(concealed)),
        "wrong": _rate(sum(s.outcome == "wrong" for s in concealed), len(concealed)),
        "errors": sum(s.outcome == "error" for s in scores),
        "held_out_lower": _rate(len(lower), len(right)),
        "parameters_recovered": _rate(sum(s.recovered[0] for s in right), sum(s.recovered[1] for s in right)),
        "materials_recovered": _rate(sum(s.materials[0] for s in scores), sum(s.materials[1] for s in scores)),
        "seconds": {"median": statistics.median(times) if times else None, "longest": times[-1] if times else None},
    }


def _rate(count: int, of: int) -> dict[str, Any]:
    low, high = wilson(count, of)
    return {"count": count, "of": of, "ci95": [round(low, 4), round(high, 4)]}


def table(scores: list[CaseScore]) -> str:
    """One line for each case."""
    rows = [("case", "concealed", "signal", "answer", "outcome", "held out", "recovered", "materials", "time")]
    for s in scores:
        error = f"{_number(s.held_out_before)} -> {_number(s.held_out_after)}"
        rows.append(
            (
                s.case,
                s.effect or "nothing",
                f"{s.signal:.0f}" if s.effect else "",
                " or ".join(s.answer) or s.verdict,
                s.outcome,
                error,
                f"{s.recovered[0]}/{s.recovered[1]}" if s.recovered[1] else "",
                f"{s.materials[0]}/{s.materials[1]}" if s.materials[1] else "",
                f"{s.seconds:.0f} s",
            )
        )
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return "\n".join("  ".join(word.ljust(w) for word, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _sentences(summary: dict[str, Any]) -> str:
    words = {
        "false_alarm": "False alarms",
        "detected": "Detected",
        "named": "Named",
        "named_or_right_set": "Named, or the right set",
        "wrong": "Wrong",
        "held_out_lower": "Held-out error lower, of those",
        "parameters_recovered": "Effect parameters within their 95 % interval",
        "materials_recovered": "Materials within their 95 % interval",
    }
    lines = []
    for key, text in words.items():
        rate = summary[key]
        low, high = rate["ci95"]
        interval = f" (95 % interval {100 * low:.0f} to {100 * high:.0f} %)" if rate["of"] else ""
        lines.append(f"{text}: {rate['count']} of {rate['of']}{interval}")
    seconds = summary["seconds"]
    if seconds["median"] is not None:
        lines.append(f"Time of a diagnosis: median {seconds['median']:.0f} s, longest {seconds['longest']:.0f} s")
    if summary["errors"]:
        lines.append(f"No answer: {summary['errors']}")
    return "\n".join(lines)
