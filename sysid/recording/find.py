"""Which files a recording is made of: by what is in them, whatever case, ending and compression their names have.

Hidden files (``._x.mcap`` and ``.DS_Store`` of macOS, what a recorder or a copy has not finished) belong to none.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath, PureWindowsPath
from typing import Any

import yaml

from sim_core.errors import RecordingError, nearest_match
from sysid.recording.formats import SUFFIXES, TABLE, WHAT, Content, content_of, plain_name, refuse
from sysid.recording.notes import Notes, plural

METADATA = "metadata.yaml"

LISTED = 4
"""Files that a message lists."""


def is_recording(path: Path) -> bool:
    """Whether what a user names is to be read as a recording: a folder, or any file but one of YAML."""
    return path.is_dir() or (path.exists() and path.suffix.lower() not in (".yaml", ".yml")) or path.name == METADATA


def files_of(path: Path, notes: Notes) -> tuple[list[Path], Mapping[str, Any]]:
    """The storage files or tables of a recording in their order, and what its metadata says, empty without any.

    Raises:
        RecordingError: there are none; what is there instead is named.
    """
    if not path.exists():
        siblings = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
        hint = nearest_match(path.name, siblings) if siblings else f"{path.parent} does not exist either."
        raise RecordingError(f"Recording {path} does not exist.", hint)
    if path.is_file():
        if path.name.lower() == METADATA:
            return files_of(path.parent, notes)
        content = content_of(path)
        if content.words:
            raise refuse(path, content)
        return [path], {}
    if not path.is_dir():
        raise RecordingError(
            f"{path} is neither a file nor a folder (a device, a pipe or a socket).",
            f"Give {WHAT}.",
        )
    here = _visible(path)
    contents = {p: content_of(p) for p in here if p.name.lower() != METADATA}
    storage = _without_twins([p for p, c in contents.items() if c.kind not in ("", TABLE)], notes)
    metadata = _metadata(next((p for p in here if p.name.lower() == METADATA), path / METADATA), notes)
    if metadata:
        return _listed(path, storage, metadata, notes), metadata
    tables = [p for p, c in contents.items() if c.kind == TABLE and Path(plain_name(p.name)).suffix.lower() in SUFFIXES]
    if not storage and tables:
        return _without_twins(tables, notes), {}
    if not storage:
        raise _nothing(path, contents)
    kinds = {contents[p].kind: p.name for p in storage}
    if len(kinds) > 1:
        raise RecordingError(
            f"{path} holds recordings of {len(kinds)} kinds: {', '.join(f'{n} ({k})' for k, n in kinds.items())}.",
            "Give one of them, or a folder that holds one recording.",
        )
    say = notes.warning if len(storage) > 1 else notes.info
    say(METADATA, f"missing or unusable; {plural(len(storage), 'storage file')} read in the order of names")
    return storage, {}


def _visible(folder: Path) -> list[Path]:
    """The files of a folder that are not hidden, in the order of their names."""
    return sorted((p for p in folder.iterdir() if p.is_file() and not p.name.startswith((".", "~"))), key=_natural)


def _without_twins(files: Sequence[Path], notes: Notes) -> list[Path]:
    """Of a file that is there plain and packed, the plain one."""
    names = {p.name.lower() for p in files}
    kept = []
    for p in files:
        plain = plain_name(p.name)
        if plain != p.name and plain.lower() in names:
            notes.info(p.name, f"not read: {plain} is there unpacked")
        else:
            kept.append(p)
    return kept


def _listed(path: Path, storage: Sequence[Path], metadata: Mapping[str, Any], notes: Notes) -> list[Path]:
    """The files that the metadata lists, whatever case or compression their names have now; where none of them is
    there, those that are."""
    by_name: dict[str, Path] = {plain_name(p.name).lower(): p for p in storage}
    by_name |= {p.name.lower(): p for p in storage}
    names = [_base(str(name)) for name in metadata["relative_file_paths"]]
    found: list[Path] = []
    missing: list[str] = []
    for name in names:
        plain = path / name
        file = plain if plain.is_file() else by_name.get(name.lower()) or by_name.get(plain_name(name).lower())
        if file is None:
            missing.append(name)
        elif file not in found:
            found.append(file)
    unlisted = [p for p in storage if p not in found]
    if names and not found:
        if not unlisted:
            raise RecordingError(
                f"{path / METADATA} lists {_few(missing)}, of which none exists.",
                "Copy the storage files into the folder of metadata.yaml.",
            )
        notes.warning(
            METADATA, f"lists {_few(missing)}, of which none exists; {_few([p.name for p in unlisted])} read instead"
        )
        return unlisted
    if not names:
        if not unlisted:
            raise _nothing(path, {})
        notes.warning(METADATA, f"lists nothing; {plural(len(unlisted), 'storage file')} read in the order of names")
        return unlisted
    if missing:
        notes.warning(METADATA, f"{plural(len(missing), 'split')} of {len(names)} missing: {_few(missing)}")
    if unlisted:
        notes.warning(METADATA, f"files that it does not list are not read: {_few([p.name for p in unlisted])}")
    return found


def _base(name: str) -> str:
    """The last part of a path, of one of Windows too."""
    return PureWindowsPath(PurePath(name).name).name


def _few(names: Sequence[str]) -> str:
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more


def _nothing(path: Path, contents: Mapping[Path, Content]) -> RecordingError:
    """What is said of a folder without a recording: of what is in it, or below it."""
    if info := lerobot_info(path):
        return RecordingError(
            f"{path} is a LeRobot dataset ({info['codebase_version']}), not a recording.",
            f"Write its episodes as tables, which are: thinshell lerobot import {path} --out FOLDER.",
        )
    inner = sorted(p.name for p in path.iterdir() if p.is_dir() and not p.name.startswith(".") and _holds_storage(p))
    if inner:
        one = len(inner) == 1
        return RecordingError(
            f"{path} is a folder of {plural(len(inner), 'recording')}, not a recording.",
            f"Give {path / inner[0]}." if one else f"Give one of: {_few(inner)}.",
        )
    foreign = [
        (p, c) for p, c in contents.items() if c.words and not c.words.startswith(("a text", "a mesh", "a film"))
    ]
    if foreign:
        return refuse(*foreign[0])
    listing = f"a {METADATA} that lists nothing" if (path / METADATA).exists() else f"no {METADATA}"
    return RecordingError(
        f"{path} is not a recording: it holds {listing} and no .mcap, .db3, .bag or .csv file.",
        f"Give {WHAT}.",
    )


def _holds_storage(folder: Path) -> bool:
    try:
        return any(content_of(p).kind not in ("", TABLE) for p in _visible(folder))
    except OSError:
        return False


def lerobot_info(path: Path) -> dict[str, Any] | None:
    """What ``meta/info.json`` says of a LeRobot dataset, None for any other folder."""
    try:
        info = json.loads((path / "meta" / "info.json").read_text(encoding="utf-8"))
        return dict(info) if isinstance(info["codebase_version"], str) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _metadata(path: Path, notes: Notes) -> Mapping[str, Any]:
    """Return the bag's metadata, empty when there is none that can be used."""
    if not path.exists():
        return {}
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8-sig"))
        information = content["rosbag2_bagfile_information"]
        if not isinstance(information["relative_file_paths"], list):
            raise TypeError("relative_file_paths is no list")
        counts = information.get("topics_with_message_count")
        if not isinstance(counts, list | None):
            raise TypeError("topics_with_message_count is no list")
    except (yaml.YAMLError, ValueError, KeyError, TypeError, RecursionError) as error:
        notes.warning(METADATA, f"cannot be used: {' '.join(str(error).split())}")
        return {}
    return dict(information)


def _natural(path: Path) -> tuple[tuple[int, str], ...]:
    """Sort key that puts part_2 before part_10."""
    words: list[str] = [""]
    for char in path.name:
        if char.isdigit() == words[-1][-1:].isdigit():
            words[-1] += char
        else:
            words.append(char)
    return tuple((int(word), "") if word.isdigit() else (-1, word) for word in words)
