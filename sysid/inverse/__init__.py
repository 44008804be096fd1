"""Inverse tasks: one number of a rig is sought from a recording, by the fit and by what ThinShellLab did."""

from sysid.inverse.benchmark import InverseRow, inverse_benchmark, inverse_table
from sysid.inverse.task import InverseTask, inverse_task_names, load_inverse_task

__all__ = [
    "InverseRow",
    "InverseTask",
    "inverse_benchmark",
    "inverse_table",
    "inverse_task_names",
    "load_inverse_task",
]
