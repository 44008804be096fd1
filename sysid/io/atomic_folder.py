"""Results that are there whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from sim_core.errors import ConfigError

UNFINISHED = ".unfinished"
"""Name of the folder for what is not finished in a folder that exists; elsewhere the end of its name."""

CHECKPOINTS = "checkpoints"
"""Name of the folder of stages (:mod:`sysid.io.checkpoints`) in the folder of results that are not finished."""

ROOM_BYTES = 1 << 22
"""Room that results and their reports need."""


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """A folder to write into that becomes ``out`` when the block ends without an error.

    The block is the whole job, so that a place that cannot be written is refused before it. Until the end the folder is
    :func:`unfinished`, which an error in the block removes and a killed process leaves behind. Where ``out`` exists,
    which may be on a file system of its own, the finished files go into it at the end, one right after the other.
    What cannot go there stays where it is, and the ``ConfigError`` says where. One job at a time writes into ``out``.
    """
    out = out.absolute()
    part = unfinished(out)
    missing = [folder for folder in part.parents if not folder.exists()]
    try:
        if os.path.lexists(out) and not out.is_dir():
            raise FileExistsError(0, "there is a file or a link to nothing of that name")
        if part.exists():
            shutil.rmtree(part)
        part.mkdir(parents=True)
        _try_room(part)
    except OSError as error:
        shutil.rmtree(part, ignore_errors=True)
        raise _refused(out, error) from None
    try:
        yield part
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        with suppress(OSError):
            for folder in missing:
                folder.rmdir()
        raise
    try:
        if part.parent == out:
            for file in sorted(part.iterdir()):
                os.replace(file, out / file.name)
            part.rmdir()
        else:
            os.replace(part, out)
    except OSError as error:
        raise _stranded(part, out, error) from error


def write_results(folder: Path, out: Path, files: Sequence[Callable[[Path], object]]) -> None:
    """Write the files of finished results into the folder of a :func:`whole_folder` that becomes ``out``.

    Where there is no room for them any more they are kept elsewhere, and the ``ConfigError`` says where."""
    try:
        for write in files:
            write(folder)
        return
    except OSError as error:
        fault = error
    for place in (tempfile.gettempdir(), str(Path.home()), "/dev/shm"):
        try:
            kept = Path(tempfile.mkdtemp(prefix="thinshell-results-", dir=place))
            for write in files:
                write(kept)
        except OSError:
            continue
        raise ConfigError(
            f"The results are finished but cannot be written to {out}: {fault.strerror}.", f"They are kept in {kept}."
        ) from fault
    raise ConfigError(
        f"The results are finished but cannot be written to {out}, nor anywhere else: {fault.strerror}.",
        "Make room, and run it again.",
    ) from fault


def _try_room(folder: Path) -> None:
    """Write as much as results may need, and take it away again. Raises ``OSError`` where it cannot be written.

    The file has no name, so that nothing is left of it when the process is killed.
    """
    block = b"\0" * (1 << 16)
    with tempfile.TemporaryFile(dir=folder) as file:
        for _ in range(ROOM_BYTES // len(block)):
            file.write(block)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A file to write that becomes ``path`` when the block ends without an error, as :func:`whole_folder`."""
    path = path.absolute()
    part = path.with_name(f".{path.name}{UNFINISHED}")
    try:
        part.write_text("")
    except OSError as error:
        raise _refused(path, error) from None
    try:
        yield part
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    try:
        os.replace(part, path)
    except OSError as error:
        raise _stranded(part, path, error) from error


def unfinished(out: Path) -> Path:
    """Where the results that will be in ``out`` are until all are written: in it if it exists, else next to it."""
    out = out.absolute()
    return out / UNFINISHED if out.is_dir() else out.with_name(f".{out.name}{UNFINISHED}")


def _refused(out: Path, error: OSError) -> ConfigError:
    return ConfigError(f"{out} cannot be written: {error.strerror}.", "Name another place for the results.")


def _stranded(part: Path, out: Path, error: OSError) -> ConfigError:
    return ConfigError(
        f"The results are finished but cannot be moved to {out}: {error.strerror}.",
        f"What is not there is in {part}: move it from there before the same is written again, which removes it.",
    )
