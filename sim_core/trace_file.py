"""Traces as files: one ``.npz`` with arrays in SI units that numpy reads anywhere.

    version                     1
    times                       (n,) [s]
    kinds, ids/<channel>        names 'channel=kind'; marker numbers
    outputs/<channel>           readings (n, ...): wrench (6) [N, N m], markers (m, 3) [m], tracks (m, 2) [px]
    states/positions            (n, N, 3) [m]        states/pressures      (n, N) [Pa]
    states/slip_speeds          (n, N) [m/s]         states/forces/<pair>  (n, N, 3) [N]
    states/origins/<mount>      (n, 3) [m]           states/quaternions/<mount>  (n, 4), x y z w
    sought/<name>               (k, 3) [m] in the base frame: where points of a body are to be at the end

The states are there if the trace has them, and so is what was sought. Reports of the steps are not kept. Nothing is
pickled.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from sim_core.errors import ConfigError
from sim_core.simulate import Trace
from sim_core.state_history import StateHistory

__all__ = [
    "load_sought",
    "load_trace",
    "save_trace",
]

VERSION = 1


def save_trace(path: Path | str, trace: Trace, sought: Mapping[str, np.ndarray] | None = None) -> None:
    """Write a trace to a new ``.npz`` file. ``sought``: where points are to be at the end [m] ``(k, 3)``, by name.
    Raises ``ConfigError`` where it cannot be written or exists."""
    path = Path(path)
    if path.suffix != ".npz":
        raise ConfigError(f"A trace is a .npz file, and {path} is not named so.", f"Write {path}.npz.")
    if path.exists():
        raise ConfigError(f"{path} already exists.", "Name a new file; nothing is overwritten.")
    arrays: dict[str, np.ndarray] = {
        "version": np.array(VERSION),
        "times": trace.times,
        "kinds": np.array([f"{name}={kind}" for name, kind in trace.kinds.items()], dtype=str),
        **{f"outputs/{name}": values for name, values in trace.outputs.items()},
        **{f"ids/{name}": values for name, values in trace.ids.items()},
        **{f"sought/{name}": points for name, points in (sought or {}).items()},
    }
    states = trace.states
    if states is not None:
        arrays |= {
            "states/positions": states.positions,
            "states/pressures": states.pressures,
            "states/slip_speeds": states.slip_speeds,
            **{f"states/forces/{pair}": values for pair, values in states.pair_forces.items()},
            **{f"states/origins/{mount}": values for mount, values in states.origins.items()},
            **{f"states/quaternions/{mount}": values for mount, values in states.quaternions.items()},
        }
    try:
        np.savez_compressed(path, **arrays)  # type: ignore[arg-type]
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}.", "Check the folder.") from None


def load_sought(path: Path | str) -> dict[str, np.ndarray]:
    """Where points are to be at the end of a trace [m] ``(k, 3)``, by name. The file is one that :func:`load_trace`
    reads."""
    with np.load(Path(path), allow_pickle=False) as stored:
        return _group({name: np.asarray(stored[name]) for name in stored.files}, "sought/")


def load_trace(path: Path | str) -> Trace:
    """Read a trace; it has no reports of the steps. Raises ``ConfigError`` for what is no trace."""
    path = Path(path)
    if not path.exists():
        raise ConfigError(f"The trace {path} does not exist.", "Check the path.")
    try:
        with np.load(path, allow_pickle=False) as stored:
            data = {name: np.asarray(stored[name]) for name in stored.files}
        version = int(data["version"])
        if version != VERSION:
            raise ConfigError(f"The trace {path} has the format {version}; this version reads {VERSION}.",
                              "Simulate again, or use the version that wrote it.")  # fmt: skip
        kinds = dict(text.split("=") for text in data["kinds"].tolist())
        states = _states(data) if "states/positions" in data else None
        return Trace(data["times"], _group(data, "outputs/"), kinds, _group(data, "ids/"), (), states)
    except (OSError, ValueError, KeyError, BadZipFile, AttributeError) as error:
        raise ConfigError(f"{path} is not a trace: {error}.", "Write one with save_trace.") from None


def _group(data: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): values for name, values in data.items() if name.startswith(prefix)}


def _states(data: dict[str, np.ndarray]) -> StateHistory:
    return StateHistory(
        data["states/positions"],
        _group(data, "states/origins/"),
        _group(data, "states/quaternions/"),
        _group(data, "states/forces/"),
        data["states/pressures"],
        data["states/slip_speeds"],
    )
