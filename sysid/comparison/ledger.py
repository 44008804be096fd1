"""The ledger of a diagnosis: products of all columns of the linearised model, block of time by block of time.

About the point where a baseline stands, whitened residuals y are linear in the parameters of the rig and in the
amplitudes of all effects that it may lack,

    y = J dtheta + D a + C c + E b + e,    e ~ N(0, I),

and in the coefficients c of closures, errors of a place of the model that have no law
(:mod:`sysid.diagnosis.closures`), and b of named approximations (:mod:`sysid.discretisation.approximations`), with the
noise that readings have in common taken out beforehand (:mod:`sysid.solve.variable_projection`). All that a comparison
of models needs are the products of these columns with each other and with y, summed over blocks of time: it can be made
again with other priors, without an effect, or without a part of a recording, and no simulation is run.

Laws are not linear in their amplitudes. Sets of effects that a diagnosis has fitted have ledgers of their own, of the
model linearised where it is fitted with them, in which their parameters are parameters like those of the rig.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sim_core.errors import ThinshellError

SCHEMA = "thinshell/ledger/5"
"""What a file of this layout says that it is."""

BLOCKS = 12
"""Convention: blocks of time of a recording."""


AMPLITUDE, SHAPE = "amplitude", "shape"
"""What a fitted parameter of an effect is, in place of the name of a shape."""

OF_EFFECTS = ("effect", "concealed")
"""Kinds of columns of effects."""


class LedgerError(ThinshellError):
    """A file that is no ledger, or one that cannot be used."""


@dataclass(frozen=True)
class Column:
    """One direction of the linearised model.

    ``kind``: an effect that is ``concealed`` has a shape in which no diagnosis looks at it;
    ``owner``: name of the parameter, of the effect, of the slot of a closure, or of what is approximated; ``place``:
    of the model, that an effect or a closure changes, else empty;
    ``hypothesis``: label of the shape of the effect, all of whose amplitudes belong together, what is off in words for
    a closure, else empty; ``shape``: values of the parameters of an effect that are no
    amplitude; ``name``, ``unit``: of the parameter or amplitude, whose value is ``at`` + factor * ``scale``, in the
    fitted scale (a logarithm where ``log``). The factor has a normal prior with ``prior_mean`` and ``prior_sd``, half
    of one from zero on where ``one_sided``, and the bounds ``lower`` and ``upper``."""

    kind: Literal["parameter", "effect", "concealed", "closure", "approximation"]
    owner: str
    place: str
    hypothesis: str
    shape: Mapping[str, float]
    name: str
    unit: str
    at: float
    scale: float
    log: bool
    prior_mean: float
    prior_sd: float
    one_sided: bool
    lower: float
    upper: float


@dataclass(frozen=True)
class Block:
    """A part of a recording. ``start``, ``end`` [s]; ``readings``: number of readings in it; ``gram`` ``(c + 1, c +
    1)``: products of the whitened columns, with the residual as the last one."""

    recording: str
    start: float
    end: float
    readings: int
    gram: np.ndarray


@dataclass(frozen=True)
class Ledger:
    """``columns``: parameters first, then effects, closures and approximations; ``blocks``: of all recordings;
    ``provenance``: of what it was made; ``amended``: of the same recordings, where sets of effects are fitted."""

    columns: tuple[Column, ...]
    blocks: tuple[Block, ...]
    provenance: Mapping[str, Any]
    amended: tuple[Ledger, ...] = ()

    @property
    def gram(self) -> np.ndarray:
        """Sum over all blocks ``(c + 1, c + 1)``."""
        return np.asarray(np.sum([b.gram for b in self.blocks], axis=0))

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that it has columns of."""
        return tuple(dict.fromkeys(c.owner for c in self.columns if c.kind == "effect"))

    @property
    def readings(self) -> int:
        """Number of readings in all blocks."""
        return sum(b.readings for b in self.blocks)

    @property
    def fitted(self) -> dict[str, str]:
        """Effects that it is linearised with, and their places of the model."""
        return {c.owner: c.place for c in self.columns if c.kind == "parameter" and c.hypothesis}

    @property
    def merged(self) -> Ledger:
        """The ledger with one block of everything."""
        first, last = self.blocks[0], self.blocks[-1]
        whole = Block("all", first.start, last.end, self.readings, self.gram)
        return replace(self, blocks=(whole,), amended=tuple(one.merged for one in self.amended))

    def without(self, effects: Collection[str]) -> Ledger:
        """The ledger as of a library that does not have these effects. Raises ``LedgerError`` for an unknown one."""
        unknown = sorted(set(effects) - set(self.effects))
        if unknown:
            raise LedgerError(
                f"The ledger has no columns of {' and '.join(unknown)}.", f"It has those of {', '.join(self.effects)}."
            )
        amended = tuple(one._less_effects(effects) for one in self.amended if not set(effects) & set(one.fitted))
        return replace(self._less_effects(effects), amended=amended)

    def _less_effects(self, effects: Collection[str]) -> Ledger:
        return self.less([k for k, c in enumerate(self.columns) if c.kind in OF_EFFECTS and c.owner in effects])

    def without_shape(self, effect: str, hypothesis: str) -> Ledger:
        """The ledger as of a library in which this shape of an effect is not looked at."""
        gone = [k for k, c in enumerate(self.columns) if (c.owner, c.hypothesis) == (effect, hypothesis)]
        return self.less(gone)

    def less(self, gone: Collection[int]) -> Ledger:
        """The ledger without columns of these numbers."""
        kept = [k for k in range(len(self.columns)) if k not in gone]
        index = np.array([*kept, len(self.columns)])
        blocks = tuple(replace(b, gram=b.gram[np.ix_(index, index)]) for b in self.blocks)
        return replace(self, columns=tuple(self.columns[k] for k in kept), blocks=blocks)

    def write(self, path: Path) -> None:
        """Write ``ledger.npz``: the Gram matrices as arrays, all else as JSON."""
        parts = (self, *self.amended)
        words = {
            "schema": SCHEMA,
            "ledgers": [
                {
                    "columns": [asdict(c) for c in one.columns],
                    "blocks": [
                        {"recording": b.recording, "start": b.start, "end": b.end, "readings": b.readings}
                        for b in one.blocks
                    ],
                }
                for one in parts
            ],
            "provenance": dict(self.provenance),
        }
        grams = {f"grams_{k}": np.stack([b.gram for b in one.blocks]) for k, one in enumerate(parts)}
        with path.open("wb") as file:
            np.savez_compressed(file, words=np.array(json.dumps(words, default=str)), **grams)  # type: ignore[arg-type]


def read_ledger(path: Path) -> Ledger:
    """Read ``ledger.npz``, or that of the folder of a diagnosis. Raises ``LedgerError`` for anything else."""
    file = path / "ledger.npz" if path.is_dir() else path
    try:
        with np.load(file, allow_pickle=False) as kept:
            words = json.loads(str(kept["words"]))
            if words.get("schema") != SCHEMA:
                raise LedgerError(f"{file} has the layout {words.get('schema')!r}, not {SCHEMA!r}.", "Diagnose again.")
            parts = [_read(one, kept[f"grams_{k}"], file) for k, one in enumerate(words["ledgers"])]
        return replace(parts[0], provenance=words["provenance"], amended=tuple(parts[1:]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile) as error:
        raise LedgerError(
            f"{file} cannot be read as a ledger ({error}).", "Name a ledger.npz, or the folder of a diagnosis."
        ) from error


def _read(words: Mapping[str, Any], grams: np.ndarray, file: Path) -> Ledger:
    columns = tuple(Column(**c) for c in words["columns"])
    if grams.shape != (len(words["blocks"]), len(columns) + 1, len(columns) + 1) or not np.isfinite(grams).all():
        raise LedgerError(f"{file} has products that do not belong to its columns.", "Diagnose again.")
    blocks = tuple(Block(gram=g, **b) for b, g in zip(words["blocks"], grams, strict=True))
    return Ledger(columns, blocks, {})


def blocks_of(
    recording: str, end: float, times: np.ndarray, readings: np.ndarray, rows: np.ndarray, count: int = BLOCKS
) -> list[Block]:
    """Blocks of one recording from whitened ``rows`` ``(n, c + 1)`` of columns and residual at the ``times`` [s]
    ``(n,)``, of which those with ``readings`` ``(n,)`` are no coefficients of an error that was taken out."""
    edges = np.linspace(0.0, max(end, np.finfo(float).tiny), count + 1)
    block = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, count - 1)
    found = []
    for b in range(count):
        mine = rows[block == b]
        number = int(np.count_nonzero(readings[block == b]))
        found.append(Block(recording, float(edges[b]), float(edges[b + 1]), number, mine.T @ mine))
    return found
