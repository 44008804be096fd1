"""Rollouts on a device: one thread block each on a GPU, or, to test the same source, one after the other on a CPU.

The source (``rollouts.cpp``, ``include/``) is compiled at its first use with the headers and the laws of the compiled
core: through NVRTC by CuPy, which keeps what it has compiled, or by the C++ compiler.
"""

from __future__ import annotations

import ctypes
import functools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.core.build import HERE as CORE
from sim_core.core.build import LAWS, build, cache_folder, digest_of
from sim_core.core.lowering import header
from sim_core.core.record_layout import (
    ARRAYS,
    BLOCKS,
    COUNTS,
    MODULATED,
    SEARCH,
    SIZES,
    SLOPES,
    RecordStruct,
)
from sim_core.errors import ConfigError
from sim_core.gpu import plan
from sim_core.gpu.problem import OWN, Problem

HERE = Path(__file__).resolve().parent

THREADS = 256
"""Of a block."""
STAGES = 4
"""Steps of a solve that are fetched at once (include/team.hpp)."""
ARENA_SLOTS = 96
"""Vectors that the searches of a rollout may keep at once; two tangents with all their corrections, and what is
between."""
SHARED_BYTES = 232_448 - 4_096
"""Memory that the threads of a block share on a GPU of compute capability 9.0, less what is laid out statically."""
SETTLED_AFTER_S, FOREVER_S = 3.0, 1e9
"""As of :mod:`sim_core.simulation`."""


class PlanStruct(ctypes.Structure):
    """``Plan`` of include/plan.hpp."""

    _fields_ = [(n, ctypes.c_int64) for n in plan.SIZES] + [(n, ctypes.c_void_p) for n, _ in plan.ARRAYS]


class LaunchStruct(ctypes.Structure):
    """``Launch`` of rollouts.cpp."""

    _fields_ = [
        ("record", RecordStruct),
        ("plan", PlanStruct),
        *((n, ctypes.c_int64) for n in ("rollouts", "first", "steps", "inertia", "settle", "places_stride", "frames",
                                         "every")),
        *((f"{n}_stride", ctypes.c_int64) for n in OWN),
        ("settled_after", ctypes.c_double),
        ("forever", ctypes.c_double),
        *((n, ctypes.c_void_p) for n in ("dt", "places", "state")),
        ("state_size", ctypes.c_int64),
        *((n, ctypes.c_void_p) for n in ("status", "failed", "begun", "counts", "x", "force", "moment", "room")),
        *((n, ctypes.c_int64) for n in ("room_size", "arena_slots", "window_size", "window_shared", "panel_size",
                                         "area_size")),
    ]  # fmt: skip


@dataclass
class Outcome:
    """What rollouts came to.

    ``made``: steps, -1 where a rollout found no rest at its start ``(n,)``; ``failed``: whether a step was not found
    ``(n,)``; ``counts``: of the steps (:data:`sim_core.core.record_layout.COUNTS`) ``(n, steps)``; ``last``: positions
    at the end [m] ``(n, nodes, 3)``; ``x`` [m], ``force`` [N] ``(n, frames, nodes, 3)`` and ``moment`` [N m]
    ``(n, frames, contacts, 3)``: at the ends of the steps that were asked for, None where none were."""

    made: np.ndarray
    failed: np.ndarray
    counts: np.ndarray
    last: np.ndarray
    x: np.ndarray | None = None
    force: np.ndarray | None = None
    moment: np.ndarray | None = None


class Device:
    """Where arrays are and the source runs."""

    blocks_at_once = 1
    shared_bytes = SHARED_BYTES

    def array(self, values: Any, kind: Any) -> Any:
        """An array in the memory of the device."""
        raise NotImplementedError

    def empty(self, size: int) -> Any:
        """Room for numbers."""
        raise NotImplementedError

    def address(self, array: Any) -> int:
        """Of an array."""
        raise NotImplementedError

    def fetch(self, array: Any) -> np.ndarray:
        """An array in the memory of the host."""
        raise NotImplementedError

    def launch(self, given: LaunchStruct, shared_bytes: int) -> float:
        """Run, and wait for the end; how long it took [s], 0 where that is not measured."""
        raise NotImplementedError

    def resident(self, shared_bytes: int) -> int:
        """Thread blocks that run at once."""
        del shared_bytes
        return 1


class Host(Device):
    """This machine's CPU. Raises ``OSError`` where there is no C++ compiler."""

    def __init__(self) -> None:
        self._library = ctypes.CDLL(str(_host_library()))
        function = self._library.thinshell_gpu_sizes
        function.restype, function.argtypes = ctypes.c_int64, [ctypes.c_int64]
        if (function(0), function(1)) != (ctypes.sizeof(LaunchStruct), COUNTS.itemsize):
            raise RuntimeError("the structures of sim_core/gpu/engine.py and rollouts.cpp differ")

    def array(self, values: Any, kind: Any) -> Any:
        return np.array(values, dtype=kind, order="C")

    def empty(self, size: int) -> Any:
        return np.full(size, np.nan)

    def address(self, array: Any) -> int:
        return int(array.ctypes.data)

    def fetch(self, array: Any) -> np.ndarray:
        return np.asarray(array)

    def launch(self, given: LaunchStruct, shared_bytes: int) -> float:
        del shared_bytes
        self._library.thinshell_rollouts(ctypes.byref(given))
        return 0.0


class Gpu(Device):
    """A GPU, through CuPy. Raises ``ConfigError`` where there is none."""

    def __init__(self, blocks_a_processor: int = 2) -> None:
        self._cupy = _cupy()
        self.blocks_a_processor = blocks_a_processor
        options = ("-std=c++17", "-default-device", f"-DTHINSHELL_THREADS={THREADS}",
                   f"-DTHINSHELL_BLOCKS={blocks_a_processor}")  # fmt: skip
        module = self._cupy.RawModule(code=device_source(), options=options)
        self._kernel = module.get_function("thinshell_rollouts")
        properties = self._cupy.cuda.runtime.getDeviceProperties(0)
        self.name = properties["name"].decode()
        self.processors = int(properties["multiProcessorCount"])
        self.shared_bytes = int(properties["sharedMemPerBlockOptin"]) - self._kernel.shared_size_bytes

    def array(self, values: Any, kind: Any) -> Any:
        return self._cupy.asarray(np.ascontiguousarray(values, dtype=kind))

    def empty(self, size: int) -> Any:
        return self._cupy.full(size, np.nan)

    def address(self, array: Any) -> int:
        return int(array.data.ptr)

    def fetch(self, array: Any) -> np.ndarray:
        found: np.ndarray = self._cupy.asnumpy(array)
        return found

    def resident(self, shared_bytes: int) -> int:
        held: int = self.shared_bytes // (shared_bytes + self._kernel.shared_size_bytes + 1024)
        return self.processors * max(1, min(self.blocks_a_processor, held))

    def launch(self, given: LaunchStruct, shared_bytes: int) -> float:
        blocks = min(self.resident(shared_bytes), given.rollouts)
        self._kernel.max_dynamic_shared_size_bytes = shared_bytes
        at = self.array(np.frombuffer(bytes(given), dtype=np.uint8), np.uint8)
        begin, end = self._cupy.cuda.Event(), self._cupy.cuda.Event()
        begin.record()
        self._kernel((blocks,), (THREADS,), (at.data.ptr,), shared_mem=shared_bytes)
        end.record()
        end.synchronize()
        return float(self._cupy.cuda.get_elapsed_time(begin, end)) * 1e-3


@functools.cache
def _host_library() -> Path:
    """The source compiled for this machine, from the user's cache or made now."""
    laws = header(LAWS)
    folders = (HERE, HERE / "include", CORE / "include")
    texts = [p.read_text() for folder in folders for p in sorted(folder.glob("*.[ch]pp"))]
    path = cache_folder() / f"thinshell_gpu_on_host_{digest_of(laws, *texts)}.so"
    return path if path.exists() else build(path, laws, f'#include "{HERE / "rollouts.cpp"}"\n')


def device_source() -> str:
    """The whole source as one text, for NVRTC."""
    return _included((HERE / "rollouts.cpp").read_text(), set())


def _included(text: str, seen: set[str]) -> str:
    def take(match: re.Match[str]) -> str:
        name = match[1].rpartition("/")[2]
        if name in seen:
            return ""
        seen.add(name)
        if name == "laws.hpp":
            return _included(header(LAWS), seen)
        folder = next(f for f in (HERE / "include", CORE / "include") if (f / name).exists())
        return _included((folder / name).read_text(), seen)

    return re.sub(r'^#include "([^"]+)"$', take, text.replace("#pragma once\n", ""), flags=re.MULTILINE)


@functools.cache
def _cupy() -> Any:
    """CuPy with a GPU. Raises ``ConfigError`` where there is none."""
    remedy = "Install the extra with pip install 'thinshell_ros[gpu]' on a machine with an NVIDIA GPU and its driver."
    try:
        import cupy
    except ImportError as error:
        raise ConfigError("Rollouts on a GPU need CuPy, which is not installed.", remedy) from error
    try:
        count = cupy.cuda.runtime.getDeviceCount()
    except cupy.cuda.runtime.CUDARuntimeError:
        count = 0
    if not count:
        raise ConfigError("Rollouts on a GPU need an NVIDIA GPU, and this machine has none that responds.", remedy)
    return cupy


class Run:
    """Rollouts of a problem on a device, whose states stay there between calls of :meth:`steps`."""

    def __init__(self, problem: Problem, device: Device) -> None:
        self._problem, self._device, self._kept = problem, device, []  # type: ignore[var-annotated]
        record, layout = problem.record, problem.plan
        given = self._given = LaunchStruct()
        for name in (*SIZES, *(n for n, _ in SEARCH), *BLOCKS, "modulations"):
            setattr(given.record, name, record[name])
        for name, kind in (*ARRAYS, *SLOPES, *MODULATED):
            setattr(given.record, name, self._address(problem.own.get(name, record[name]), kind))
        for name in plan.SIZES:
            setattr(given.plan, name, layout[name])
        for name, kind in plan.ARRAYS:
            setattr(given.plan, name, self._address(layout[name], kind))
        for name in OWN:
            own = problem.own.get(name)
            setattr(given, f"{name}_stride", 0 if own is None else own[0].size)
        given.rollouts, given.inertia = problem.rollouts, problem.inertia
        given.frames = problem.places.shape[1]
        given.places_stride = problem.places[0].size if len(problem.places) > 1 else 0
        given.settled_after, given.forever = SETTLED_AFTER_S, FOREVER_S
        given.dt = self._address(np.diff(problem.times), np.float64)
        given.places = self._address(problem.places, np.float64)
        self._states()
        self._rooms()
        self._rests = False
        self.device_s = 0.0
        """Time that the device took so far [s]; 0 on a CPU."""

    def _address(self, values: Any, kind: Any) -> int:
        array = self._device.array(values, kind)
        self._kept.append(array)
        return self._device.address(array)

    def _states(self) -> None:
        problem, record = self._problem, self._problem.record
        whole = 3 * record["nodes"]
        size = 4 * whole + 5 * record["samples"] + 9 * record["contacts"] + 1
        state = np.zeros((problem.rollouts, size))
        state[:, :whole] = np.broadcast_to(problem.start, (problem.rollouts, *problem.start.shape[1:])).reshape(
            -1, whole
        )
        self._state = self._device.array(state, np.float64)
        self._status = self._device.array(np.zeros(problem.rollouts), np.int32)
        self._failed = self._device.array(np.zeros(problem.rollouts), np.int32)
        given = self._given
        given.state, given.state_size = self._device.address(self._state), size
        given.status, given.failed = self._device.address(self._status), self._device.address(self._failed)

    def _rooms(self) -> None:
        record, layout, given = self._problem.record, self._problem.plan, self._given
        whole, hinges = 3 * record["nodes"], record["hinges"]
        given.arena_slots, given.panel_size = ARENA_SLOTS, 64 * (layout["reach"] + 2) + 2 + 2 * layout["tiles"]
        given.window_size = 32 * (layout["reach"] + 1) * (layout["reach"] + 2)
        given.area_size = 16 * layout["tiles"] + 64 * STAGES * (layout["reach"] - 1)
        shared = 8 * (given.panel_size + max(given.window_size, given.area_size))
        given.window_shared = shared <= self._device.shared_bytes
        self._shared = shared if given.window_shared else 8 * (given.panel_size + given.area_size)
        if self._shared > self._device.shared_bytes:
            rows = plan.TILE * layout["reach"]
            raise ConfigError(
                f"The factor's rows reach over {rows} of {layout['unknowns']} unknowns, for which a thread block needs "
                f"{self._shared} bytes of shared memory, and it has {self._device.shared_bytes}.",
                "Use fewer cells across the sheet, or simulate it on the CPU.",
            )
        room = whole * ARENA_SLOTS + 24 * record["samples"] + 44 * record["contacts"] + 66 * record["triangles"]
        room += 123 * hinges + 3 * layout["row_nodes"] + 9 * layout["blocks"] + 2
        room += 12 * record["mounts"] + 9 * record["contacts"] + 64 * layout["panel_tiles"] + given.window_size
        given.room_size = 32 * -(-room // 32)
        blocks = min(self._device.resident(self._shared), given.rollouts)
        self._room = self._device.empty(blocks * given.room_size)
        given.room = self._device.address(self._room)

    @property
    def window_is_shared(self) -> bool:
        """Whether the factor's window is in memory that the threads of a block share."""
        return bool(self._given.window_shared)

    def steps(self, first: int, count: int, every: int | None = None) -> Outcome:
        """Make steps; come to rest before all others. ``every``: keep positions, forces and moments at rest, if that is
        found now, and at the end of every so many steps. Fewer than a whole number of times ``every`` are not kept."""
        problem, given, device = self._problem, self._given, self._device
        given.first, given.steps, given.settle = first, count, not self._rests
        given.every = every or 1
        counts = device.array(np.zeros((problem.rollouts, count), dtype=COUNTS).view(np.uint8), np.uint8)
        begun = device.array([0], np.int32)
        given.counts, given.begun = device.address(counts), device.address(begun)
        frames, nodes, contacts = (
            count // given.every + (not self._rests),
            problem.record["nodes"],
            problem.record["contacts"],
        )
        shapes = [(problem.rollouts, frames, n, 3) for n in (nodes, nodes, contacts)]
        kept = [device.empty(int(np.prod(s))) for s in shapes] if every else []
        given.x, given.force, given.moment = (device.address(a) for a in kept) if every else (0, 0, 0)
        self.device_s += device.launch(given, self._shared)
        self._rests = True
        whole = 3 * nodes
        last = device.fetch(self._state).reshape(problem.rollouts, -1)[:, :whole].reshape(-1, nodes, 3)
        found = [device.fetch(a).reshape(s) for a, s in zip(kept, shapes, strict=True)] if every else [None] * 3
        return Outcome(
            device.fetch(self._status).copy(),
            device.fetch(self._failed).astype(bool),
            device.fetch(counts).view(COUNTS).reshape(problem.rollouts, count),
            last.copy(),
            *found,
        )
