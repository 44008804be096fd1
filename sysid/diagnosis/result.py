"""The diagnosis as data: what ``diagnosis.json`` holds (schema ``thinshell.diagnosis/3``).

``verdict``:

- ``nothing_missing``: most probably, nothing is missing;
- ``named``: most probably, the one to three ``effects`` are;
- ``one_of``: sets as large are too probable for the first to be the only answer;
- ``partly``: ``effects`` are missing, and something that no known effect describes; or readings are missed by far with
  them;
- ``unknown``: most probably, something is missing that no known effect describes;
- ``refine_discretisation``: with an error of mesh and time step twice as uncertain, nothing is missing more probably;
- ``recording_fault``: the recordings themselves are at fault.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.rigs.motion import Experiment
from sysid.comparison.ledger import Ledger
from sysid.diagnosis.verdict import Verdict
from sysid.fit.marker_field import MarkerField
from sysid.fit.result import ChannelError, Series
from sysid.uncertainty.goodness_of_fit import no_success

UNFINISHED = "unfinished"
"""In place of a verdict where a diagnosis is not finished; no file of results says so."""

SCHEMA = "thinshell.diagnosis/3"
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
    """One effect as an explanation. ``place``: where it acts; ``probability``: that it is missing, alone or with
    others; ``log_bayes_factor``: of the set that it was fitted in over nothing missing [nats]; ``held_out_gain``: share
    of the misfit on held-out data that this set removes (None without held-out data); ``explained``: share of the
    misfit beyond noise that is gone with it, of the recordings given."""

    name: str
    title: str
    place: str
    words: str
    probability: float
    parameters: tuple[NamedParameter, ...]
    log_bayes_factor: float
    held_out_gain: float | None
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
class UnreliablePlace:
    """One place of the model, as 'gel', in ``words``, and the ``probability`` that something is missing there, of the
    library or not."""

    place: str
    words: str
    probability: float


@dataclass(frozen=True)
class Misfit:
    """Misfit of one model: mean squared whitened residual on training and held-out data (1 = noise), and
    the errors in measured units."""

    training: float
    held_out: float | None
    errors: tuple[ChannelError, ...]


def missed_multiples(errors: Sequence[ChannelError], held_out: bool) -> dict[str, float]:
    """By how many times their noise quantities of the recordings given, or of those held out, are missed in excess
    of twice the error of mesh and time step, by their names."""
    multiples: dict[str, float] = {}
    for e in errors:
        if e.held_out == held_out and e.after_over_noise is not None:
            words = f"the {e.quantity or 'position'} of {e.channel}"
            excess = float(np.sqrt(max(e.after**2 - (2.0 * e.own) ** 2, 0.0))) / e.noise
            multiples[words] = max(multiples.get(words, 0.0), excess)
    return multiples


@dataclass
class Diagnosis:
    """The answer, what it rests on, and what it leaves open.

    ``posterior``: the sets of causes of the answer and all probabilities; ``upper_limits``: by amplitude, the size that
    an effect has at most (95 %) if it alone is missing, of effects that are not the answer; ``explained``: share of the
    misfit beyond noise that is gone with the answer, of the recordings given; ``places``: where something is missing,
    the most probable first, where that is no effect of the library alone; ``tried``: what became of each effect;
    ``notes``: what a reader should know of the fit; ``next_motion``: the next experiment, where it can be given as a
    motion; ``setups_tried``: mistakes of set-up that were tried first, in words (:mod:`sysid.setup_check`);
    ``ledger``: what the posterior is of; ``parted``: of recordings of replays, the windows [s] in which the watch
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
    places: tuple[UnreliablePlace, ...] = ()
    next_motion: Experiment | None = None
    setups_tried: tuple[str, ...] = ()
    ledger: Ledger | None = None
    posterior: Verdict | None = None
    parted: dict[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)

    @property
    def no_success(self) -> str:
        """What is said first where the model that is found misses the recordings by far more than their noise, twice
        the error of mesh and time step apart; else empty."""
        return no_success(missed_multiples((self.amended or self.baseline).errors, False), self.setups_tried)

    def table(self) -> str:
        """Verdict, notes and numbers as text."""
        lines = [self.no_success, ""] if self.no_success else []
        lines += [self.sentence, *self.notes, ""]
        for run, windows in self.parted.items():
            when = ", ".join(f"{begin:.2f} to {end:.2f} s" for begin, end in windows)
            lines += [f"Replayed, {run} parted from its prediction: {when}. The report opens there.", ""]
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
