"""Effects concealed in a ledger, without a rollout: residuals change by the responses that it has columns of.

For effects of sensors, clocks and cameras that is what they do; for effects of the mechanics it is to first order in
the forces that they add. Everything else, the noise of the recordings and what their truth and the rig differ in, is as
it was recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sysid.comparison.evidence import residual_products
from sysid.comparison.ledger import Block, Column, Ledger

LARGEST = 3.0
"""Convention: largest amplitude that is concealed, in standard deviations of its prior: what physics allows."""


@dataclass(frozen=True)
class Injection:
    """``effect`` with the shape ``hypothesis``; ``trace``: what it changes, in standard deviations of the noise, after
    parameters and what careful simulators differ in have taken up what they can."""

    effect: str
    hypothesis: str
    trace: float


class Concealer:
    """What may be concealed in a ledger. ``shapes``: by effect, those in which it may be: drawn ones that no diagnosis
    looks at where the ledger has columns of them, else all that are looked at."""

    def __init__(self, ledger: Ledger) -> None:
        self._columns = ledger.columns
        self._places = np.array([k for k, c in enumerate(ledger.columns) if c.kind in ("effect", "concealed")])
        self._information = residual_products(ledger, self._places)
        self.shapes: dict[str, list[str]] = {}
        drawn = {c.owner for c in ledger.columns if c.kind == "concealed"}
        for k in self._places:
            c = ledger.columns[k]
            mine = self.shapes.setdefault(c.owner, [])
            if c.hypothesis not in mine and (c.kind == "concealed") == (c.owner in drawn):
                mine.append(c.hypothesis)

    def change(self, injection: Injection, rng: np.random.Generator) -> np.ndarray | None:
        """Factors of all columns ``(c,)``, those of the effect in a random direction of their prior; None where so
        large a trace takes amplitudes beyond what physics allows."""
        kind = "concealed" if any(c.kind == "concealed" and self._is(c, injection) for c in self._columns) else "effect"
        mine = [k for k, c in enumerate(self._columns) if c.kind == kind and self._is(c, injection)]
        sd = np.array([self._columns[k].prior_sd for k in mine])
        drawn = rng.standard_normal(len(mine))
        drawn = sd * np.where([self._columns[k].one_sided for k in mine], np.abs(drawn), drawn)
        at = np.searchsorted(self._places, mine)
        alone = float(np.sqrt(max(drawn @ self._information[np.ix_(at, at)] @ drawn, 0.0)))
        if injection.trace * np.max(np.abs(drawn) / sd) > LARGEST * alone:
            return None
        change = np.zeros(len(self._columns))
        change[mine] = drawn * injection.trace / alone
        return change

    @staticmethod
    def _is(column: Column, injection: Injection) -> bool:
        return (column.owner, column.hypothesis) == (injection.effect, injection.hypothesis)


def injected(ledger: Ledger, change: np.ndarray) -> Ledger:
    """The ledger of readings that are changed by factors ``(c,)`` of its columns."""
    return replace(ledger, blocks=tuple(_moved(b, change) for b in ledger.blocks))


def _moved(block: Block, change: np.ndarray) -> Block:
    """The products with the residual r - C v, for columns C of derivatives of residuals and a change v of readings."""
    gram, n = block.gram.copy(), len(change)
    by = gram[:n, :n] @ change
    gram[n, n] += float(change @ by) - 2.0 * float(change @ gram[:n, n])
    gram[:n, n] -= by
    gram[n, :n] = gram[:n, n]
    return replace(block, gram=gram)
