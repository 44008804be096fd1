"""What looks wrong in a rig, or in a motion on it, reported in words before anything long runs.

Everything here is geometry of the rig's file and of the commanded poses; nothing is simulated. What cannot be known
without a simulation (how far a sheet sags, where a free body goes) gives no finding.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim_core.postprocess import Layout, lay_out
from sim_core.preflight.bonds import bond_findings
from sim_core.preflight.coarse import coarse_findings
from sim_core.preflight.finding import Finding
from sim_core.preflight.overlaps import overlap_findings
from sim_core.preflight.pieces import piece_findings
from sim_core.preflight.sight import sight_findings
from sim_core.preflight.speed import speed_findings
from sim_core.preflight.touch import touch_findings
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory

__all__ = ["Finding", "review"]


def review(
    rig: Rig, poses: Mapping[str, PoseTrajectory] | None = None, *, layout: Layout | None = None
) -> list[Finding]:
    """Findings on a rig as it stands and, with ``poses`` by end effector, on the motion; none where all looks right."""
    layout = layout or lay_out(rig)
    found = [*overlap_findings(layout), *bond_findings(layout), *coarse_findings(layout)]
    found += piece_findings(layout)
    found += sight_findings(layout, poses)
    return [*found, *((*touch_findings(layout, poses), *speed_findings(rig, poses)) if poses is not None else [])]
