"""Find and read task files, and make a task with the numbers of one of its variants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sim_core.errors import ConfigError, nearest_match
from sim_core.rigs import Rig, Sheet, load_rig, resolve_name, with_parameters
from sim_core.rigs.load import find_config, names_in
from sim_core.rigs.yamlfile import read_mapping, validate
from sim_core.tasks.schema import Actions, Conditions, Stop, Task, Variant, check_names

DEFAULT_VARIANT = "real"


@dataclass(frozen=True)
class MadeTask:
    """A task with the numbers of one variant. ``rig``: with its parameters and starts; ``coarse_rig``: with the cells
    of searches; ``target_rig``: on which the target is made, None where that is the rig."""

    task: Task
    variant_name: str
    variant: Variant
    rig: Rig
    coarse_rig: Rig
    settings: Mapping[str, Any] = field(default_factory=dict)
    target_rig: Rig | None = None

    @property
    def name(self) -> str:
        """``task`` or ``task:variant``."""
        return self.task.name if self.variant_name == DEFAULT_VARIANT else f"{self.task.name}:{self.variant_name}"

    @property
    def actions(self) -> Actions:
        """What the hands may do."""
        return self.variant.actions or self.task.actions

    @property
    def stop(self) -> Stop:
        """When a rollout ends early."""
        return self.variant.stop or self.task.stop

    @property
    def conditions(self) -> Conditions:
        """What is asked of a success besides the reward."""
        return self.variant.conditions or self.task.conditions

    @property
    def has_coarse(self) -> bool:
        """Whether searches have other cells than the rig."""
        return bool(self.task.coarse)


def task_names() -> list[str]:
    """Names of the tasks that come with the package."""
    return names_in("tasks")


def read_task(name_or_path: str | Path) -> Task:
    """A task file, by the name of one that comes with the package or by its path. Rigs that it names are sought next to
    it first."""
    path = find_config(name_or_path, "tasks")
    task = validate(Task, read_mapping(path), str(path))
    local = {key: path.parent / name for key in ("rig", "target_rig") if (name := getattr(task, key))}
    return task.model_copy(update={key: str(file) for key, file in local.items() if file.is_file()})


def load_task(name: str, parameters: Mapping[str, float] | None = None, rig: str | Path | None = None) -> MadeTask:
    """The task ``NAME`` or ``NAME:VARIANT`` (default: ``real``, else the first one).

    ``parameters``: of the rig, over those of the variant; ``rig``: a name or a file that takes the place of the task's
    rig, on which the target is still made. Raises ``ConfigError``, which names the key and the remedy.
    """
    stem, _, wanted = str(name).rpartition(":") if ":" in str(name) else (str(name), "", "")
    task = read_task(stem)
    if rig is not None:
        task = task.model_copy(update={"rig": str(rig), "target_rig": task.target_rig or task.rig})
    chosen = wanted or (DEFAULT_VARIANT if DEFAULT_VARIANT in task.variants else next(iter(task.variants)))
    if chosen not in task.variants:
        raise ConfigError(f"The task {task.name!r} has no variant {chosen!r}.", nearest_match(chosen, task.variants))
    variant = task.variants[chosen]
    made = _variant_rig(task, chosen, task.rig, parameters or {})
    target = _variant_rig(task, chosen, task.target_rig, {}) if task.target_rig else None
    return MadeTask(task, chosen, variant, made, _with_cells(made, task.coarse), dict(variant.settings), target)


def _variant_rig(task: Task, chosen: str, name: str, parameters: Mapping[str, float]) -> Rig:
    """A rig with the numbers of a variant, and parameters over those."""
    variant, source, rig = task.variants[chosen], f"task {task.name}", load_rig(name)
    check_names(task, variant, rig, source)
    try:
        rig = with_parameters(rig, {**variant.parameters, **parameters})
        for family_name in task.family:
            resolve_name(rig, family_name)
    except ConfigError as error:
        raise ConfigError(f"{source}, variant {chosen}: {error.problem}", error.remedy) from None
    return _started(rig, variant)


def _started(rig: Rig, variant: Variant) -> Rig:
    """The rig with affine bodies that move or stand elsewhere at the start."""
    bodies: dict[str, Any] = dict(rig.bodies)
    for name, start in variant.start.items():
        update: dict[str, Any] = {}
        if start.velocity_m_s is not None:
            update["velocity_m_s"] = start.velocity_m_s
        if start.position_m is not None:
            update["pose"] = bodies[name].pose.model_copy(update={"position_m": start.position_m})
        bodies[name] = bodies[name].model_copy(update=update)
    return rig.model_copy(update={"bodies": bodies})


def _with_cells(rig: Rig, cells: Mapping[str, tuple[int, ...]]) -> Rig:
    bodies: dict[str, Any] = dict(rig.bodies)
    for name, given in cells.items():
        body = bodies[name]
        assert isinstance(body, Sheet)
        bodies[name] = body.model_copy(update={"shape": body.shape.model_copy(update={"cells": tuple(given)})})
    return rig.model_copy(update={"bodies": bodies})
