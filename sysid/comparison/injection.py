"""Effects concealed in a ledger, without a rollout: residuals change by the responses that it has columns of.

For effects of sensors, clocks and cameras that is what they do; for effects of the mechanics it is to first order in
the forces that they add. Everything else, the noise of the recordings and what their truth and the rig differ in, is as
it was recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sysid.comparison.ledger import Block, Ledger
from sysid.comparison.posterior import Evidence


@dataclass(frozen=True)
class Injection:
    """``effect`` with the shape ``hypothesis``; ``trace``: what it changes, in standard deviations of the noise, after
    parameters and what careful simulators differ in have taken up what they can."""

    effect: str
    hypothesis: str
    trace: float


def injected(ledger: Ledger, injection: Injection, rng: np.random.Generator) -> Ledger:
    """The ledger of recordings in which the effect acts, its amplitudes drawn in a random direction of their prior."""
    places = [
        k for k, c in enumerate(ledger.columns) if (c.owner, c.hypothesis) == (injection.effect, injection.hypothesis)
    ]
    drawn = rng.standard_normal(len(places)) * [ledger.columns[k].prior_sd for k in places]
    drawn = np.where([ledger.columns[k].one_sided for k in places], np.abs(drawn), drawn)
    alone = Evidence(ledger).trace((injection.effect, injection.hypothesis), drawn)
    change = np.zeros(len(ledger.columns))
    if alone > 0.0:
        change[places] = drawn * injection.trace / alone
    return replace(ledger, blocks=tuple(_moved(b, change) for b in ledger.blocks))


def _moved(block: Block, change: np.ndarray) -> Block:
    """The products with the residual r - C v, for columns C of derivatives of residuals and a change v of readings."""
    gram, n = block.gram.copy(), len(change)
    by = gram[:n, :n] @ change
    gram[n, n] += float(change @ by) - 2.0 * float(change @ gram[:n, n])
    gram[:n, n] -= by
    gram[n, :n] = gram[:n, n]
    return replace(block, gram=gram)
