"""Nuisance parameters of every recording: clocks, untared force sensors, cameras and end effectors slightly off.

A fit estimates these nuisances jointly with the parameters that it is asked for. Each has a prior about the value of
the rig, as wide as such things are off in a laboratory, so that data which do not tell leave it where it is:

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

from sim_core.effects import Nuisance, all_effects, split_key
from sim_core.errors import ConfigError, nearest_match
from sim_core.rigs import Rig
from sim_core.rigs.pose_offset import OFFSETS
from sysid.model.parameters import FitParameter, fit_parameters
from sysid.model.pose_influence import influencing_end_effectors
from sysid.noise.estimate import column_groups
from sysid.observations.observations import Measured, Run
from sysid.observations.selection import recording_of
from sysid.settings.model import MODEL

KINDS = ("time", "bias", "camera", "pose")


def checked_kinds(words: Collection[str]) -> frozenset[str]:
    """The kinds of nuisances that a user names: 'all', 'none', or some of :data:`KINDS`. Raises ``ConfigError``."""
    if set(words) == {"all"}:
        return frozenset(KINDS)
    if set(words) == {"none"}:
        return frozenset()
    for word in words:
        if word not in KINDS:
            if word in ("all", "none"):
                raise ConfigError(f"Nuisance {word!r} stands with others.", "Name kinds, or 'all' or 'none' alone.")
            raise ConfigError(f"There is no nuisance {word!r}.", nearest_match(word, (*KINDS, "all", "none")))
    return frozenset(words)


def nuisance_parameters(
    rig: Rig, runs: Sequence[Run], asked: Sequence[FitParameter], kinds: Collection[str]
) -> list[FitParameter]:
    """The nuisances that are parameters of the rig, for the channels that the runs have.

    Left out are those that are asked for, by themselves or by the effect that they are a small form of.
    """
    names = {p.target for p in asked}
    measured = {m.channel: m for run in runs for m in run.measured}
    hands = influencing_end_effectors(rig, measured)
    found: list[FitParameter] = []
    declared = [n for n in _allowed(rig, asked) if n.kind in kinds and n.parameter is not None and n.sd]
    owners = [(channel, kind) for channel in measured for kind in ("time", "camera")]
    for owner, kind in (*owners, *((hand, "pose") for hand in hands)):
        for nuisance in declared:
            if (nuisance.owner, nuisance.kind) != (owner, kind) or names & {nuisance.parameter, *nuisance.tied}:
                continue
            assert nuisance.parameter is not None and nuisance.sd is not None
            one = replace(
                fit_parameters(rig, [nuisance.parameter])[0], prior_sd=nuisance.sd, nuisance=True, tied=nuisance.tied
            )
            there = dict.fromkeys(recording_of(run.name) for run in runs if run.has(owner))
            bags = [*there] if nuisance.per_recording and len(there) > 1 else []
            found.extend([replace(one, name=f"{one.name}[{bag}]", bag=bag) for bag in bags] or [one])
    return found


def kind_of(rig: Rig, name: str) -> str:
    """Kind of a nuisance that is a parameter of the rig."""
    owner, _, quantity = name.rpartition(".")
    pose = quantity in OFFSETS and owner not in rig.cameras
    return "time" if quantity == "latency_s" else "pose" if pose else "camera"


def _allowed(rig: Rig, asked: Sequence[FitParameter]) -> list[Nuisance]:
    """The nuisances that effects declare, without those of which an effect that is asked for is the larger form."""
    own = [p.target.split(".") for p in asked if p.target.startswith("effects.")]
    found = []
    for effect in all_effects().values():
        for nuisance in effect.nuisances(rig):
            taken = any(
                split_key(key)[0] == effect.name
                and split_key(key)[1] in (None, nuisance.owner)
                and parameter in nuisance.same_as
                for _, key, parameter in own
            )
            if not taken:
                found.append(nuisance)
    return found


def has_bias(rig: Rig, runs: Sequence[Run], asked: Sequence[FitParameter], kinds: Collection[str]) -> bool:
    """Whether wrenches have a bias that is a nuisance, and not one that is asked for as an effect."""
    measured = {m.channel for run in runs for m in run.measured}
    return "bias" in kinds and any(n.kind == "bias" and n.owner in measured for n in _allowed(rig, asked))


def bias_sd(measured: Measured) -> np.ndarray | None:
    """Standard deviation of the bias of each column ``(m,)``, measured units; None where there is none."""
    if measured.kind != "wrench":
        return None
    out = np.zeros(measured.values.shape[1])
    for group, least in zip(column_groups(measured), MODEL.bias_sd, strict=True):
        out[group] = max(
            least, MODEL.bias_share * float(np.max(np.abs(np.nan_to_num(measured.values[:, group])), initial=0.0))
        )
    return out
