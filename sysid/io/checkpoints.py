"""What a long command has found until now, stage by stage, in a folder: started again, it goes on from there.

A stage is a function of what it is given, which its file is named by, so that a second start may ask for stages in any
order and finds those that it asks for. What all stages are given is checked once: rig, recordings, settings and program
by their digests. Files are written whole or not at all, so that a killed process leaves those of finished stages.

Stages are pickled (``joblib.Memory`` does alike, but can neither leave out engines and threads nor tell why it begins
anew). A pickle runs code when it is read: nobody should go on from a folder that somebody else has written.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import pickle
import re
import shutil
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from pydantic import BaseModel

from sim_core.effects import Effect, effect_by_name
from sim_core.errors import ConfigError
from sysid.io.atomic_folder import CHECKPOINTS

INPUTS = "inputs.json"
"""Name of the file that says by digests what the stages were given."""

T = TypeVar("T")


@runtime_checkable
class Identified(Protocol):
    """A value that is known by a few numbers. ``identity``: these."""

    @property
    def identity(self) -> object: ...


class Checkpoints:
    """Stages in a ``folder``, None: nothing is kept.

    ``on_full``: is called once, with a sentence, where a stage cannot be written; the command goes on without.
    """

    def __init__(self, folder: Path | None = None, on_full: Callable[[str], None] | None = None) -> None:
        self._folder, self._on_full = folder, on_full
        self._live: dict[str, object] = {}
        self._lock = threading.Lock()

    def live(self, name: str, value: object) -> None:
        """Stages refer to a ``value``, as an engine, by a ``name``: it is of this process, and never written."""
        self._live[name] = value

    def stage(self, name: str, make: Callable[[], T], *given: object) -> T:
        """What a stage has come to: what is kept of the same ``name`` and the same ``given``, else what ``make``
        returns, which is kept from then on. From any thread."""
        if self._folder is None:
            return make()
        words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")[:60]
        path = self._folder / f"{words}-{digest_of(name, *given)}.stage"
        if path.exists():
            try:
                with path.open("rb") as file:
                    found: T = _Unpickler(file, self._live).load()
                return found
            except Exception:  # damaged, as where the disk was full or failed: it is made again
                path.unlink(missing_ok=True)
        found = make()
        self._keep(path, found)
        return found

    def _keep(self, path: Path, value: object) -> None:
        part = path.with_suffix(f".{threading.get_ident()}.part")
        try:
            held = io.BytesIO()
            _Pickler(held, self._live).dump(value)
            part.write_bytes(held.getbuffer())
            os.replace(part, path)
        except OSError as error:
            with suppress(OSError):
                part.unlink(missing_ok=True)
            with self._lock:
                tell, self._on_full = self._on_full, None
            if tell is not None:
                tell(
                    f"{path.parent} cannot be written: {error.strerror}. What is found from now on is lost where the "
                    "command is interrupted."
                )


@contextmanager
def checkpoints(
    out: Path, inputs: Mapping[str, object], on_note: Callable[[str], None] | None = None
) -> Iterator[Checkpoints]:
    """Stages of the results that are to be in ``out``, below it: those of an earlier start where it was given the same
    ``inputs`` (a value by what it is, in words), else none, which ``on_note`` hears. They are removed when the block
    ends, and stay where it is interrupted or fails after a stage.

    Raises ``ConfigError`` where the folder cannot be written.
    """
    folder = out / CHECKPOINTS
    now = {name: digest_of(value) for name, value in inputs.items()}
    missing = [place for place in (out, *out.parents) if not place.exists()]
    note = on_note or (lambda _: None)
    before = _inputs_of(folder)
    kept = len(list(folder.glob("*.stage")))
    try:
        if before is not None and before != now:
            changed = [name for name in now if before.get(name) != now[name]]
            note(f"{out} holds what was found with {_listed(changed)} of other contents. It begins anew.")
            shutil.rmtree(folder)
        elif kept:
            note(f"It goes on from {kept} {'stage' if kept == 1 else 'stages'} that {folder} holds.")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / INPUTS).write_text(json.dumps(now, indent=2) + "\n")
    except OSError as error:
        raise ConfigError(
            f"{out} cannot be written: {error.strerror}.", "Name another place for the results."
        ) from None
    try:
        yield Checkpoints(folder, note)
    except BaseException:
        if not list(folder.glob("*.stage")):
            shutil.rmtree(folder, ignore_errors=True)
            with suppress(OSError):
                for place in missing:
                    place.rmdir()
        raise
    shutil.rmtree(folder, ignore_errors=True)


def digest_of(*values: object) -> str:
    """Digest of plain values, arrays, data classes, rigs and effects, the same in each process. Raises ``TypeError``
    for others."""
    found = hashlib.sha256()
    _feed(found.update, values)
    return found.hexdigest()[:24]


def program_digest() -> str:
    """Digest of the program's own source: a stage that another version has made may be of other classes."""
    found = hashlib.sha256()
    for package in ("sim_core", "sysid"):
        root = Path(__file__).resolve().parents[2] / package
        for path in sorted((*root.rglob("*.py"), *root.rglob("*.hpp"), *root.rglob("*.cpp"))):
            found.update(f"{path.relative_to(root)}\0".encode())
            found.update(path.read_bytes())
    return found.hexdigest()[:24]


def _inputs_of(folder: Path) -> dict[str, str] | None:
    """Digests that stages in a folder were given; None where there are none, empty where nobody can read them."""
    if not folder.exists():
        return None
    try:
        read = json.loads((folder / INPUTS).read_text())
        return read if isinstance(read, dict) else {}
    except (OSError, ValueError):
        return {}


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _feed(update: Callable[[bytes], Any], value: object) -> None:
    kind = type(value).__name__
    if value is None or isinstance(value, (bool, int, float, str, bytes, Path, np.generic)):
        update(f"{kind} {value!r}\0".encode())
    elif isinstance(value, np.ndarray) and value.dtype != object:
        update(f"array {value.dtype.str} {value.shape}\0".encode())
        update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Effect):
        update(f"effect {value.name}\0".encode())
    elif isinstance(value, BaseModel):
        update(f"{kind} {value.model_dump_json()}\0".encode())
    elif isinstance(value, Identified):
        update(f"{kind}\0".encode())
        _feed(update, value.identity)
    elif is_dataclass(value) and not isinstance(value, type):
        update(f"{kind}\0".encode())
        for one in fields(value):
            _feed(update, getattr(value, one.name))
    elif isinstance(value, Mapping):
        update(f"mapping {len(value)}\0".encode())
        for key in sorted(value, key=repr):
            _feed(update, key)
            _feed(update, value[key])
    elif isinstance(value, Set):
        _feed(update, sorted(value, key=repr))
    elif isinstance(value, Sequence):
        update(f"sequence {len(value)}\0".encode())
        for one in value:
            _feed(update, one)
    else:
        raise TypeError(f"A {kind} has no digest.")


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, live: Mapping[str, object]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._names = {id(value): name for name, value in live.items()}

    def persistent_id(self, value: object) -> tuple[str, str] | None:
        """Effects of the library and what lives in this process are written by their names."""
        if isinstance(value, Effect):
            return "effect", value.name
        name = self._names.get(id(value))
        return None if name is None else ("live", name)


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BufferedReader, live: Mapping[str, object]) -> None:
        super().__init__(file)
        self._live = live

    def persistent_load(self, found: tuple[str, str]) -> object:
        """As :meth:`_Pickler.persistent_id` has written it."""
        kind, name = found
        return effect_by_name(name) if kind == "effect" else self._live[name]
