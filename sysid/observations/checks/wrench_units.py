"""Forces and torques of a recording against the rig: units, range, noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.rigs import Rig, WrenchSensor
from sysid.noise.estimate import by_differences
from sysid.noise.quantisation import common_step
from sysid.observations.checks.finding import Finding
from sysid.observations.checks.motion import components
from sysid.observations.checks.rig_size import extent_of
from sysid.recording import Recording
from sysid.recording.streams import WrenchStream
from sysid.settings.observations import OBSERVATIONS

TORQUE_UNITS = {"newton millimetres": 1000.0, "newton centimetres": 100.0}
"""How many of a unit are one newton metre."""

UNITS = {"gram-force": 101.97, "millinewtons": 1000.0, "pounds-force": 0.2248, "kilogram-force": 0.10197}
"""How many of a unit are one newton."""


def wrench_units(recording: Recording, rig: Rig) -> Iterator[Finding]:
    """Noise that is that of another unit, and torques whose lever arm is longer than the rig."""
    for name, wrench in recording.wrenches.items():
        sensor = rig.sensors[name]
        assert isinstance(sensor, WrenchSensor)
        yield from _noise_unit(name, wrench, sensor, "force", "N", sensor.noise.force_n)
        if sensor.length_unit is None:
            yield from _noise_unit(name, wrench, sensor, "torque", "N m", sensor.noise.torque_nm)
        yield from _range(name, wrench, sensor)
        yield from _lever(name, wrench, sensor, rig)


def _noise_unit(
    name: str, wrench: WrenchStream, sensor: WrenchSensor, quantity: str, unit: str, declared: float
) -> Iterator[Finding]:
    columns = [k for k, axis in enumerate("xyz") if f"{quantity}_{axis}" in sensor.measures]
    values = (wrench.force if quantity == "force" else wrench.torque)[:, columns]
    values = values[:, np.isfinite(values).any(axis=0)]
    if declared == 0.0 or len(values) < 50 or not values.size:
        return
    noise = max([*by_differences(values, wrench.t), 0.0])
    ratio = noise / declared
    if ratio < OBSERVATIONS.loud_noise_ratio or noise < common_step(values.T):
        return  # as quiet as it should be, or rounding, which is another matter
    units = UNITS if quantity == "force" else TORQUE_UNITS
    found = [
        (w, s)
        for w, s in units.items()
        if s > 1.0 and 1.0 / OBSERVATIONS.unit_noise_factor < ratio / s < OBSERVATIONS.unit_noise_factor
    ]
    as_unit = f" In {found[0][0]} it would be {noise / found[0][1]:.2g} {unit}." if found else ""
    if quantity == "torque" and not found:
        return
    remedy = "Record newtons" if quantity == "force" else "Write `length_unit: mm` into this sensor for N mm"
    yield Finding(
        f"{quantity}_unit" if found else f"{quantity}_noise",
        wrench.topic,
        "warning",
        f"The noise of the {quantity} of {name} is {noise:.3g} {unit}, {ratio:.3g} times what the rig declares "
        f"({declared:g} {unit}).{as_unit}",
        f"{remedy}, or correct `noise` in the rig." if found else "Look at the sensor, or correct the rig.",
        values=(noise,),
        bound=OBSERVATIONS.loud_noise_ratio * declared,
        part=name,
    )


def _range(name: str, wrench: WrenchStream, sensor: WrenchSensor) -> Iterator[Finding]:
    for quantity, unit, values, largest in (
        ("force", "N", wrench.force, sensor.range_n),
        ("torque", "N m", wrench.torque, sensor.range_nm),
    ):
        if largest is None or not np.isfinite(values).any():
            continue
        over = np.nan_to_num(np.abs(values)) > OBSERVATIONS.beyond_range_factor * largest
        if over.any():
            yield Finding(
                "sensor_range",
                wrench.topic,
                "warning",
                f"{name} reads a {quantity} of {float(np.nanmax(np.abs(values))):.4g} {unit} in "
                f"{int(over.any(axis=1).sum())} readings, more than the {largest:g} {unit} that it can by the rig.",
                "Look at the unit of the recording, or correct the range in the rig.",
                times=tuple(wrench.t[over.any(axis=1)]),
                values=(float(np.nanmax(np.abs(values))),),
                bound=largest,
                part=name,
            )


def _lever(name: str, wrench: WrenchStream, sensor: WrenchSensor, rig: Rig) -> Iterator[Finding]:
    if sensor.length_unit is not None or not any(c.startswith("torque") for c in sensor.measures):
        return
    values = components(wrench)
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < 20:
        return
    values = values - np.median(values[: max(5, len(values) // 50)], axis=0)
    force, torque = np.linalg.norm(values[:, :3], axis=1), np.linalg.norm(values[:, 3:], axis=1)
    high = force > max(0.5 * force.max(), OBSERVATIONS.lever_arm_signal_ratio * sensor.noise.force_n, 1e-6)
    if high.sum() < 10:
        return
    arm, size = float(np.median(torque[high] / force[high])), extent_of(rig)
    if arm > OBSERVATIONS.lever_arm_ratio * size:
        yield Finding(
            "torque_unit",
            wrench.topic,
            "stops a fit",
            f"The torques of {name} have a lever arm of {arm:.3g} m to its forces, where the rig is {size:.2g} m "
            f"large; as newton millimetres it is {arm:.3g} mm.",
            "Write `length_unit: mm` into this sensor of the rig, or `length_unit: m` if newton metres are right.",
            values=(arm,),
            bound=OBSERVATIONS.lever_arm_ratio * size,
            part=name,
        )
