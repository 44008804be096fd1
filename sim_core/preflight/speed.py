"""Motions that are more than the hands of a rig may do, so that no robot would be let to execute them."""

from __future__ import annotations

from collections.abc import Mapping

from sim_core.preflight.finding import Finding
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.trajectories.check import motion_figures, outside
from sim_core.trajectories.make import planned_path


def speed_findings(rig: Rig, poses: Mapping[str, PoseTrajectory]) -> list[Finding]:
    """One for each end effector and limit that its motion exceeds."""
    found = []
    for name, path in poses.items():
        limits = rig.end_effectors[name].limits.limits()
        planned = planned_path(path.times, path)
        words = [*outside(name, planned, limits)]
        words += [f"{figure}." for figure in motion_figures(name, planned, limits, 1.0) if figure.exceeded]
        found += [
            Finding("hand limits", text, f"A robot is not let to do that: slow it down, or correct limits of {name}.")
            for text in words
        ]
    return found
