"""Tasks: what hands are to do with sheets, gels and objects, as data, and the reward of doing it."""

from sim_core.tasks.actions import ActionSpace
from sim_core.tasks.load import MadeTask, load_task, read_task, task_names
from sim_core.tasks.measure import Scored, Seen
from sim_core.tasks.rollout import Outcome, TaskRollouts
from sim_core.tasks.schema import Task, Variant

__all__ = [
    "ActionSpace",
    "MadeTask",
    "Outcome",
    "Scored",
    "Seen",
    "Task",
    "TaskRollouts",
    "Variant",
    "load_task",
    "read_task",
    "task_names",
]
