"""What every recording has and nobody tells: clocks, untared force sensors, cameras and end effectors slightly off.

A fit estimates these nuisances beside the parameters that it is asked for. Each has a prior about the value of the
rig, as wide as such things are off in a laboratory, so that data which do not tell leave it where it is:

- ``time``: the latency of each measured stream, in each recording by itself, since clocks are set anew between them
  (windows of one recording share it);
- ``bias``: a constant in each component of each wrench sensor and run, eliminated as the discretisation error is
  (:mod:`sysid.solve.discretisation_basis`);
- ``camera``: the focal length (fx and fy together; the scale of an orthographic camera) and the principal point;
  where the camera stands, if the rig says that this is not known exactly (``offset_sd_m``, ``offset_sd_deg``);
- ``pose``: a constant offset of each end effector against its poses, three shifts and three turns in its own frame, as
  wide as the rig says (``offset_sd_m``, ``offset_sd_deg``); what it says is known exactly is not fitted.
  With it an evaluation takes 1.1 to 1.3 times as long, and without it half a millimetre passes for stiffness.

A camera that places the markers on their sheet in its first frame has them too: the places follow what is wrong
(:mod:`sysid.model.marker_registration`), but how markers move and forces change does not.

What is asked for by name is no nuisance. How well the rest is known the rig may say itself (``latency_sd_s``,
``scale_sd``, ``centre_sd_px``); what it says is known exactly is not fitted.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from sim_core.errors import ConfigError, nearest_match
from sim_core.rigs import OrthographicCamera, Rig
from sim_core.rigs.observers import Camera
from sim_core.rigs.pose_offset import OFFSETS
from sysid.model.parameters import FitParameter, fit_parameters
from sysid.model.pose_influence import acting
from sysid.noise.estimate import column_groups
from sysid.observations.observations import Measured, Run
from sysid.observations.selection import recording_of

KINDS = ("time", "bias", "camera", "pose")

BIAS_SD = (5.0, 0.5)
"""Least standard deviation of the bias of a force [N] and of a torque [N m]: that of 5 N at 0.1 m."""

BIAS_SHARE = 0.5
"""The same in units of the largest force or torque in the recording, where that is more."""


def checked_kinds(words: Collection[str]) -> frozenset[str]:
    """The kinds of nuisances that a user names: 'all', 'none', or some of :data:`KINDS`. Raises ``ConfigError``."""
    if set(words) == {"all"}:
        return frozenset(KINDS)
    if set(words) == {"none"}:
        return frozenset()
    for word in words:
        if word not in KINDS:
            if word in ("all", "none"):
                raise ConfigError(f"Nuisance {word!r} stands beside others.", "Name kinds, or 'all' or 'none' alone.")
            raise ConfigError(f"There is no nuisance {word!r}.", nearest_match(word, (*KINDS, "all", "none")))
    return frozenset(words)


def nuisance_parameters(
    rig: Rig, runs: Sequence[Run], asked: Sequence[FitParameter], kinds: Collection[str]
) -> list[FitParameter]:
    """The nuisances that are parameters of the rig, for the channels that the runs have.

    Left out are those that are asked for, and offsets in time beside an effect that is one.
    """
    names = {p.target for p in asked}
    found: list[FitParameter] = []

    def add(name: str, sd: float, tied: tuple[str, ...] = (), bags: Sequence[str] = ()) -> None:
        if not sd or names & {name, *tied}:
            return
        one = replace(fit_parameters(rig, [name])[0], prior_sd=sd, nuisance=True, tied=tied)
        found.extend([replace(one, name=f"{name}[{bag}]", bag=bag) for bag in bags] or [one])

    measured = {m.channel: m for run in runs for m in run.measured}
    for channel, m in measured.items():
        late = f"effects.stream_delay.{'wrench' if m.kind == 'wrench' else 'vision'}_s"
        if "time" in kinds and late not in names:
            there = dict.fromkeys(recording_of(run.name) for run in runs if run.has(channel))
            source = rig.sensors.get(channel) or rig.cameras[channel]
            add(f"{channel}.latency_s", source.latency_sd_s, bags=[*there] if len(there) > 1 else ())
        if "camera" in kinds and channel in rig.cameras:
            for name, sd, tied in _intrinsics(channel, rig.cameras[channel]):
                add(name, sd, tied)
    if "pose" in kinds:
        for effector in acting(rig, measured):
            known = rig.end_effectors[effector]
            for key, sd in zip(OFFSETS, (*known.offset_sd_m, *known.offset_sd_deg), strict=True):
                add(f"{effector}.{key}", sd)
    return found


def _intrinsics(name: str, camera: Camera) -> list[tuple[str, float, tuple[str, ...]]]:
    """What may be off of a camera, how far, and what changes in proportion. Where it counts from one of the markers,
    its centre has no part in the readings."""
    found: list[tuple[str, float, tuple[str, ...]]]
    if isinstance(camera, OrthographicCamera):
        found = [(f"{name}.scale_m_per_px", camera.scale_sd, ())]
        centred = camera.origin_id is not None
    else:
        found = [(f"{name}.fx_px", camera.scale_sd, (f"{name}.fy_px",))]
        centred = False
    found += [(f"{name}.{axis}_px", camera.centre_sd_px, ()) for axis in ("cx", "cy") if not centred]
    sds = (*camera.offset_sd_m, *camera.offset_sd_deg)
    return found + [(f"{name}.{key}", sd, ()) for key, sd in zip(OFFSETS, sds, strict=True)]


def has_bias(runs: Sequence[Run], asked: Sequence[FitParameter], kinds: Collection[str]) -> bool:
    """Whether wrenches have a bias that is a nuisance, and not one that is asked for as an effect."""
    wrenches = any(m.kind == "wrench" for run in runs for m in run.measured)
    return "bias" in kinds and wrenches and not any(p.name.startswith("effects.wrench_offset.bias") for p in asked)


def bias_sd(measured: Measured) -> np.ndarray | None:
    """Standard deviation of the bias of each column ``(m,)``, measured units; None where there is none."""
    if measured.kind != "wrench":
        return None
    out = np.zeros(measured.values.shape[1])
    for group, least in zip(column_groups(measured), BIAS_SD, strict=True):
        out[group] = max(
            least, BIAS_SHARE * float(np.max(np.abs(np.nan_to_num(measured.values[:, group])), initial=0.0))
        )
    return out
