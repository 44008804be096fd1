"""The whole of a diagnosis, on readings that are sums of known shapes instead of simulations."""

from __future__ import annotations

import copy
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sim_core.effects import effect_by_name
from sim_core.errors import ConfigError, ConvergenceError
from sim_core.rigs import Rig, parse_rig
from sysid.diagnosis import baseline, candidates, held_out
from sysid.diagnosis import diagnose as diagnosing
from sysid.diagnosis.result import Diagnosis
from sysid.discretisation import coarser_cells
from sysid.model.parameters import rig_at
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.discretisation import DISCRETISATION

T, SIGMA, SHARE = np.linspace(0.0, 1.0, 200), 0.01, 0.3
COLUMNS = np.array([1.0, 0.7, 0.4])
MATERIAL, LAW, RIPPLE = (f[:, None] * COLUMNS for f in (np.sin(6.0 * T), np.cos(6.0 * T), np.sin(20.0 * T)))
LAW = np.where(T[:, None] > 0.5, LAW, 0.0)
TRACE = SimpleNamespace(times=np.array([0.0, 1.0]), reports=[SimpleNamespace(contacts=0)])

Law = Callable[[Rig, Run, bool], np.ndarray]
"""Readings of a rig in a run, on a refined mesh or not."""


def strength(rig: Rig) -> float:
    return float(rig.effects.get("gel_relaxation", {}).get("share", 0.0))


def stiffness(rig: Rig) -> float:
    return float(np.log(rig.bodies["gel"].material.E_pa / 1e5))  # type: ignore[union-attr]


def read(rig: Rig) -> np.ndarray:
    return np.asarray(MATERIAL * (1.0 + stiffness(rig)) + strength(rig) * LAW)


class Sums:
    """An engine of a law, with derivatives by differences."""

    law: Law

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def __enter__(self) -> Sums:
        return self

    def __exit__(self, *_: Any) -> None:
        pass

    def end(self) -> None:
        pass

    def submit(self, rig: Rig, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        return self._told(rig, run, [], np.zeros(0), refine)

    def submit_with_derivatives(
        self, rig: Rig, run: Run, parameters: Any, scaled: np.ndarray, refine: int = 1, dt: float | None = None
    ) -> Future[Prediction]:
        return self._told(rig, run, parameters, scaled, refine)

    def submit_responses(
        self, rig: Rig, run: Run, parameters: Any, scaled: np.ndarray, candidates: Any, modulated: Any = ()
    ) -> Future[Prediction]:
        plain = self._told(rig, run, parameters, scaled, 1).result()
        here = rig_at(rig, parameters, scaled)
        columns = []
        for effects in candidates:
            there = here.model_copy(update={"effects": {**here.effects, **effects}})
            columns.append(np.nan_to_num(type(self).law(there, run, False) - plain.values["markers"]))
        columns += [np.zeros_like(plain.values["markers"]) for _ in modulated]
        derivatives = np.concatenate([plain.derivatives["markers"], np.stack(columns, axis=-1)], axis=-1)
        future: Future[Prediction] = Future()
        future.set_result(Prediction(plain.values, {"markers": derivatives}, plain.trace))
        return future

    def predict_all(self, rig: Rig, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        return [self._told(rig, run, parameters, scaled, 1).result() for run in runs]

    def _told(self, rig: Rig, run: Run, parameters: Any, scaled: np.ndarray, refine: int) -> Future[Prediction]:
        future: Future[Prediction] = Future()

        def at(values: np.ndarray) -> np.ndarray:
            return type(self).law(rig_at(rig, parameters, values) if len(parameters) else rig, run, refine > 1)

        try:
            values = at(scaled)
            steps = 1e-5 * np.eye(len(parameters))
            slopes = [(at(scaled + step) - at(scaled - step)) / 2e-5 for step in steps]
        except ConvergenceError as error:
            future.set_exception(error)
            return future
        derivatives = {"markers": np.stack(slopes, axis=2)} if slopes else {}
        future.set_result(Prediction({"markers": values}, derivatives, TRACE))  # type: ignore[arg-type]
        return future


def gel_rig(small: dict[str, Any]) -> Rig:
    """The gel and its markers alone."""
    data = copy.deepcopy(small)
    data["bodies"].pop("card")
    data["sensors"].pop("wrench")
    data.pop("cameras")
    return parse_rig({**data, "clamps": [], "contacts": data["contacts"][1:]}, "gel")


def recording(name: str, values: np.ndarray, seed: int) -> Run:
    data = values + SIGMA * np.random.default_rng(seed).standard_normal(values.shape)
    return Run(name, name, (name,), {}, (Measured("markers", "markers", T, data, ("u", "v", "w")),), 1.0)  # type: ignore[arg-type]


@pytest.fixture
def diagnose(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Diagnosis]:
    from tests.conftest import SMALL

    def diagnosed(
        law: Law,
        *,
        concealed: float = SHARE,
        held: float = SHARE,
        rig: Rig | None = None,
        given: int = 1,
        hum: np.ndarray | float = 0.0,
    ) -> Diagnosis:
        """``given``: recordings; with more than one, none is held out."""
        monkeypatch.setattr(Sums, "law", staticmethod(law), raising=False)
        monkeypatch.setattr(diagnosing, "ParallelPredictor", Sums)
        monkeypatch.setattr(candidates, "all_effects", lambda: {"gel_relaxation": effect_by_name("gel_relaxation")})
        noise = {"markers": ChannelNoise(np.full(3, SIGMA), np.zeros(3), "declared by the rig")}
        monkeypatch.setattr(baseline, "channel_noise", lambda *_: noise)
        monkeypatch.setattr(baseline, "nuisance_parameters", lambda *_: [])
        monkeypatch.setattr(diagnosing, "provenance", lambda *_: {})
        names = ["press", *(f"press {k}" for k in range(2, given + 1))]
        runs = [recording(name, 1.2 * MATERIAL + concealed * LAW + hum, 1 + 10 * k) for k, name in enumerate(names)]
        others = [recording("other", 1.2 * MATERIAL + held * LAW, 2)] if given == 1 else []
        found, _ = diagnosing.diagnose_runs(rig or gel_rig(SMALL), runs, others)
        return found

    return diagnosed


def test_a_law_that_is_missing_is_named_where_it_acts(diagnose: Callable[..., Diagnosis]) -> None:
    """It acts in the second half of the run, wherever noise is left; where it is not, nothing is named."""

    def law(rig: Rig, run: Run, fine: bool) -> np.ndarray:
        return read(rig) + (0.02 * RIPPLE if fine else 0.0)

    found = diagnose(law)
    assert found.verdict == "named" and found.effects[0].name == "gel_relaxation"
    (share,) = (p for p in found.effects[0].parameters if p.name.endswith("share"))
    assert share.ci95[0] < SHARE < share.ci95[1]
    windows = found.located.windows["press"]
    assert windows[0][0] == pytest.approx(0.5, abs=0.05) and windows[-1][1] == pytest.approx(1.0, abs=0.05)
    assert "more than 99 % of the misfit beyond noise is gone" in found.sentence
    assert found.amended is not None and found.amended.held_out < found.baseline.held_out
    assert diagnose(law, concealed=0.0, held=0.0).verdict == "nothing_missing"


@pytest.mark.parametrize(("given", "kept"), [(2, None), (3, "press 3")])
def test_of_three_recordings_the_last_is_held_out_where_none_is(
    diagnose: Callable[..., Diagnosis], given: int, kept: str | None
) -> None:
    found = diagnose(lambda rig, run, fine: read(rig) + (0.02 * RIPPLE if fine else 0.0), given=given)
    assert found.verdict == "named"
    assert (found.baseline.held_out is None) == (kept is None)
    assert any(f"{kept} was held out" in note for note in found.notes) == (kept is not None)


@pytest.mark.parametrize("own", [0.1, 0.15])
def test_an_answer_is_not_judged_by_a_discretisation_error_that_it_makes_smaller(
    diagnose: Callable[..., Diagnosis], own: float
) -> None:
    """With a smaller discretisation error the same held-out readings weigh more, for the baseline as well."""

    def law(rig: Rig, run: Run, fine: bool) -> np.ndarray:
        return read(rig) + ((own * (1.0 - strength(rig) / SHARE) + 0.02) * RIPPLE if fine else 0.0)

    found = diagnose(law)
    assert found.verdict == "named", found.sentence
    assert found.effects[0].held_out_gain is not None and found.effects[0].held_out_gain > 0.0
    # The misfits that are reported are those that were compared.
    assert found.amended is not None and found.amended.held_out is not None and found.baseline.held_out is not None
    assert found.amended.held_out < found.baseline.held_out


def test_recordings_that_cannot_tell_their_time_steps_are_named(
    diagnose: Callable[..., Diagnosis], monkeypatch: pytest.MonkeyPatch
) -> None:
    """They keep those of the rig, which a reader has to know."""
    plain = diagnosing.fit_baseline
    monkeypatch.setattr(diagnosing, "fit_baseline", lambda *a, **k: replace(plain(*a, **k), undecided=("press",)))
    found = diagnose(lambda rig, run, fine: read(rig) + (0.02 * RIPPLE if fine else 0.0))
    assert any(n.startswith("press: the time steps are those of the rig") and "solver.dt_s" in n for n in found.notes)


def test_an_effect_that_hides_readings_explains_nothing(diagnose: Callable[..., Diagnosis]) -> None:
    """The last fifth of the readings is off, and out of sight with the effect."""

    def law(rig: Rig, run: Run, fine: bool) -> np.ndarray:
        values = MATERIAL * (1.0 + stiffness(rig)) + (0.001 * RIPPLE if fine else 0.0)
        return np.where((T[:, None] > 0.8) & (strength(rig) > 0.0), np.nan, values)

    found = diagnose(law)
    assert found.verdict == "unknown" and not found.effects


def test_the_baseline_goes_on_beside_the_discretisation_error_measured_last(
    diagnose: Callable[..., Diagnosis],
) -> None:
    def law(rig: Rig, run: Run, fine: bool) -> np.ndarray:
        if fine and stiffness(rig) > 0.1 and run.name == "press":
            raise ConvergenceError("The fine mesh does not converge.", "Use another.")
        return read(rig) + (0.02 * RIPPLE if fine else 0.0)

    found = diagnose(law, concealed=0.0, held=0.0)
    assert found.verdict == "nothing_missing"
    assert any("The baseline fit did not converge" in note for note in found.notes)


@pytest.mark.parametrize(("size", "verdict"), [(6.0, "partly"), (1.0, "partly"), (0.1, "named")])
def test_what_leaves_more_than_noise_is_a_part_of_the_answer(
    size: float, verdict: str, diagnose: Callable[..., Diagnosis]
) -> None:
    """A hum that nothing describes, too quick for anything that goes by the motion."""

    def law(rig: Rig, run: Run, fine: bool) -> np.ndarray:
        return read(rig) + (0.02 * RIPPLE if fine else 0.0)

    hum = size * SIGMA * np.sign(np.sin(400.0 * T))[:, None] * COLUMNS
    found = diagnose(law, hum=hum)
    assert found.verdict == verdict and found.effects[0].name == "gel_relaxation", found.sentence
    assert ("Something else is missing" in found.sentence) == (verdict == "partly")


def test_what_the_mesh_may_hide_asks_for_finer_cells(
    diagnose: Callable[..., Diagnosis], monkeypatch: pytest.MonkeyPatch
) -> None:
    """When that is so: tests/diagnosis/test_verdict.py."""
    monkeypatch.setattr(diagnosing, "hidden_by_mesh", lambda _: True)
    found = diagnose(lambda rig, run, fine: read(rig) + (0.02 * RIPPLE if fine else 0.0))
    assert found.verdict == "refine_discretisation" and not found.effects
    assert "Refine the mesh or the time step" in found.sentence
    assert [c.name for c in found.alternatives] == ["gel_relaxation"]


@pytest.mark.parametrize("at_once", [False, True])
@pytest.mark.parametrize("lost", ["shifted", "home"])
def test_a_fit_begins_where_one_of_its_starts_can_be_simulated(
    diagnose: Callable[..., Diagnosis], monkeypatch: pytest.MonkeyPatch, lost: str, at_once: bool
) -> None:
    """The baseline has a stiffness of its own, 18 % above that of the rig. With the law, simulations at one of the two
    do not end before one at the other has, or do not begin, as where the law acts on nothing."""
    begun, submit = [False], Sums.submit

    def one_is_lost(engine: Sums, rig: Rig, run: Run, *rest: Any) -> Future[Prediction]:
        start = "home" if abs(stiffness(rig)) < 0.05 else "shifted"
        if strength(rig) > 0.0 and start == lost and not begun[0]:
            if at_once:
                raise ConfigError("It acts on nothing.", "Remove it.")
            future: Future[Prediction] = Future()
            future.set_exception(ConvergenceError("It does not converge.", "Begin elsewhere."))
            return future
        begun[0] = begun[0] or strength(rig) > 0.0
        return submit(engine, rig, run, *rest)

    monkeypatch.setattr(Sums, "submit", one_is_lost)
    assert diagnose(lambda rig, run, fine: read(rig) + (0.02 * RIPPLE if fine else 0.0)).verdict == "named"


def test_the_ledger_of_a_fitted_set_has_the_derivatives_where_it_stands(diagnose: Callable[..., Diagnosis]) -> None:
    """Of a law that is quadratic in its size, and not those of where the search was before."""

    def law(rig: Rig, run: Run, fine: bool) -> np.ndarray:
        s = strength(rig)
        straight = T[:, None] * COLUMNS  # an error that does not jump from reading to reading
        return MATERIAL * (1.0 + stiffness(rig)) + (s + 3.0 * s**2) * LAW + (0.02 * straight if fine else 0.0)

    found = diagnose(law, concealed=SHARE + 3.0 * SHARE**2)
    assert found.ledger is not None and found.verdict == "named", found.sentence
    (there,) = found.ledger.amended
    share, tau = (k for k, c in enumerate(there.columns) if c.owner == "gel_relaxation" and c.kind == "parameter")
    column = next(c for c in there.columns if c.kind == "parameter" and c.name.endswith("share"))
    slope = (1.0 + 6.0 * column.at) * np.linalg.norm(LAW) / SIGMA
    assert np.sqrt(there.gram[share, share]) == pytest.approx(slope, rel=1e-6)
    assert there.gram[tau, tau] == 0.0, "nothing depends on it"


def test_held_out_recordings_of_which_nothing_is_in_sight_decide_nothing(diagnose: Callable[..., Diagnosis]) -> None:
    def law(rig: Rig, run: Run, fine: bool) -> np.ndarray:
        values = read(rig) + (0.02 * RIPPLE if fine else 0.0)
        return np.full_like(values, np.nan) if run.name == "other" else values

    found = diagnose(law)
    assert found.verdict == "named" and found.effects[0].held_out_gain is None


def test_what_is_not_known_of_parameters_is_not_missing_in_recordings_held_out(
    diagnose: Callable[..., Diagnosis],
) -> None:
    """The recording that is given hardly depends on the stiffness, by which the one held out is off."""

    def law(rig: Rig, run: Run, fine: bool) -> np.ndarray:
        values = MATERIAL * ((1.0 if run.name == "other" else 1.2) + stiffness(rig) * (run.name == "other" or 1e-3))
        return values + strength(rig) * LAW + (0.02 * RIPPLE if fine else 0.0)

    found = diagnose(law, concealed=0.0, held=0.0)
    assert found.verdict == "nothing_missing", found.sentence
    assert any("tells nothing for or against the model" in note for note in found.notes)
    found = diagnose(law, concealed=0.0, held=SHARE)
    assert found.verdict == "unknown"
    assert not any("tells nothing for or against the model" in note for note in found.notes)


def test_windows_held_out_that_begin_in_motion_decide_nothing(
    diagnose: Callable[..., Diagnosis], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody knows the velocities with which they begin, so what they miss is no sign of missing physics."""

    def law(rig: Rig, run: Run, fine: bool) -> np.ndarray:
        return read(rig) + (0.02 * RIPPLE if fine else 0.0)

    assert diagnose(law, concealed=0.0, held=SHARE).verdict == "unknown"
    moving = lambda _, run: ["It moves."] if run.name == "other" else []  # noqa: E731
    monkeypatch.setattr(held_out, "not_from_rest", moving)
    found = diagnose(law, concealed=0.0, held=SHARE)
    assert found.verdict == "nothing_missing"
    assert any("other is left out" in note and "It moves." in note for note in found.notes)


def test_only_what_the_rig_may_lack_is_counted(diagnose: Callable[..., Diagnosis]) -> None:
    """There is no sheet, and relaxation is in the rig."""
    from tests.conftest import SMALL

    rig = gel_rig(SMALL).model_copy(update={"effects": {"gel_relaxation": {"share": 0.1, "tau_s": 0.2}}})
    found = diagnose(lambda rig, run, fine: read(rig), concealed=0.1, held=0.1, rig=rig)
    assert "gel_relaxation" not in found.tried and "bending_plasticity" not in found.tried
    assert f"{len(found.tried)} effects were looked for" in found.sentence


@pytest.mark.parametrize("share", [0.0, SHARE])
def test_a_rig_with_many_cells_is_searched_with_few_and_judged_with_its_own(
    diagnose: Callable[..., Diagnosis], monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    """The error of cells goes with their square; recordings follow those of the rig, which are never differentiated."""
    from tests.conftest import SMALL

    rig = gel_rig(SMALL)
    gel = rig.bodies["gel"]
    shape = gel.shape.model_copy(update={"cells": (4, 4, 4)})  # type: ignore[union-attr]
    rig = rig.model_copy(update={"bodies": {**rig.bodies, "gel": gel.model_copy(update={"shape": shape})}})
    monkeypatch.setattr(coarser_cells, "DISCRETISATION", replace(DISCRETISATION, searched_nodes=200))
    differentiated: set[int] = set()
    submit = Sums.submit_with_derivatives

    def cells(there: Rig) -> int:
        return int(there.bodies["gel"].shape.cells[0])  # type: ignore[union-attr]

    def counted(engine: Sums, there: Rig, *rest: Any) -> Future[Prediction]:
        differentiated.add(cells(there))
        return submit(engine, there, *rest)

    monkeypatch.setattr(Sums, "submit_with_derivatives", counted)

    def law(there: Rig, run: Run, fine: bool) -> np.ndarray:
        return read(there) + 0.4 * (1.0 / cells(there) ** 2 - 1.0 / 16.0) * RIPPLE

    found = diagnose(law, concealed=share, held=share, rig=rig)
    assert found.verdict == ("named" if share else "nothing_missing"), found.sentence
    assert any("2 x 2 x 2 cells of gel" in note and "4 x 4 x 4" in note for note in found.notes)
    assert differentiated <= {2}
