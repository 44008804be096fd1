"""What tests of fits share: worker processes, and rigs that are vectors."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from discretisation_model import Vector

from sysid.fit import fit
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.noise.channel_noise import ChannelNoise


@pytest.fixture(scope="session")
def workers() -> Iterator[ParallelPredictor]:
    with ParallelPredictor(2) as engine:
        yield engine


@pytest.fixture
def vectors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rigs are the parameters themselves (:mod:`discretisation_model`)."""

    def rig_at(rig: Vector, parameters: Any, scaled: np.ndarray, bag: str = "") -> Vector:
        return Vector(scaled if len(scaled) else rig.x)

    for module, name in (("sysid.solve.residuals", "rig_at"), ("sysid.discretisation.refinement", "rig_in")):
        monkeypatch.setattr(f"{module}.{name}", rig_at)
        monkeypatch.setattr(f"{module}.start_of", lambda rig, parameters: rig.x)


@pytest.fixture
def declared(monkeypatch: pytest.MonkeyPatch) -> None:
    """The noise of all channels is known, and nothing of the machine is in results."""
    noise = ChannelNoise(np.array([0.01]), 0.0, "test")
    monkeypatch.setattr(
        fit,
        "channel_noise",
        lambda rig, runs, held_out=(): {m.channel: noise for r in (*runs, *held_out) for m in r.measured},
    )
    monkeypatch.setattr(fit, "provenance", lambda *given: {})
