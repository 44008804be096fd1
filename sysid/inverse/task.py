"""Inverse tasks as data: ``config/inverse/*.yaml``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from sim_core.rigs import Rig, load_rig
from sim_core.rigs.fields import Name, Strict, Text
from sim_core.rigs.load import find_config, names_in
from sim_core.rigs.yamlfile import read_mapping, validate

Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]


class InverseTask(Strict):
    """What is recorded and what is sought.

    The recording is that of ``experiment`` on ``rig``, with the noise of its sensors and steps of ``dt_s`` [s], those
    of the rig where it is not given. ``seeks``: parameter of the rig, whose value there is the truth; ``begins``: where
    searches start, over the truth.
    """

    name: Name
    description: Text
    rig: Text
    experiment: Text
    seeks: Text
    begins: tuple[Positive, ...] = Field(min_length=1)
    dt_s: Positive | None = None


def rig_of(task: InverseTask) -> Rig:
    """The rig of a task, with its steps."""
    rig = load_rig(task.rig)
    return (
        rig
        if task.dt_s is None
        else rig.model_copy(update={"solver": rig.solver.model_copy(update={"dt_s": task.dt_s})})
    )


def inverse_task_names() -> list[str]:
    """Names of the inverse tasks that come with the package."""
    return names_in("inverse")


def load_inverse_task(name_or_path: str | Path) -> InverseTask:
    """An inverse task, by the name of one that comes with the package or by the path of its file."""
    path = find_config(name_or_path, "inverse")
    return validate(InverseTask, read_mapping(path), str(path))
