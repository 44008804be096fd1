"""A diagnosis that Ctrl-C ends, and that goes on from the stages that it has kept."""

from __future__ import annotations

import os
import signal
import threading
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_core.effects import effect_by_name
from sim_core.rigs import Rig
from sysid.diagnosis import baseline, candidates
from sysid.diagnosis import diagnose as diagnosing
from sysid.diagnosis.result import Diagnosis
from sysid.io.checkpoints import checkpoints
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Run
from sysid.report import write_diagnosis_report
from tests.conftest import SMALL
from tests.diagnosis.test_whole_diagnosis import LAW, MATERIAL, RIPPLE, SHARE, SIGMA, Sums, gel_rig, read, recording


class Counted(Sums):
    """Counts predictions. ``press_at``: that with which Ctrl-C is pressed; those that run then end."""

    made = 0
    press_at = -1
    ended = False
    _lock = threading.Lock()

    def end(self) -> None:
        Counted.ended = True

    def _told(self, rig: Rig, run: Run, parameters: Any, scaled: np.ndarray, refine: int) -> Future[Prediction]:
        with self._lock:
            Counted.made += 1
            now = Counted.made == Counted.press_at
        if now:
            os.kill(os.getpid(), signal.SIGINT)
        if Counted.ended:
            raise CancelledError
        return super()._told(rig, run, parameters, scaled, refine)

    @staticmethod
    def law(rig: Rig, run: Run, fine: bool) -> np.ndarray:
        return read(rig) + (0.02 * RIPPLE if fine else 0.0)


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch, small_rig: Any) -> Any:
    """Readings that are sums of known shapes, of which gel_relaxation is missing in the rig."""
    noise = {"markers": ChannelNoise(np.full(3, SIGMA), np.zeros(3), "declared by the rig")}
    monkeypatch.setattr(diagnosing, "ParallelPredictor", Counted)
    monkeypatch.setattr(candidates, "all_effects", lambda: {"gel_relaxation": effect_by_name("gel_relaxation")})
    monkeypatch.setattr(baseline, "channel_noise", lambda *_: noise)
    monkeypatch.setattr(baseline, "nuisance_parameters", lambda *_: [])
    monkeypatch.setattr(diagnosing, "provenance", lambda *_: {})
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it
    yield
    signal.signal(signal.SIGINT, before)


def diagnosed(out: Path, press_at: int = -1, notes: list[str] | None = None, **other: object) -> tuple[Any, int, list]:
    """A diagnosis, None where Ctrl-C has ended it, the predictions that it took, and what was known until then."""
    runs = [recording("press", 1.2 * MATERIAL + SHARE * LAW, 1)]
    held = [recording("other", 1.2 * MATERIAL + SHARE * LAW, 2)]
    known: list[Diagnosis] = []
    Counted.made, Counted.press_at, Counted.ended = 0, press_at, False
    say = [].append if notes is None else notes.append
    try:
        with checkpoints(out, {"rig": gel_rig(SMALL), "recordings": ["press"], **other}, say) as kept:
            found, _ = diagnosing.diagnose_runs(gel_rig(SMALL), runs, held, kept=kept, on_known=known.append)
    except KeyboardInterrupt:
        return None, Counted.made, known
    return found, Counted.made, known


def test_a_diagnosis_that_is_interrupted_goes_on_and_comes_to_the_same(toy: Any, tmp_path: Path) -> None:
    whole, all_of_it, known = diagnosed(tmp_path / "whole")
    assert whole.verdict == "named" and not list((tmp_path / "whole").iterdir())
    assert [d.verdict for d in known] == ["unfinished", "unfinished"]
    assert "no effect has been looked at" in known[0].sentence and "no set of effects" in known[1].sentence
    left = []
    for press_at in (6, all_of_it // 2, all_of_it - 4):
        out, notes = tmp_path / str(press_at), list[str]()
        lost, made, known = diagnosed(out, press_at)
        assert lost is None and made < all_of_it
        found, rest, _ = diagnosed(out, notes=notes)
        left.append(rest)
        assert (found.verdict, found.sentence) == (whole.verdict, whole.sentence)
        assert [p.value for p in found.effects[0].parameters] == [p.value for p in whole.effects[0].parameters]
        assert found.posterior == whole.posterior
        assert bool(known) == any("It goes on from" in note for note in notes)
    assert left[0] == all_of_it and sorted(left, reverse=True) == left and left[-1] < 0.4 * all_of_it
    assert write_diagnosis_report(known[-1], tmp_path / "page.html").read_text().count("Not finished") >= 1


def test_stages_of_other_inputs_are_not_taken(toy: Any, tmp_path: Path) -> None:
    _, all_of_it, _ = diagnosed(tmp_path / "whole")
    diagnosed(tmp_path, all_of_it - 1)
    notes: list[str] = []
    found, made, _ = diagnosed(tmp_path, notes=notes, recordings=["press again"])
    assert made == all_of_it and found.verdict == "named"
    assert any("recordings of other contents. It begins anew." in note for note in notes)
