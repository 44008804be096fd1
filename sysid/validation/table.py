"""The comparisons as a table for people and as JSON for programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from statistics import median

from sysid.validation.case import LEAST_ORDER, Case, NotCovered

HEAD = ("case", "quantity", "reference", "simulated", "error", "allowed", "order", "CPU s", "mesh", "")


def as_json_text(rows: Sequence[Case | NotCovered], passed: bool) -> str:
    """All rows with everything that is known about them."""
    cases = [
        {**asdict(row), "error": row.error, "order": row.order, "passed": row.passed}
        for row in rows
        if isinstance(row, Case)
    ]
    gaps = [asdict(row) for row in rows if isinstance(row, NotCovered)]
    return json.dumps({"passed": passed, "cases": cases, "not_covered": gaps}, indent=2)


def table(rows: Sequence[Case | NotCovered]) -> str:
    """The cases as columns of text; then remarks, what is not covered, and the sources of the solutions."""
    cases = [row for row in rows if isinstance(row, Case)]
    cells = [
        (
            case.name,
            case.quantity,
            f"{case.reference:.5g} {case.unit}".removesuffix(" 1"),
            f"{case.found:.5g}",
            percent(case.error),
            percent(case.tolerance),
            "" if case.order is None else f"{case.order:.1f}",
            "" if case.cpu_s is None else f"{case.cpu_s:.1f}",
            case.mesh,
            "pass" if case.passed else "MISSED",
        )
        for case in cases
    ]
    widths = [max(len(row[k]) for row in (HEAD, *cells)) for k in range(len(HEAD))]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in (HEAD, *cells)]
    missed = sum(not case.passed for case in cases)
    lines.append(f"{len(cases) - missed} of {len(cases)} within what is allowed.")
    orders = sorted(case.order for case in cases if case.order is not None)
    if orders:
        lines.append(
            f"Observed orders of convergence: {orders[0]:.2f} to {orders[-1]:.2f}, median {median(orders):.2f}, of "
            f"{len(orders)} cases; at least {LEAST_ORDER:g} is asked for."
        )
    remarks: dict[str, str] = {}
    for case in cases:
        if case.remark:
            remarks.setdefault(case.remark, case.name)
    gaps = [f"{row.name}: {row.reason} [{row.source}]" for row in rows if isinstance(row, NotCovered)]
    for title, texts in (("Remarks", [f"{name}: {remark}" for remark, name in remarks.items()]), ("Not covered", gaps)):
        if texts:
            lines += [f"{title}:", *(f"  {text}" for text in texts)]
    lines.append("Solutions: " + "; ".join(sorted({case.source for case in cases})) + ".")
    return "\n".join(lines)


def percent(share: float) -> str:
    """A share in percent; tiny ones by their power of ten."""
    if share == 0.0 or share >= 5e-5:
        return f"{share:.2%}" if share < 0.1 else f"{share:.0%}"
    return f"{100.0 * share:.0e}%"
