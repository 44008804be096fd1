"""The bench of the benchmark: its rig, what its true materials may be, and what is done on it.

One rig shows every effect. A holder carries a light strip by one end; a finger carries a gel. In a run of
the kind ``table`` the finger presses its gel on the table, holds, slides there and back, and lets go, while
the holder waves the strip. In a run of the kind ``strip`` the finger presses the strip down off its middle
line, holds, and lets go quickly. All runs of a kind last equally long, whatever is drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim_core.rigs import Rig, load_rig, with_parameters
from sim_core.rigs.fields import Pose
from sim_core.rigs.motion import Experiment, Motion, Slide, Wait, compile_experiment
from sim_core.rigs.trajectory import PoseTrajectory

RIG = "proof_bench"

TRAINING = ("run_a", "run_b")
HELD_OUT = ("run_c", "run_d")
KINDS = {"run_a": "table", "run_b": "strip", "run_c": "table", "run_d": "strip"}
"""Which kind of motion each run has; held-out runs differ from training runs in place, depth and speed."""

DURATION_S = {"table": 1.5, "strip": 0.9}

COMMAND_RATE_HZ = 400.0
"""The truth moves on smooth paths; the recorded poses are coarser."""

REST_S = 0.25
"""Every run begins with standing still, in which the noise can be seen."""

MATERIALS = {
    "strip.E_pa": (2.2e9, 4.5e9),
    "gel.E_pa": (9e4, 2e5),
    "contacts.gel-table.friction": (0.35, 0.7),
}
"""Range of the true values, drawn log-uniformly. All other numbers of the rig are true as they stand."""

GUESS_SHARE = 0.4
"""The rig that is handed out is off by up to this share in each of these values."""

NOISE_SHARE = (0.6, 1.6)
"""Declared over true standard deviation of the noise."""

STRIP_HEIGHT_M = 0.10
GEL_HEIGHT_M = 0.006


@dataclass(frozen=True)
class Noise:
    """Noise of one quantity: standard deviation (N, N m, m or px) and lag-one correlation at 100 Hz."""

    sd: float
    rho: float


def draw_materials(rng: np.random.Generator) -> dict[str, float]:
    """True material values in SI units."""
    return {name: _log_uniform(rng, *bounds) for name, bounds in MATERIALS.items()}


def draw_noise(rng: np.random.Generator) -> dict[str, Noise]:
    """True noise: force, torque and gel markers about 0.5 to 1 % of their range, tracks 0.1 to 0.2 px."""
    level, colour = rng.uniform(0.5, 1.0), rng.uniform(0.3, 0.8)
    return {
        "force_n": Noise(0.025 * level, colour),
        "torque_nm": Noise(1.2e-4 * level, colour),
        "position_m": Noise(rng.uniform(8e-6, 1.5e-5), rng.uniform(0.0, 0.3)),
        "position_px": Noise(rng.uniform(0.1, 0.2), rng.uniform(0.0, 0.3)),
    }


def true_rig(materials: dict[str, float]) -> Rig:
    """The bench with its true materials and without any effect."""
    return with_parameters(load_rig(RIG), materials)


def told_rig(rng: np.random.Generator, rig: Rig, noise: dict[str, Noise]) -> Rig:
    """What the user of the tool is given: the bench with guessed materials and declared noise levels."""
    materials = {p: _value(rig, p) * (1.0 + rng.uniform(-GUESS_SHARE, GUESS_SHARE)) for p in MATERIALS}
    declared = {k: float(f"{n.sd * rng.uniform(*NOISE_SHARE):.2g}") for k, n in noise.items()}
    guessed = with_parameters(rig, {k: float(f"{v:.3g}") for k, v in materials.items()})
    sensors = {
        name: sensor.model_copy(
            update={"noise": sensor.noise.model_copy(update={k: declared[k] for k in type(sensor.noise).model_fields})}
        )
        for name, sensor in guessed.sensors.items()
    }
    cameras = {
        name: camera.model_copy(
            update={"noise": camera.noise.model_copy(update={"position_px": declared["position_px"]})}
        )
        for name, camera in guessed.cameras.items()
    }
    return guessed.model_copy(update={"name": "bench", "sensors": sensors, "cameras": cameras})


def draw_poses(rng: np.random.Generator, rig: Rig, kind: str) -> dict[str, PoseTrajectory]:
    """Commanded poses of one run by end effector."""
    return _table_run(rng, rig) if kind == "table" else _strip_run(rng, rig)


def _table_run(rng: np.random.Generator, rig: Rig) -> dict[str, PoseTrajectory]:
    """Press on the table, slide there and back in a random direction; wave the strip meanwhile."""
    gap, depth = 2e-4, rng.uniform(3.5e-4, 5e-4)
    angle, length, speed = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(1.6e-3, 2.2e-3), rng.uniform(0.012, 0.015)
    way = (length * math.cos(angle), length * math.sin(angle), 0.0)
    stroke, top = rng.uniform(0.09, 0.12), rng.uniform(0.5, 0.6)
    finger = (
        _wait(REST_S),
        _go((0.0, 0.0, -gap - depth), rng.uniform(0.007, 0.009)),
        _wait(0.2),
        _go(way, speed),
        _go((-way[0], -way[1], 0.0), speed),
        _go((0.0, 0.0, gap + depth), 0.012),
    )
    holder = (_wait(REST_S), _go((0.0, 0.0, stroke), top), _go((0.0, 0.0, -stroke), top))
    start = (0.1 + rng.uniform(-0.01, 0.01), 0.1 + rng.uniform(-0.01, 0.01), GEL_HEIGHT_M + gap)
    return _compile(rig, start, {"finger": finger, "holder": holder}, DURATION_S["table"])


def _strip_run(rng: np.random.Generator, rig: Rig) -> dict[str, PoseTrajectory]:
    """Press the strip down off its middle line, hold, let go quickly."""
    gap, depth = 1e-3, rng.uniform(0.008, 0.012)
    x, side, y = rng.uniform(0.010, 0.016), rng.choice([-1.0, 1.0]), rng.uniform(0.009, 0.013)
    down = (0.0, 0.0, -gap - depth)
    finger = (
        _wait(REST_S),
        _go(down, rng.uniform(0.11, 0.14)),
        _wait(0.1),
        _go((0.0, 0.0, gap + depth), rng.uniform(0.16, 0.2)),
    )
    start = (x, float(side * y), STRIP_HEIGHT_M + GEL_HEIGHT_M + gap)
    return _compile(rig, start, {"finger": finger}, DURATION_S["strip"])


def _compile(
    rig: Rig, start: tuple[float, float, float], motions: dict[str, tuple[Motion, ...]], duration: float
) -> dict[str, PoseTrajectory]:
    """Poses of motions that begin with the finger at ``start`` [m]."""
    finger = rig.end_effectors["finger"].model_copy(update={"start": Pose(position_m=start)})
    moved = rig.model_copy(update={"end_effectors": {**rig.end_effectors, "finger": finger}})
    poses = compile_experiment(
        Experiment(name="run", duration_s=duration, command_rate_hz=COMMAND_RATE_HZ, motions=motions), moved
    )
    longest = max(float(p.times[-1]) for p in poses.values())
    if longest > duration + 1e-9:
        raise ValueError(f"a run of {longest:.3f} s does not fit into {duration} s")
    return poses


def _wait(seconds: float) -> Wait:
    return Wait(type="wait", duration_s=seconds)


def _go(by: tuple[float, float, float], speed: float) -> Slide:
    return Slide(type="slide", by_m=by, speed_m_s=float(speed))


def _value(rig: Rig, name: str) -> float:
    from sim_core.rigs import list_parameters

    value = next(p.value for p in list_parameters(rig) if p.name == name)
    assert value is not None
    return value


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
