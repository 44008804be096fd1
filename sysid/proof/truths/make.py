"""Recordings of one case: draw a stand and what it conceals, simulate, spoil with noise, write bags and rig."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sim_core.errors import ConvergenceError
from sysid.progress.callback import Progress
from sysid.proof.truths import gel, paths, strip
from sysid.proof.truths.ball import BallError
from sysid.proof.truths.conceal import LIBRARY, Changes, Concealed, changes, draw
from sysid.proof.truths.noise import white
from sysid.proof.truths.rod import RodError
from sysid.proof.truths.sensors import Clean, Streams, noise_free, write_bag
from sysid.proof.truths.signal import Readings, signal

NOISES = ("nasty", "white")

MOST_DRAWS = 10
"""Draws of a case that cannot be simulated, and of amplitudes that do not stand out, before giving up."""

MIN_SIGNAL = 15.0
"""Least signal (:mod:`sysid.proof.truths.signal`) of an effect that is concealed."""

TRUTH_FILE = "truth.json"

TOPICS = {k: k for k in ("target_pose", "current_pose", "wrench", "marker_tracks", "camera_info")}

Stand = strip.Strip | gel.Pad
Paths = dict[str, paths.Path]
Report = Callable[[float], None]


@dataclass(frozen=True)
class _Kind:
    """What the two stands differ in. ``values``: names of the materials and the fields that hold them."""

    stand: str
    truth: str
    frames: tuple[str, str]
    values: dict[str, str]


KINDS = {
    "strip": _Kind(
        "strip", "rod", ("ee_frame", "camera_optical_frame"),
        {
            "strip.E_pa": "modulus",
            "strip.density_kg_m3": "density",
            "contacts.strip-table.friction": "friction",
        },
    ),
    "gel": _Kind(
        "gel", "layer", ("gel_frame", "gel_camera_optical_frame"),
        {"gel.E_pa": "modulus", "gel.nu": "poisson", "contacts.gel-ball.friction": "friction"},
    ),
}  # fmt: skip


def record_cases(
    out: Path,
    stand: str,
    *,
    cases: int,
    seed: int,
    effects: Sequence[str] = (),
    fast: bool = False,
    noise: str = "nasty",
    on_progress: Progress | None = None,
) -> str:
    """Write ``cases`` cases of one stand, unsealed, each with its ``truth.json``; all conceal ``effects``. The returned
    text says what was written."""
    out.mkdir(parents=True)
    for k, own in enumerate(np.random.SeedSequence(seed).spawn(cases)):
        folder = out / f"case_{k + 1:02d}"

        def report(share: float, k: int = k, name: str = folder.name) -> None:
            if on_progress is not None:
                on_progress((k + share) / cases, name)

        truth = make_case(folder, stand, own, effects=effects, fast=fast, noise=noise, on_progress=report)
        (folder / TRUTH_FILE).write_text(json.dumps(truth, indent=2) + "\n")
    words = " and ".join(effects) or "nothing"
    return f"{out}: {cases} cases of the stand {stand!r} that conceal {words}, {noise} noise."


def make_case(
    folder: Path,
    stand: str,
    seed: np.random.SeedSequence,
    *,
    effects: Sequence[str] = (),
    fast: bool = False,
    noise: str = "nasty",
    on_progress: Report | None = None,
) -> dict[str, Any]:
    """Write ``folder`` with ``rig.yaml``, ``setup.yaml``, ``case.yaml`` and one bag a recording; the truth is
    returned. A draw that cannot be simulated, or whose effects do not stand out of the noise, is drawn again.

    ``effects``: names from :mod:`sysid.proof.truths.conceal`. ``fast``: fewer and shorter recordings. ``noise``:
    'nasty' or 'white'. What is concealed has random numbers of its own, so that nothing else depends on it.
    """
    for own in seed.spawn(MOST_DRAWS):
        try:
            return _case(
                folder, KINDS[stand], own, effects, "fast" if fast else "full", noise, on_progress or (lambda _: None)
            )
        except (RodError, BallError, _TooWeak):
            continue
    raise ConvergenceError(f"{folder.name}: no draw could be simulated.", "Use another seed.")


class _TooWeak(Exception):
    """No amplitude stood out."""


def _case(
    folder: Path,
    kind: _Kind,
    seed: np.random.SeedSequence,
    effects: Sequence[str],
    size: str,
    noise: str,
    on_progress: Report,
) -> dict[str, Any]:
    for_stand, for_motion, for_noise, for_effects = (s for s in seed.spawn(4))
    room: Any = strip if kind.stand == "strip" else gel
    rng = np.random.default_rng(for_stand)
    stand: Stand = strip.draw_strip(rng) if kind.stand == "strip" else gel.draw_pad(rng)
    if noise == "white":
        stand = replace(stand, levels=white(stand.levels.force, stand.levels.arm, stand.levels.px))
    motion = np.random.default_rng(for_motion)
    routes: Paths = {name: room.draw_path(motion, stand, what) for name, what in room.KINDS[size].items()}
    held_out = room.HELD_OUT[size]
    training = {name: path for name, path in routes.items() if name not in held_out}
    concealed, strengths = _conceal(np.random.default_rng(for_effects), kind, stand, effects, training)
    change = changes(stand, concealed)
    clean: dict[str, Clean] = {}
    truth = _truth_of(stand, change)
    for k, (name, path) in enumerate(routes.items()):
        on_progress((k + 1) / (len(routes) + 1))
        clean[name] = truth.run(path)
    folder.mkdir(parents=True)
    markers = room.marker_count(stand)
    streams = Streams(TOPICS, "base_link", *kind.frames, np.arange(markers))
    for name, own in zip(clean, for_noise.spawn(len(clean)), strict=True):
        write_bag(
            folder / name, clean[name], streams, change.camera, stand.camera, stand.levels,
            np.random.default_rng(own), wrench=change.wrench, clocks=change.clocks,
        )  # fmt: skip
    _write_yaml(folder / "case.yaml", {"training": list(training), "held_out": list(held_out)})
    _write_yaml(folder / "rig.yaml", room.rig(stand, room.NAME))
    _write_yaml(folder / "setup.yaml", room.setup(stand, list(routes)))
    return {
        "case": folder.name,
        "rig": kind.stand,
        "truth": kind.truth,
        "effects": [
            {
                "name": c.name,
                "slot": c.slot,
                "in_library": c.name in LIBRARY[kind.stand],
                "parameters": c.parameters,
                "signal": strength,
            }
            for c, strength in zip(concealed, strengths, strict=True)
        ],
        "materials": {name: getattr(stand, attribute) for name, attribute in kind.values.items()},
        "noise": stand.levels.as_dict(),
    }


def _conceal(
    rng: np.random.Generator, kind: _Kind, stand: Stand, effects: Sequence[str], training: Paths
) -> tuple[list[Concealed], list[float]]:
    """Effects with amplitudes that stand out, each by itself, and how far."""
    if not effects:
        return [], []
    nothing = changes(stand, [])
    clean = _clean(stand, nothing, training)
    base = _readings(clean, nothing)
    shifted = []
    for attribute in kind.values.values():
        other = replace(stand, **{attribute: 1.01 * getattr(stand, attribute)})
        shifted.append(_readings(_clean(other, changes(other, []), training), nothing))
    found, strengths = [], []
    for name in effects:
        for _ in range(MOST_DRAWS):
            one = draw(rng, stand, name)
            change = changes(stand, [one])
            moves = one.strip or one.ball or one.arm
            seen = _readings(_clean(stand, change, training) if moves else clean, change)
            strength = signal(seen, base, shifted, stand.levels)
            if strength >= MIN_SIGNAL:
                break
        else:
            raise _TooWeak
        found.append(one)
        strengths.append(strength)
    return found, strengths


def _truth_of(stand: Stand, change: Changes, *, coarse: bool = False) -> strip.StripTruth | gel.PadTruth:
    """The simulator of a stand; ``coarse``: good enough to weigh an effect."""
    if isinstance(stand, gel.Pad):
        return gel.PadTruth(stand, change.ball, change.arm)
    size = {"elements": 30, "step_s": 2e-3} if coarse else {}
    return strip.StripTruth(stand, change.strip, change.arm, **size)  # type: ignore[arg-type]


def _clean(stand: Stand, change: Changes, routes: Paths) -> list[Clean]:
    """What happens on each route, good enough to weigh an effect."""
    truth = _truth_of(stand, change, coarse=True)
    return [truth.run(path) for path in routes.values()]


def _readings(clean: Sequence[Clean], change: Changes) -> Readings:
    return [noise_free(one, change.camera, change.wrench, change.clocks) for one in clean]


def _write_yaml(path: Path, data: dict[str, Any]) -> None:
    path.write_text(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110))
