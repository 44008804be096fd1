"""The diagnosis as data: what ``diagnosis.json`` holds (schema ``thinshell.diagnosis/2``).

``verdict``:

- ``nothing_missing``: the rig explains the recordings down to noise, the discretisation error and what careful models
  differ in;
- ``named``: one to three effects are missing, ``effects``;
- ``one_of``: one of several that these recordings do not tell apart;
- ``partly``: ``effects`` are missing, but explain less than what remains unknown;
- ``unknown``: something is missing that no known effect explains;
- ``refine_discretisation``: the error of mesh and time step hides what there may be;
- ``recording_fault``: the recordings themselves are at fault.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.rigs.motion import Experiment
from sysid.comparison.ledger import Ledger
from sysid.diagnosis.one_model import OneModel
from sysid.fit.marker_field import MarkerField
from sysid.fit.result import ChannelError, Series
from sysid.uncertainty.goodness_of_fit import no_success

SCHEMA = "thinshell.diagnosis/2"
VERDICTS = (
    "nothing_missing", "named", "one_of", "partly", "unknown", "refine_discretisation", "recording_fault",
)  # fmt: skip


@dataclass(frozen=True)
class NamedParameter:
    """A fitted parameter of an effect. ``ci95`` in ``unit``."""

    name: str
    value: float
    ci95: tuple[float, float]
    unit: str
    words: str


@dataclass(frozen=True)
class Candidate:
    """One effect as an explanation. ``place``: where it acts; ``probability``: among all that were tried;
    ``log_evidence_gain``: natural logarithm of the evidence over the baseline's; ``held_out_gain``: share of
    the robust misfit on held-out data that it removes (None without held-out data); ``rejected``: why it is
    not an answer, empty when it may be; ``explained``: share of the baseline's structured misfit that is gone with it
    (and with what else the answer has), the smaller of that on recordings given and held out."""

    name: str
    title: str
    place: str
    words: str
    probability: float
    parameters: tuple[NamedParameter, ...]
    log_evidence_gain: float
    held_out_gain: float | None
    rejected: str
    explained: float = 0.0


@dataclass(frozen=True)
class LocatedChannel:
    """Share of the baseline's excess misfit, or of what an answer changes in its predictions (squared, in units of the
    noise, by blocks of time), in one quantity of one channel (shares sum to one)."""

    channel: str
    quantity: str
    share: float


@dataclass(frozen=True)
class Located:
    """Where the baseline fails. ``windows``: for each bag, intervals [s]; ``phase``: of the motion, in words."""

    channels: tuple[LocatedChannel, ...]
    windows: dict[str, tuple[tuple[float, float], ...]]
    phase: str


@dataclass(frozen=True)
class StructuredMisfit:
    """What the baseline leaves of one quantity of one recording by blocks of time. ``per_score``: mean square of the
    sums of whitened residuals, over the number of their samples (1 = noise); ``from_discretisation``: what the error of
    mesh and time step could add to that; ``size``: mean over a block of time, in units of what a single reading may be
    off by noise, mesh, time step and as careful models are."""

    run: str
    channel: str
    quantity: str
    held_out: bool
    per_score: float
    from_discretisation: float
    size: float


@dataclass(frozen=True)
class UnreliablePlace:
    """One place of the model as the cause, without a law. ``place``, ``name``: as 'gel' and the body's name; ``words``:
    what is off there; ``log_evidence_gain`` [nats] of a closure there; ``explained``: share of the misfit beyond noise
    that it takes away. The closure is valid inside the recordings only."""

    place: str
    name: str
    words: str
    log_evidence_gain: float
    explained: float


@dataclass(frozen=True)
class Misfit:
    """Misfit of one model: mean squared whitened residual on training and held-out data (1 = noise), and
    the errors in measured units."""

    training: float
    held_out: float | None
    errors: tuple[ChannelError, ...]


@dataclass
class Diagnosis:
    """The answer, what it rests on, and what it leaves open.

    ``upper_limits``: by amplitude, the size that the recordings would have shown (95 %), of effects that are not the
    answer; ``explained``: share of the structured misfit that is gone with the answer; ``threshold`` [nats]: evidence
    that an effect needed, by the simulated null of the case; ``places``: of a misfit that no known effect explains, the
    most unreliable first; ``tried``: what became of each effect; ``notes``: what
    a reader should know of the fit; ``next_motion``: the next experiment, where it can be told as a motion;
    ``structured``: what the verdict that something is missing rests on; ``setups_tried``: mistakes of set-up that were
    tried first, in words (:mod:`sysid.setup_check`); ``ledger``: of the look at all effects from the baseline;
    ``one_model``: what its posterior says; ``parted``: of recordings of replays, the windows [s] in which the watch
    found readings that were not as predicted.
    """

    verdict: str
    sentence: str
    rig: str
    effects: tuple[Candidate, ...]
    alternatives: tuple[Candidate, ...]
    located: Located
    baseline: Misfit
    amended: Misfit | None
    noise_floor: dict[str, float]
    discretisation: dict[str, float]
    upper_limits: dict[str, float]
    baseline_parameters: tuple[NamedParameter, ...]
    amended_parameters: tuple[NamedParameter, ...]
    not_explained: str
    next_experiment: str
    provenance: dict[str, Any]
    seconds: float
    tried: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    series: list[Series] = field(default_factory=list)
    marker_fields: list[MarkerField] = field(default_factory=list)
    explained: float = 0.0
    threshold: float = 0.0
    places: tuple[UnreliablePlace, ...] = ()
    next_motion: Experiment | None = None
    structured: tuple[StructuredMisfit, ...] = ()
    setups_tried: tuple[str, ...] = ()
    ledger: Ledger | None = None
    one_model: OneModel | None = None
    parted: dict[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)

    @property
    def no_success(self) -> str:
        """What is said first where the model that is found misses the recordings by far more than their noise, twice
        the error of mesh and time step apart; else empty."""
        multiples: dict[str, float] = {}
        for e in (self.amended or self.baseline).errors:
            if not e.held_out and e.after_over_noise is not None:
                words = f"the {e.quantity or 'position'} of {e.channel}"
                beside = float(np.sqrt(max(e.after**2 - (2.0 * e.own) ** 2, 0.0))) / e.noise
                multiples[words] = max(multiples.get(words, 0.0), beside)
        return no_success(multiples, self.setups_tried)

    def table(self) -> str:
        """Verdict, notes and numbers as text."""
        lines = [self.no_success, ""] if self.no_success else []
        lines += [self.sentence, *self.notes, ""]
        for run, windows in self.parted.items():
            when = ", ".join(f"{begin:.2f} to {end:.2f} s" for begin, end in windows)
            lines += [f"Replayed, {run} parted from its prediction: {when}. The report opens there.", ""]
        lines += [self.one_model.sentence, ""] if self.one_model else []
        for effect in self.effects:
            for p in effect.parameters:
                lines.append(f"  {p.name} = {p.value:.4g} ({p.ci95[0]:.4g} .. {p.ci95[1]:.4g}) {p.unit}")
        lines += [f"Not explained: {self.not_explained}", f"Next: {self.next_experiment}"]
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Plain data without the series, the fields of markers, the next motion and the ledger, in the documented
        schema."""
        data = asdict(replace(self, series=[], marker_fields=[], next_motion=None, ledger=None))
        del data["series"], data["marker_fields"], data["next_motion"], data["ledger"]
        fit = {
            "baseline": data.pop("baseline"),
            "amended": data.pop("amended"),
            "noise_floor": data.pop("noise_floor"),
        }
        return {"schema": SCHEMA, **data, "no_success": self.no_success, "fit": fit}

    def write(self, path: Path) -> None:
        """Write ``diagnosis.json``."""
        path.write_text(json.dumps(self.to_json(), indent=2, allow_nan=False, default=float) + "\n")
