"""Physics with known solutions, run by ``thinshell validate``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from sim_core.errors import ConfigError, nearest_match
from sysid.progress.callback import Progress
from sysid.validation.anticlastic import anticlastic_cases
from sysid.validation.buckling import buckling_cases
from sysid.validation.capstan import capstan_cases
from sysid.validation.case import Case, NotCovered
from sysid.validation.damping import damping_cases
from sysid.validation.drape import drape_cases
from sysid.validation.elasticas import elastica_cases
from sysid.validation.films import film_cases
from sysid.validation.friction import friction_cases
from sysid.validation.gels import gel_cases
from sysid.validation.hencky import hencky_cases
from sysid.validation.invariances import invariance_cases
from sysid.validation.lateral_buckling import lateral_buckling_cases
from sysid.validation.obstacles import obstacle_cases
from sysid.validation.plates import plate_cases
from sysid.validation.punch import punch_cases
from sysid.validation.rig_plates import rig_plate_cases
from sysid.validation.rough_plane import rough_plane_cases
from sysid.validation.shaken_strip import shaken_strip_cases
from sysid.validation.shells import shell_cases
from sysid.validation.solids import solid_cases
from sysid.validation.springback import springback_cases
from sysid.validation.table import as_json_text, table

__all__ = ["GROUPS", "Case", "NotCovered", "run", "run_validation"]

GROUPS: dict[str, tuple[Callable[[], Iterator[Case | NotCovered]], float]] = {
    "invariances": (invariance_cases, 5.0),
    "elasticas": (elastica_cases, 60.0),
    "buckling": (buckling_cases, 30.0),
    "anticlastic": (anticlastic_cases, 12.0),
    "springback": (springback_cases, 21.0),
    "plates": (plate_cases, 80.0),
    "obstacles": (obstacle_cases, 95.0),
    "shells": (shell_cases, 100.0),
    "solids": (solid_cases, 4.0),
    "gels": (gel_cases, 45.0),
    "flat punch": (punch_cases, 50.0),
    "damping": (damping_cases, 5.0),
    "friction": (friction_cases, 5.0),
    "rough plane": (rough_plane_cases, 22.0),
    "capstan": (capstan_cases, 15.0),
    "plates of rigs": (rig_plate_cases, 20.0),
    "lateral buckling": (lateral_buckling_cases, 10.0),
    "films": (film_cases, 12.0),
    "membrane": (hencky_cases, 8.0),
    "drape": (drape_cases, 16.0),
    "shaken strip": (shaken_strip_cases, 6.0),
}
"""What is compared, group by group, and its share of the time, about seconds."""


def timed(rows: Iterator[Case | NotCovered]) -> Iterator[Case | NotCovered]:
    """The rows, each with the processor time since the one before it: a run that gives several counts for the first."""
    before = time.process_time()
    for row in rows:
        now = time.process_time()
        yield replace(row, cpu_s=now - before) if isinstance(row, Case) else row
        before = time.process_time()


def run(on_progress: Progress | None = None, groups: Sequence[str] = ()) -> list[Case | NotCovered]:
    """All comparisons, some minutes, or those of some groups. ``on_progress(share, text)`` is called before each group
    and at the end. Raises ``ConfigError`` for a group that there is not."""
    for group in groups:
        if group not in GROUPS:
            raise ConfigError(f"There is no group {group!r} of comparisons.", nearest_match(group, GROUPS))
    chosen = {title: GROUPS[title] for title in GROUPS if not groups or title in groups}
    rows: list[Case | NotCovered] = []
    total, before = sum(seconds for _, seconds in chosen.values()), 0.0
    for title, (cases, seconds) in chosen.items():
        if on_progress is not None:
            on_progress(before / total, title)
        rows += timed(cases())
        before += seconds
    if on_progress is not None:
        on_progress(1.0, "")
    return rows


def run_validation(
    as_json: bool = False,
    on_progress: Progress | None = None,
    groups: Sequence[str] = (),
) -> tuple[bool, str]:
    """Whether all cases, or those of some groups, are within their tolerance, and the table as text or JSON."""
    rows = run(on_progress, groups)
    passed = all(row.passed for row in rows if isinstance(row, Case))
    return passed, as_json_text(rows, passed) if as_json else table(rows)
