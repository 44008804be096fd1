"""Scores in words: one line for each case, and one for each rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid.proof.score import CaseScore

HEAD = ("case", "rig", "concealed", "signal", "answer", "outcome", "held out", "recovered", "materials", "time")

WORDS = {
    "false_alarm": "False alarms in cases that conceal nothing",
    "refine": "Answered that the discretisation must be refined first",
    "detected": "Noticed, of cases that conceal something",
    "named": "One effect: named",
    "named_or_right_set": "One effect: named, or the right set",
    "first_three": "One effect: among the first three",
    "both": "Two effects: both named, or in the set",
    "two_nothing_false": "Two effects: nothing false named",
    "right_slot": "Outside the library: unknown, in the right slot",
    "sure_and_wrong": "Outside the library: a wrong name above 0.9",
    "wrong": "Something false named",
    "held_out_worse": "Held-out error worse with the answer",
    "held_out_excess_halved": "Right names that take away half of the held-out misfit beyond noise",
    "parameters_recovered": "Effect parameters within their 95 % interval",
    "materials_recovered": "Materials within their 95 % interval",
}


def table(scores: Sequence[CaseScore]) -> str:
    """One line for each case."""
    rows = [HEAD]
    for s in scores:
        rows.append(
            (
                s.case,
                s.rig,
                " and ".join(s.effects) or "nothing",
                f"{s.signal:.0f}" if s.effects else "",
                (" or " if s.verdict == "one_of" else " and ").join(s.answer) or s.verdict,
                s.outcome,
                f"{_number(s.held_out_before)} -> {_number(s.held_out_after)}",
                f"{s.recovered[0]}/{s.recovered[1]}" if s.recovered[1] else "",
                f"{s.materials[0]}/{s.materials[1]}" if s.materials[1] else "",
                f"{s.seconds:.0f} s",
            )
        )
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return "\n".join("  ".join(word.ljust(w) for word, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def sentences(summary: dict[str, Any]) -> str:
    """One line for each rate that has cases."""
    lines = []
    for key, text in WORDS.items():
        rate = summary[key]
        if rate["of"]:
            low, high = rate["ci95"]
            interval = f" (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"
            lines.append(f"{text}: {rate['count']} of {rate['of']}{interval}")
    seconds = summary["seconds"]
    if seconds["median"] is not None:
        lines.append(f"Time of a diagnosis: median {seconds['median']:.0f} s, longest {seconds['longest']:.0f} s")
    if summary["errors"]:
        lines.append(f"No answer: {summary['errors']}")
    return "\n".join(lines)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
