"""Compile the core: one shared library with a plain C interface, the same for all versions of Python.

It is compiled when the package is built (setup.py), or at first use into the user's cache, and kept under a name that
has the hash of its sources and flags: an old one is never taken for a new one.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

from sim_core.core.lowering import header

HERE = Path(__file__).resolve().parent

BUILT = HERE / "built"
"""Where libraries are that were compiled with the package."""

LAWS_OF_EFFECTS = "laws"
"""Folder in it, and in the cache, of the libraries of effects' laws, one a law."""

FLAGS = ("-std=c++17", "-O3", "-fPIC", "-shared", "-fopenmp-simd")
"""Of every compiler that is known here. Sums are not reordered but where the source says so (``omp simd``), so a
library gives the same bits in every run."""

LAWS = (
    "sim_core.contact.continuous_collision",
    "sim_core.contact.edge_kernels",
    "sim_core.contact.pressure_and_friction",
    "sim_core.contact.shapes",
    "sim_core.contact.surface_geometry",
    "sim_core.contact.surface_kernels",
    "sim_core.energies.air_drag",
    "sim_core.energies.pressure",
    "sim_core.energies.dihedral",
    "sim_core.energies.membrane",
    "sim_core.energies.neo_hookean_kernels",
)
"""Modules of the laws that the core uses, which are lowered with all that they call."""

COMPILERS = ("c++", "g++", "clang++")


def compiler() -> str | None:
    """Path of the C++ compiler: that of the environment variable ``CXX``, or the first that is installed."""
    names = (os.environ["CXX"],) if os.environ.get("CXX") else COMPILERS
    return next((found for name in names if (found := shutil.which(name))), None)


def target() -> tuple[str, ...]:
    """Flags for what this processor has: AVX2 and FMA where it does, else what all of its kind have."""
    if platform.machine() not in ("x86_64", "AMD64"):
        return ()
    try:
        flags = Path("/proc/cpuinfo").read_text(encoding="utf-8").partition("flags")[2].partition("\n")[0].split()
    except OSError:
        return ()
    return ("-march=x86-64-v3",) if {"avx2", "fma", "bmi2"} <= set(flags) else ()


def sources() -> list[Path]:
    """What is compiled in addition to the laws, which are lowered from Python (:mod:`sim_core.core.lowering`)."""
    return [HERE / "core.cpp", *sorted((HERE / "include").glob("*.hpp"))]


def library_name(laws: str) -> str:
    """File name of the library for these sources, the lowered ``laws`` and this processor."""
    texts = [path.name + path.read_text(encoding="utf-8") for path in sources()]
    return f"thinshell_core_{digest_of(laws, *texts)}.so"


def digest_of(*texts: str) -> str:
    """Hash of what is compiled, and of how."""
    return hashlib.sha256("\0".join([*FLAGS, *target(), *texts]).encode()).hexdigest()[:16]


def cache_folder() -> Path:
    """Where libraries that are compiled at first use are kept."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "thinshell_ros"


def find_or_build(folders: tuple[Path, ...]) -> Path:
    """The library, from the first of the folders that has it, else compiled into the last one. Raises ``OSError`` with
    a sentence that says why there is none."""
    laws = header(LAWS)
    name = library_name(laws)
    for folder in folders:
        if (folder / name).exists():
            return folder / name
    return build(folders[-1] / name, laws)


on_compiling: list[Callable[[str], None]] = []
"""Called with a sentence before something is compiled, which takes seconds and happens once on a machine."""


def build(path: Path, laws: str, main: str = '#include "core.cpp"\n') -> Path:
    """Compile ``main``, which may include ``laws.hpp``, to the library ``path``. Raises ``OSError`` where there is no
    compiler, or where it fails."""
    command = compiler()
    if command is None:
        raise OSError("no C++ compiler was found: install g++ or clang++, or set CXX")
    for say in on_compiling:
        say(f"{path.stem.rpartition('_')[0] or path.stem} is compiled, which happens once on a machine")
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as scratch:
        (Path(scratch) / "laws.hpp").write_text(laws, encoding="utf-8")
        (Path(scratch) / "main.cpp").write_text(main, encoding="utf-8")
        made = Path(scratch) / path.name
        folders = [f"-I{scratch}", f"-I{HERE}", f"-I{HERE / 'include'}"]
        command_line = [command, *FLAGS, *target(), *folders, f"{scratch}/main.cpp", "-o", str(made)]
        done = subprocess.run(command_line, capture_output=True, text=True)
        if done.returncode:
            first = next((line for line in done.stderr.splitlines() if "error" in line), "no message")
            raise OSError(f"{command} could not compile {path.name}: {first}")
        os.replace(made, path)  # at once, so that no other process takes a half of it
    return path
