"""A task small enough to be stepped in tests: a finger presses and drags a strip of card that is held at one end and
yields in bending."""

from __future__ import annotations

from pathlib import Path

from sim_core.tasks import MadeTask, load_task

RIG = """
name: small_strip
solver: {dt_s: 0.01, inertia: true}
bodies:
  card:
    type: sheet
    shape: {type: rectangle, length_m: 0.06, width_m: 0.02, cells: [6, 2], pattern: regular}
    pose: {position_m: [0.0, 0.0, 0.0]}
    material: {E_pa: 2.0e9, nu: 0.3, thickness_m: 3.0e-4, density_kg_m3: 400.0}
  gel:
    type: gel
    shape: {type: block, size_m: [0.008, 0.008, 0.004], cells: [1, 1, 1]}
    pose: {position_m: [0.0, 0.0, -0.002], rpy_deg: [180.0, 0.0, 0.0]}
    material: {E_pa: 1.0e5, nu: 0.4, density_kg_m3: 1000.0}
    bonded: bottom
    mount: finger
clamps:
  - {name: vice, body: card, region: {x_m: [-0.03, -0.02]}, mount: world}
end_effectors:
  finger: {start: {position_m: [0.015, 0.001, 0.0042]}}
contacts:
  - {between: [gel, card], friction: 0.4}
effects:
  bending_plasticity: {yield_curvature_per_m: 3.0, hardening_ratio: 0.2}
"""

TASK = """
name: small
title: A finger presses a strip down and bends it.
rig: RIG
reward: REWARD
step_s: 0.01
approach:
  finger: [{type: slide, by_m: [0.0, 0.0, -0.0012], speed_m_s: 0.05}]
actions:
  steps: 8
  knots: 2
  hands:
    finger: {fingers: [finger], step_m: [0.0006, 0.0006, 0.0012], step_deg: [1.0, 1.0, 1.0]}
points:
  sheet: {body: card, grid: [4, 2]}
  before: {body: card, grid: [5, 2], row: [-0.016, -0.014]}
  middle: {body: card, grid: [5, 2], row: [-0.001, 0.001]}
  after: {body: card, grid: [5, 2], row: [0.014, 0.016]}
folds:
  here: {body: card, at_m: -0.015, over_m: 0.01}
  there: {body: card, at_m: 0.005, over_m: 0.01}
  middle: {body: card, at_m: -0.01, over_m: 0.02}
variants:
  real:
    words: The strip is bent.
    success: 0.05
    settings: {hinges: 3, sign: -1, target_seed: 3, target_scale: 0.3, target_least_m: 0.0001}
"""


def small_task(folder: Path, reward: str = "folding", text: str = TASK) -> MadeTask:
    """The task with one of the rewards, its files in ``folder``."""
    (folder / "rig.yaml").write_text(RIG)
    path = folder / "small.yaml"
    path.write_text(text.replace("RIG", str(folder / "rig.yaml")).replace("REWARD", reward))
    return load_task(str(path))


def touch_sensor(force_n: float, torque_nm: float) -> str:
    """A wrench sensor on the gel with noise of such standard deviations, to be put at the end of a rig."""
    return f"""
sensors:
  touch:
    type: wrench
    on: gel
    frame_id: touch_gel
    rate_hz: 100.0
    noise: {{force_n: {force_n}, torque_nm: {torque_nm}}}
    topic: touch/wrench
"""
