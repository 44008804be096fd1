"""What speaks against believing recordings, whatever a fit makes of them: faults, and too few readings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.fit.runs import Run
from sysid.recording.notes import plural

FEW = 10
"""Instants with readings, of all recordings together, below which a fit that explains them says little."""

LISTED = 3
"""Faults of a recording that are named; the notes have the others."""


def doubts(runs: Sequence[Run]) -> list[str]:
    """A sentence for each recording that was read with faults, and one where there are hardly any readings."""
    said = []
    for run in runs:
        if run.doubts:
            more = f"; and {len(run.doubts) - LISTED} more, in the notes" if len(run.doubts) > LISTED else ""
            said.append(
                f"{run.name} was read with {plural(len(run.doubts), 'fault')} that may change the result: "
                f"{'; '.join(run.doubts[:LISTED])}{more}."
            )
    instants = sum(max(int(np.isfinite(m.values).any(axis=1).sum()) for m in run.measured) for run in runs)
    if instants < FEW:
        said.append(
            f"There are readings of {plural(instants, 'instant')} only. That a rig explains so few says little of it: "
            "record for longer."
        )
    return said
