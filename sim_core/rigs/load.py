"""Find and read rig files, and overlays that change some values of another rig."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field

import sim_core
from sim_core.errors import ConfigError, nearest_match
from sim_core.rigs.fields import EffectKey, Name, Real, Strict, Text
from sim_core.rigs.parameters import list_parameters, resolve_name, with_parameters
from sim_core.rigs.schema import Rig
from sim_core.rigs.yamlfile import read_mapping, validate


class Overlay(Strict):
    """Changes to another rig: values of named parameters, and effects that are switched on."""

    overlay_of: Text
    name: Name | None = None
    description: Text | None = None
    parameters: dict[Text, Real] = Field(default={})
    effects: dict[EffectKey, dict[Text, Real]] = Field(default={})


def config_folder() -> Path:
    """Folder ``config`` of the source tree, or of the installed package."""
    package = Path(sim_core.__file__).resolve().parent
    candidates = [package.parent / "config"]
    candidates += [parent / "share" / "thinshell_ros" / "config" for parent in package.parents]
    for candidate in candidates:
        if (candidate / "rigs").is_dir():
            return candidate
    raise ConfigError(
        "The folder with the rigs that come with thinshell_ros is not found.",
        "Install the package again, or give the path of a rig file.",
    )


def names_in(kind: str) -> list[str]:
    """Names of the files of one kind (``rigs``, ``experiments``) that come with the package."""
    return sorted(path.stem for path in (config_folder() / kind).glob("*.yaml"))


def find_config(name_or_path: str | Path, kind: str, folder: Path | None = None) -> Path:
    """Path of a configuration file from a path, or from the name of one that comes with the package.

    ``folder``: folder in which a relative path is looked up too.
    """
    text = str(name_or_path)
    if not text.strip():
        raise ConfigError(f"The name of one of the {kind} is empty.", f"Known: {', '.join(names_in(kind))}.")
    given = Path(text).expanduser()
    if given.exists() or given.suffix in {".yaml", ".yml"} or len(given.parts) > 1:
        if folder is not None and not given.is_absolute() and (folder / given).is_file():
            return folder / given
        return given
    if folder is not None and (folder / f"{text}.yaml").is_file():
        return folder / f"{text}.yaml"
    known = names_in(kind)
    if text not in known:
        raise ConfigError(
            f"{text!r} is neither a file nor one of the {kind} that come with the package.",
            nearest_match(text, known) if known else "Give the path of a YAML file.",
        )
    return config_folder() / kind / f"{text}.yaml"


def load_rig(name_or_path: str | Path) -> Rig:
    """Load a rig by the name of one that comes with the package, or from a file."""
    return _load(find_config(name_or_path, "rigs"), ())


def parse_rig(data: Mapping[str, Any], source: str) -> Rig:
    """Check a mapping (for example one stored in a recording); ``source`` names it in errors."""
    rig = validate(Rig, data, source)
    _check_known(rig, source)
    return rig


def _check_known(rig: Rig, source: str) -> None:
    """Raise ``ConfigError`` where something is said to be known of what is no number of the rig, or twice."""
    found: dict[str, str] = {}
    values = {p.name: p.value for p in list_parameters(rig)} if rig.known else {}
    for name, known in rig.known.items():
        try:
            full = resolve_name(rig, name)
        except ConfigError as error:
            raise ConfigError(f"{source}: known: {error.problem}", error.remedy) from None
        if full in found:
            raise ConfigError(f"{source}: known: {found[full]} and {name} are the same.", "Keep one of the two.")
        found[full] = name
        value = values[full]
        if value is None or (known.sd is None and value == 0.0):
            raise ConfigError(
                f"{source}: known: {name} is {'not in the rig' if value is None else '0, of which no share is known'}.",
                "Write its value into the rig." if value is None else "Give sd instead of relative_sd.",
            )


def rig_to_yaml(rig: Rig) -> str:
    """A rig as text that loads again to an equal rig."""
    data = rig.model_dump(mode="json", exclude_none=True)
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True)


def _load(path: Path, chain: tuple[Path, ...]) -> Rig:
    data = read_mapping(path)
    if "motions" in data and "bodies" not in data:
        raise ConfigError(f"{path} is an experiment, and a rig is wanted.", "Rigs come before experiments.")
    if "overlay_of" not in data:
        return parse_rig(_with_files(data, path.parent), str(path))
    resolved = path.resolve()
    if resolved in chain:
        circle = " -> ".join(p.name for p in (*chain, resolved))
        raise ConfigError(f"{path}: overlay_of goes in a circle ({circle}).", "Name a rig that is no overlay.")
    overlay = validate(Overlay, data, str(path))
    base = _load(find_config(overlay.overlay_of, "rigs", folder=path.parent), (*chain, resolved))
    try:
        rig = with_parameters(base, overlay.parameters)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error.problem}", error.remedy) from None
    update: dict[str, Any] = {"effects": {**rig.effects, **overlay.effects}}
    if overlay.name is not None:
        update["name"] = overlay.name
    if overlay.description is not None:
        update["description"] = overlay.description
    return rig.model_copy(update=update)


def _with_urdf(hand: Any, folder: Path) -> Any:
    topics = hand.get("topics") if isinstance(hand, dict) else None
    joints = topics.get("joints") if isinstance(topics, dict) else None
    if not (isinstance(topics, dict) and isinstance(joints, dict) and isinstance(joints.get("urdf"), str)):
        return hand
    path = str((folder / Path(joints["urdf"]).expanduser()).resolve())
    return {**hand, "topics": {**topics, "joints": {**joints, "urdf": path}}}


def _with_files(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The same with the paths of mesh files and URDFs, which are relative to the folder of the rig, made absolute."""
    hands = data.get("end_effectors")
    if isinstance(hands, dict):
        data = {**data, "end_effectors": {name: _with_urdf(hand, folder) for name, hand in hands.items()}}
    bodies = data.get("bodies")
    if not isinstance(bodies, dict):
        return data
    found = {}
    for name, body in bodies.items():
        shape = body.get("shape") if isinstance(body, dict) else None
        if isinstance(shape, dict) and isinstance(shape.get("file"), str) and shape["file"]:
            shape = {**shape, "file": str((folder / Path(shape["file"]).expanduser()).resolve())}
            body = {**body, "shape": shape}
        found[name] = body
    return {**data, "bodies": found}
