"""What a fit or a diagnosis over ROS is asked to do: parameter values, checked and made into arguments of the library.
No ROS."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from sim_core.errors import ConfigError, RecordingError
from sim_core.rigs import Rig, resolve_name, with_parameters
from sysid.fit.options import FitOptions
from sysid.model.parameters import asked_for
from sysid.observations.selection import check_parts, part_of
from sysid.recording.bag import open_bag
from sysid.recording.notes import Notes


@dataclass(frozen=True)
class FitRequest:
    """Arguments of :func:`sysid.workflow.fit_bags`. ``rig``: at the values where the fit starts; ``out``: a folder that
    does not exist."""

    kind: ClassVar = "fit"
    file: ClassVar = "fit.json"
    rig: Rig
    bags: tuple[Path, ...]
    held_out: tuple[Path, ...]
    names: tuple[str, ...]
    options: FitOptions
    out: Path


@dataclass(frozen=True)
class DiagnosisRequest:
    """Arguments of :func:`sysid.workflow.diagnose_bags`. ``out``: a folder that does not exist."""

    kind: ClassVar = "diagnosis"
    file: ClassVar = "diagnosis.json"
    rig: Rig
    bags: tuple[Path, ...]
    held_out: tuple[Path, ...]
    out: Path


def diagnosis_request(rig: Rig, topics: Mapping[str, str], values: Mapping[str, Any], job_id: str) -> DiagnosisRequest:
    """The request for a diagnosis; as :func:`fit_request`, of ``bag_uri``, ``held_out_uri`` and ``output_dir``."""
    rig, bags, held_out = _recordings(rig, topics, values)
    return DiagnosisRequest(rig, bags, held_out, folder_of(values["output_dir"]) / job_id)


def _recordings(
    rig: Rig, topics: Mapping[str, str], values: Mapping[str, Any]
) -> tuple[Rig, tuple[Path, ...], tuple[Path, ...]]:
    """The rig with the topics of the recordings, these, and those held out. Raises ``ThinshellError``."""
    bags = _paths(values["bag_uri"], "bag_uri")
    held_out = _paths(values["held_out_uri"], "held_out_uri")
    if not bags:
        raise ConfigError("There is no recording to fit.", "Set the parameter bag_uri to a bag, or to a list of them.")
    check_parts(bags, held_out)
    _check_topics(rig, [*bags, *held_out], {n: t for n, t in topics.items() if t != topic_names(rig)[n]})
    return with_topics(rig, topics), bags, held_out


def fit_request(rig: Rig, topics: Mapping[str, str], values: Mapping[str, Any], job_id: str) -> FitRequest:
    """The request that parameter values stand for, None where one has no value. Raises ``ThinshellError``.

    ``topics``: of the recordings, by the names of :func:`topic_names`; ``values``: by the names of the node's
    parameters; ``job_id``: name of the folder that is made in ``output_dir``.
    """
    rig, bags, held_out = _recordings(rig, topics, values)
    names = parameters_of(rig, values, "what to fit")
    initial = _numbers(values["fit.initial"], names, "fit.initial")
    rig = with_parameters(rig, dict(zip(names, initial, strict=False)))
    lower = _numbers(values["fit.lower"], names, "fit.lower") or [-math.inf] * len(names)
    upper = _numbers(values["fit.upper"], names, "fit.upper") or [math.inf] * len(names)
    bounds = dict(zip(names, zip(lower, upper, strict=True), strict=True))
    for name, value in zip(names, initial, strict=False):
        if not bounds[name][0] <= value <= bounds[name][1]:
            raise ConfigError(
                f"fit.initial has {value:g} for {name}, which is not within fit.lower and fit.upper, "
                f"{bounds[name][0]:g} to {bounds[name][1]:g}.",
                "Start within the bounds.",
            )
    spread = _numbers(values["fit.prior_sd"], names, "fit.prior_sd")
    if spread and not initial:
        raise ConfigError(
            "fit.prior_sd says how well values are known, and fit.initial does not say which.",
            "Set fit.initial to those values.",
        )
    priors = {name: (at, sd) for name, at, sd in zip(names, initial, spread, strict=False) if sd != 0.0}
    per_bag = [resolve_name(rig, name) for name in values["fit.per_bag"] or []]
    asked_for(rig, names, priors=priors, bounds=bounds, per_bag=per_bag, bags=[str(bag) for bag in bags])
    options = FitOptions(
        nuisance=nuisance_of(values),
        per_bag=per_bag,
        priors=priors,
        bounds=bounds,
        starts=values["fit.starts"],
        intervals="profiled" if values["fit.profile"] else "checked",
        max_evaluations=values["fit.max_iterations"],
        robust=values["fit.robust"],
        seed=values["fit.seed"],
    )
    out = folder_of(values["output_dir"]) / job_id
    return FitRequest(rig, bags, held_out, tuple(names), options, out)


def parameters_of(rig: Rig, values: Mapping[str, Any], purpose: str) -> list[str]:
    """Full names of the parameters of ``fit.parameters``. Raises ``ConfigError`` where there is none; ``purpose``: what
    is not said then."""
    names = [resolve_name(rig, name) for name in values["fit.parameters"] or []]
    if not names:
        raise ConfigError(
            f"It is not said {purpose}.", "Set fit.parameters to a list of names, as 'thinshell params' prints them."
        )
    return names


def nuisance_of(values: Mapping[str, Any]) -> list[str]:
    """Kinds of nuisance parameters of ``fit.nuisance``, as they are written."""
    return [word.strip() for word in values["fit.nuisance"].split(",")]


def topic_names(rig: Rig) -> dict[str, str]:
    """Topics of a rig that a recording may have under other names: ``gripper.current_pose``, ``load_cell``, ..."""
    named = {name: effector.topics for name, effector in rig.end_effectors.items()}
    found = {f"{n}.{key}": getattr(t, key) for n, t in named.items() for key in ("target_pose", "current_pose")}
    found |= {name: sensor.topic for name, sensor in rig.sensors.items()}
    for name, camera in rig.cameras.items():
        found |= {f"{name}.{key}": topic for key, topic in camera.topics.model_dump().items()}
    return found


def with_topics(rig: Rig, topics: Mapping[str, str]) -> Rig:
    """The rig with its topics replaced by those of the same names (:func:`topic_names`)."""

    def changed(part: Any, name: str) -> Any:
        wanted = {key: topics[f"{name}.{key}"] for key in type(part.topics).model_fields if f"{name}.{key}" in topics}
        return part.model_copy(update={"topics": part.topics.model_copy(update=wanted)})

    sensors = {n: s.model_copy(update={"topic": topics.get(n, s.topic)}) for n, s in rig.sensors.items()}
    return rig.model_copy(
        update={
            "end_effectors": {name: changed(effector, name) for name, effector in rig.end_effectors.items()},
            "sensors": sensors,
            "cameras": {name: changed(camera, name) for name, camera in rig.cameras.items()},
        }
    )


def _check_topics(rig: Rig, bags: Sequence[Path], named: Mapping[str, str]) -> None:
    """Each recording has the topics that were named for it. Raises ``RecordingError``."""
    if not named:
        return
    for path in dict.fromkeys(part_of(bag).path for bag in bags):
        there = open_bag(path, Notes(), rig.table_columns).topics
        for name, topic in named.items():
            if not any(("/" + other.strip("/")).endswith("/" + topic.strip("~/")) for other in there):
                raise RecordingError(
                    f"topics.{name} is {topic!r}, and {path} has no such topic.",
                    f"It has {', '.join(there)}.",
                )


def _paths(value: Any, name: str) -> tuple[Path, ...]:
    """One path or several."""
    given = value if isinstance(value, list) else [value]
    if not all(isinstance(word, str) for word in given):
        raise ConfigError(f"The parameter {name} is {value!r}.", "Give a path or a list of paths.")
    return tuple(Path(word).expanduser() for word in given if word)


def numbers_of(value: Any, parameter: str) -> list[float]:
    """Numbers of a parameter's value, as ``ros2 param set`` makes it of what is typed: it takes ``4.0e9`` for a word,
    ``4`` for an integer, and ``[]`` for a list of something. Raises ``ConfigError`` for what is no list of numbers."""
    given = [] if value is None or value == "" else [value] if isinstance(value, str | int | float) else list(value)
    if not any(isinstance(number, bool | bytes) for number in given):
        try:
            return [float(number) for number in given]
        except ValueError:
            pass
    raise ConfigError(f"The parameter {parameter} is {given}.", "Give a list of numbers, [4.0e9], or none, [].")


def _numbers(value: Any, names: Sequence[str], parameter: str) -> list[float]:
    """One finite number for each name, or none at all."""
    numbers = numbers_of(value, parameter)
    if numbers and (len(numbers) != len(names) or not all(map(math.isfinite, numbers))):
        raise ConfigError(
            f"{parameter} is {numbers}, which is not one finite number for each of {', '.join(names)}.",
            "Give as many numbers as fit.parameters has names, in that order, or none.",
        )
    return numbers


def folder_of(text: str) -> Path:
    """A folder that results can be written into; made if it is not there."""
    if not text:
        raise ConfigError("There is no folder for the results.", "Set the parameter output_dir.")
    folder = Path(text).expanduser().absolute()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"The folder {folder} cannot be made: {error.strerror}.", "Set another output_dir.") from None
    if not os.access(folder, os.W_OK):
        raise ConfigError(f"The folder {folder} cannot be written.", "Set another output_dir.")
    return folder
