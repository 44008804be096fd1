"""Trajectories as a versioned file format: made in simulation, checked as a whole, replayed on a robot.

from sim_core.trajectories import make_trajectory, read_trajectory, rollout, write_trajectory
trace = rollout(rig, poses)
write_trajectory("press.json", make_trajectory(rig, poses, traces=[trace], limits=Limits(max_force_n=5.0)))
"""

from sim_core.rigs.limits import Limits
from sim_core.trajectories.check import Figure, Review, check_trajectory
from sim_core.trajectories.file import parse_trajectory, read_trajectory, write_csv, write_trajectory
from sim_core.trajectories.make import bounded, make_trajectory, planned_path, predict, rollout
from sim_core.trajectories.model import (
    VERSION,
    EffectorPath,
    MarkerPrediction,
    Passage,
    Prediction,
    RigReference,
    Trajectory,
    WrenchPrediction,
)

__all__ = [
    "VERSION",
    "EffectorPath",
    "Figure",
    "Limits",
    "MarkerPrediction",
    "Passage",
    "Prediction",
    "Review",
    "RigReference",
    "Trajectory",
    "WrenchPrediction",
    "bounded",
    "check_trajectory",
    "make_trajectory",
    "parse_trajectory",
    "planned_path",
    "predict",
    "read_trajectory",
    "rollout",
    "write_csv",
    "write_trajectory",
]
