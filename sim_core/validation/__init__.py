"""Physics with known answers, run by ``thinshell validate``."""

from __future__ import annotations

import json
from dataclasses import asdict

from sim_core.validation.case import Case
from sim_core.validation.gels import gel_cases
from sim_core.validation.plates import plate_cases
from sim_core.validation.sheets import sheet_cases
from sim_core.validation.shells import shell_cases

__all__ = ["Case", "gel_cases", "plate_cases", "run", "run_validation", "sheet_cases", "shell_cases"]


def run() -> list[Case]:
    """All comparisons, about a minute."""
    return [*sheet_cases(), *plate_cases(), *shell_cases(), *gel_cases()]


def run_validation(as_json: bool = False) -> tuple[bool, str]:
    """Whether all cases are within their tolerance, and the table as text or JSON."""
    cases = run()
    passed = all(case.passed for case in cases)
    if as_json:
        rows = [{**asdict(case), "error": case.error, "order": case.order, "passed": case.passed} for case in cases]
        return passed, json.dumps({"passed": passed, "cases": rows}, indent=2)
    return passed, table(cases)


def table(cases: list[Case]) -> str:
    """The cases as columns of text, and the sources of their answers."""
    head = ("case", "quantity", "reference", "simulated", "error", "allowed", "order", "mesh", "")
    rows = [
        (
            case.name,
            case.quantity,
            f"{case.reference:.5g} {case.unit}".removesuffix(" 1"),
            f"{case.found:.5g}",
            f"{case.error:.2%}",
            f"{case.tolerance:.0%}",
            "" if case.order is None else f"{case.order:.1f}",
            case.mesh,
            "pass" if case.passed else "MISSED",
        )
        for case in cases
    ]
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in (head, *rows)]
    missed = sum(not case.passed for case in cases)
    lines.append(f"{len(cases) - missed} of {len(cases)} within what is allowed.")
    lines.append("Answers: " + "; ".join(sorted({case.source for case in cases})) + ".")
    return "\n".join(lines)
