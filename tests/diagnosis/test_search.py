"""Which sets of effects are fitted, on linear models in place of simulations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sysid.comparison.ledger import AMPLITUDE, Column, Ledger, blocks_of
from sysid.diagnosis import diagnose as diagnosing
from sysid.diagnosis import fitted_sets
from sysid.diagnosis.fitted_sets import FittedSet, SetFits
from sysid.diagnosis.search import leaves_misfit, ledger_with, searched
from sysid.io.checkpoints import Checkpoints
from sysid.settings.diagnosis import DIAGNOSIS

N = 400
T = np.linspace(0.0, 1.0, N)
COURSES = {"lag": np.sin(7.0 * T), "drag": np.cos(9.0 * T), "creep": np.exp(-6.0 * T), "drift": T**2}
PLACES = {"lag": "robot", "drag": "environment", "creep": "sheet", "drift": "wrench"}
SD = 2.0


def ledger(y: np.ndarray, fitted: dict[str, float]) -> Ledger:
    """Of readings of unit noise, linearised where some effects have these sizes."""
    columns, rows = [], []
    for name, size in fitted.items():
        columns.append(
            Column("parameter", name, PLACES[name], AMPLITUDE, {}, "size", "N", size, 1.0, False, -size, SD, False,
                   -np.inf, np.inf)
        )  # fmt: skip
        rows.append(-COURSES[name])
    for name in COURSES.keys() - fitted.keys():
        columns.append(
            Column("effect", name, PLACES[name], "as it is", {}, "size", "N", 0.0, 1.0, False, 0.0, SD, False, -np.inf,
                   np.inf)
        )  # fmt: skip
        rows.append(-COURSES[name])
    left = y - sum((size * COURSES[name] for name, size in fitted.items()), np.zeros(N))
    table = np.column_stack([*rows, left])
    return Ledger(tuple(columns), tuple(blocks_of("run", 1.0, T, np.ones(N, dtype=bool), table, 4)), {})


def fitted_set(y: np.ndarray, sizes: dict[str, float]) -> Any:
    """A set of effects of these sizes, fitted to readings."""
    found = ledger(y, sizes)
    return SimpleNamespace(names=tuple(sizes), ledger=found, misfit=float(found.gram[-1, -1]) / N)


class Fits:
    """Fits of readings that the model of the baseline sees as ``seen``, and that are ``true``."""

    def __init__(self, seen: np.ndarray, true: np.ndarray) -> None:
        self._true = true
        self._seen, self.mistaken = seen, np.zeros(N, dtype=bool)
        self.base = SimpleNamespace(undecided=())
        self.baseline = fitted_set(seen, {})
        self.asked: list[tuple[str, ...]] = []
        self.cleaned: list[tuple[str, ...]] = []
        self.steps_asked: list[tuple[str, ...]] = []
        self.shorter: list[Any] = []
        self.snagged: dict[tuple[str, ...], np.ndarray] = {}
        self.again: list[tuple[tuple[str, ...], tuple[str, ...]]] = []
        self.measured: list[tuple[str, ...]] = []
        self.off: dict[tuple[str, ...], np.ndarray] = {}
        self.simulated = 0

    def _fitted(self, names: tuple[str, ...]) -> Any:
        self.asked.append(names)
        table = np.column_stack([COURSES[n] for n in names])
        sizes = np.linalg.lstsq(table, self._true, rcond=None)[0]
        return fitted_set(self._true + self.snagged.get(names, 0.0), dict(zip(names, sizes, strict=True)))

    def fitted_from(self, one: Any, whole: Any) -> Any:
        self.again.append((one.names, whole.names))
        if not one.names:
            return one
        self.snagged.pop(one.names, None)
        asked = list(self.asked)
        found, self.asked = self._fitted(one.names), asked
        return found

    def fit(self, begun: Any, wanted: Any, temper: float) -> Any:
        return self._fitted(tuple(sorted((*begun.names, *(name for name, _ in wanted[0])))))

    def fit_without(self, begun: Any, effect: str) -> Any:
        return self._fitted(tuple(n for n in begun.names if n != effect))

    def with_error_where_it_stands(self, one: Any) -> Any:
        self.measured.append(one.names)
        asked = list(self.asked)
        self.snagged[one.names] = self.snagged.get(one.names, 0.0) + self.off.get(one.names, 0.0)
        found, self.asked = self._fitted(one.names), asked
        return found

    def without_mistakes_of(self, best: Any, fitted: Any) -> Any:
        self.cleaned.append(best.names)
        if not self.mistaken.any():
            return None
        asked = list(self.asked)
        self._true = np.where(self.mistaken, 0.0, self._true)
        self.baseline = fitted_set(np.where(self.mistaken, 0.0, self._seen), {})
        again = [self.baseline, *(self._fitted(one.names) for one in fitted[1:])]
        self.asked = asked
        return again

    def with_steps_that_it_follows(self, best: Any) -> Any:
        self.steps_asked.append(best.names)
        return self.shorter

    def promising(self, begun: Any, wanted: Any, temper: float, count: int) -> Any:
        self.simulated += 1
        left = [self._left(shapes[0][0]) for shapes in wanted]
        return [wanted[k] for k in np.argsort(left)[:count]]

    def _left(self, name: str) -> float:
        course = COURSES[name]
        rest = self._true - course * (course @ self._true) / (course @ course)
        return float(rest @ rest)


def run(seen: np.ndarray, true: np.ndarray | None = None) -> tuple[Fits, Any, list[Any]]:
    fits = Fits(seen, seen if true is None else true)
    fitted, posterior, _ = searched(cast(SetFits, fits), lambda text: None)
    assert posterior is not None
    return fits, posterior, fitted


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(N)


def test_nothing_is_fitted_where_nothing_is_missing() -> None:
    fits, posterior, fitted = run(noise(1))
    assert not fits.asked and not fits.simulated and len(fitted) == 1
    assert posterior.models[0].effects == ()


def test_an_effect_that_is_less_probable_than_nothing_is_not_fitted() -> None:
    """What is so weak is linear."""
    fits, posterior, _ = run(noise(1) + 0.14 * COURSES["lag"])
    assert posterior.models[0].effects == () and posterior.inclusion["lag"] > DIAGNOSIS.fitted_share
    assert not fits.asked


def test_the_most_probable_effect_is_fitted_and_compared_where_it_is() -> None:
    fits, posterior, _ = run(noise(2) + 3.0 * COURSES["lag"])
    assert fits.asked == [("lag",)]
    assert posterior.models[0].effects == ("lag",) and posterior.models[0].at == 1


def test_of_a_set_of_several_effects_each_part_is_fitted() -> None:
    """What looks like two effects along the baseline is one where it is fitted."""
    rest = noise(3)
    seen, true = rest + 3.0 * COURSES["lag"] + 2.0 * COURSES["creep"], rest + 3.0 * COURSES["lag"]
    fits, posterior, _ = run(seen, true)
    assert fits.asked[0] == ("creep", "lag")
    assert {("lag",), ("creep",)} <= set(fits.asked)
    assert posterior.models[0].effects == ("lag",)


def test_two_effects_are_told_where_both_are_needed() -> None:
    fits, posterior, _ = run(noise(4) + 3.0 * COURSES["lag"] + 2.0 * COURSES["creep"])
    assert posterior.models[0].effects == ("creep", "lag")
    assert len(fits.asked) <= DIAGNOSIS.fitted_sets


def test_where_no_columns_leave_noise_alone_single_effects_are_simulated() -> None:
    """A law whose course along the baseline is another one than where it is fitted."""
    seen = noise(5) + 40.0 * np.sign(np.sin(60.0 * T)) + 3.0 * COURSES["drag"]
    true = noise(5) + 6.0 * COURSES["creep"]
    fits, posterior, fitted = run(seen, true)
    assert leaves_misfit(fitted[0].ledger) and fits.simulated == 1
    assert ("creep",) in fits.asked
    assert "creep" in posterior.models[0].effects


@pytest.mark.parametrize(("square", "left"), [(1.0, False), (1.5, True)])
def test_misfit_that_is_left_is_more_than_chance(square: float, left: bool) -> None:
    y = noise(6)
    assert leaves_misfit(ledger(y * np.sqrt(square / np.mean(y**2)), {})) == left


def test_mistakes_are_looked_for_again_beside_a_set_that_leaves_less() -> None:
    """A reading far off, which what the baseline misses had hidden: all sets go on without it."""
    fits = Fits(wrong := noise(7) + 4.0 * COURSES["lag"] + 20.0 * (np.arange(N) == 7), wrong)
    fits.mistaken = np.arange(N) == 7
    fitted, posterior, others = searched(cast(SetFits, fits), lambda text: None)
    assert fits.cleaned[0] == ("lag",) and others == [] and posterior is not None
    assert posterior.models[0].effects == ("lag",)
    assert next(one.misfit for one in fitted if one.names == ("lag",)) < 1.3
    assert not leaves_misfit(ledger_with(fitted))


def test_what_has_fewer_effects_does_not_lose_by_where_its_search_ended() -> None:
    """The search of one effect ended at a kink, which a second effect passes for."""
    fits = Fits(seen := noise(2) + 4.0 * COURSES["lag"], seen)
    fits.snagged[("lag",)] = 1.1 * COURSES["creep"]
    fitted, posterior, _ = searched(cast(SetFits, fits), lambda text: None)
    assert (("lag",), ("creep", "lag")) in fits.again and len(fits.again) == len(set(fits.again))
    assert posterior is not None and posterior.models[0].effects == ("lag",)
    assert next(one.misfit for one in fitted if one.names == ("lag",)) < 1.2


def test_errors_of_the_mesh_are_measured_where_probable_sets_stand() -> None:
    """Once each, of the best one and of those not far behind, before one is an answer; where they speak against it,
    another one is."""
    far, posterior, _ = run(noise(4) + 3.0 * COURSES["lag"] + 2.0 * COURSES["creep"])
    assert posterior.models[0].effects == ("creep", "lag") and far.measured == [("creep", "lag")]
    near, _, fitted = run(noise(4) + 3.0 * COURSES["lag"] + 0.4 * COURSES["creep"])
    assert len(set(near.measured)) == len(near.measured) == len(fitted) - 1 > 1
    fits = Fits(noise(2) + 0.3 * COURSES["lag"], noise(2) + 0.3 * COURSES["lag"])
    fits.off[("lag",)] = 2.0 * COURSES["drag"]
    _, after, _ = searched(cast(SetFits, fits), lambda text: None)
    assert after is not None and after.models[0].effects != ("lag",) and ("lag",) in fits.measured
    assert not run(noise(1))[0].measured


def test_the_error_of_the_mesh_is_that_of_the_model_with_the_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """A set goes on with the readings of the baseline and with errors of its own; where these were measured where it
    stands, it is not touched."""
    at, engine = np.array([1.0]), "with what the reference adds where it stands"
    own = SimpleNamespace(named="errors of its own", engine=engine)
    fits = SetFits.__new__(SetFits)
    readings = SimpleNamespace(with_named=lambda named: SimpleNamespace(named=named, readings="without mistakes"))
    fits._base = cast(Any, SimpleNamespace(problem=readings, reference="finer cells"))
    fits._kept = Checkpoints()
    one = FittedSet((), cast(Any, own), cast(Any, "fit"), None, cast(Any, None), at)
    asked: list[Any] = []

    def measured_at(found: np.ndarray) -> None:
        def settled(problem: Any, *given: Any) -> Any:
            asked.append((problem.named, problem.engine, problem.readings, *given))
            return "problem", "fitted on", found

        monkeypatch.setattr(fitted_sets, "settled", settled)

    measured_at(at)
    assert fits.with_error_where_it_stands(one) is one
    assert asked == [("errors of its own", engine, "without mistakes", "fit", "finer cells", at)]
    finished: list[Any] = []
    again = replace(one, fitted=cast(Any, "fitted on"))
    fits._finished = lambda *given: finished.append(given) or again  # type: ignore[method-assign, assignment]
    measured_at(np.array([2.0]))
    assert fits.with_error_where_it_stands(one) is again
    assert finished == [("problem", "fitted on", np.array([2.0]), ())]
    fits._finished = lambda *given: "it moves readings out of sight"  # type: ignore[method-assign]
    assert fits.with_error_where_it_stands(one) is one, "what is no model of the recordings any more"


def test_what_is_far_less_probable_is_not_fitted_again() -> None:
    fits, posterior, _ = run(noise(2) + 6.0 * COURSES["lag"])
    assert posterior.models[0].log_bayes_factor > DIAGNOSIS.rival_nats and fits.again == []


@pytest.mark.parametrize("better", [True, False, None])
@pytest.mark.parametrize("names", [(), ("lag",)])
def test_a_set_that_is_fitted_again_is_kept_if_it_leaves_less(
    better: bool | None, names: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It begins where the larger set stands, with its own parameters; the baseline is that of all that follows. One
    that cannot be simulated from there has not failed."""
    modulus, size, other = (SimpleNamespace(target=t) for t in ("sheet.E", "effects.lag.s", "effects.creep.share"))
    own = [modulus] if not names else [modulus, size]
    effect = SimpleNamespace(effect=SimpleNamespace(name="lag"))
    model = SimpleNamespace(parameters=own, scaled=np.zeros(len(own)), centre="rig", residual=np.ones(3))
    problem = cast(Any, "that it was fitted to")
    one = FittedSet((effect,) if names else (), problem, cast(Any, model), None, cast(Any, None))
    larger = SimpleNamespace(parameters=[size, other, modulus], scaled=np.array([2.0, 3.0, 1.0]))
    whole = FittedSet((), problem, cast(Any, larger), None, cast(Any, None))
    found = SimpleNamespace(**{**vars(model), "residual": np.full(3, 0.5 if better else 2.0)})
    fits = SetFits.__new__(SetFits)
    fits._base, fits.baseline, fits.failed, fits._kept = cast(Any, Base("before")), one, {}, Checkpoints()
    begun: list[np.ndarray] = []

    def fitted(start: Any, before: Any, name: str) -> Any:
        begun.append(start.scaled)
        if better is None:
            fits.failed[name] = "could not be simulated"
            return None
        return FittedSet(one.hypotheses, problem, cast(Any, found), None, cast(Any, None))

    def of_baseline() -> FittedSet:
        return FittedSet((), problem, fits._base.fitted, None, cast(Any, None))

    fits._fitted = fitted  # type: ignore[method-assign, assignment]
    fits._without_effects = of_baseline  # type: ignore[method-assign]
    monkeypatch.setattr(fitted_sets, "with_fit", lambda base, fitted: replace(base, fitted=fitted))
    again = fits.fitted_from(one, whole)
    np.testing.assert_array_equal(begun[0], [1.0] if not names else [1.0, 2.0])
    assert (again.fitted is found) == bool(better) and not fits.failed
    assert (fits._base.fitted is found) == (fits.baseline.fitted is found) == bool(better and not names)


@dataclass
class Base:
    """What a baseline has that is changed."""

    fitted: Any


def test_beside_a_set_that_leaves_no_less_nothing_is_looked_for_again() -> None:
    fits, _, _ = run(noise(1))
    assert fits.cleaned == []


@pytest.mark.parametrize("undecided", [False, True])
def test_recordings_that_follow_other_time_steps_begin_anew(undecided: bool) -> None:
    """After the first fits, by the residuals of the set that leaves least, and before any other fit."""
    fits = Fits(seen := noise(2) + 3.0 * COURSES["lag"], seen)
    fits.shorter = cast(Any, ["shorter"])
    if undecided:
        fits.base.undecided = ("run",)
    fitted, _, others = cast(Any, searched)(fits, lambda text: None)
    assert (others, fits.steps_asked) == ((["shorter"], [("lag",)]) if undecided else ([], []))
    assert fits.asked == [("lag",)] and len(fitted) == 2


def test_recordings_that_nothing_explains_are_asked_for_their_steps_beside_the_baseline() -> None:
    """No effect can be simulated, and what is left is no noise."""
    fits = Fits(seen := 1.5 * noise(1), seen)
    fits.shorter, fits.base.undecided = cast(Any, ["shorter"]), ("run",)
    fits.fit = lambda *_: None  # type: ignore[method-assign]
    _, _, others = cast(Any, searched)(fits, lambda text: None)
    assert (others, fits.steps_asked) == (["shorter"], [()])


def test_a_diagnosis_begins_anew_with_other_time_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Any] = []
    long, shorter = (SimpleNamespace(name="rec_01", steps=steps) for steps in (None, np.arange(3.0)))

    def baseline(engine: Any, rig: Any, runs: Any, *_: Any) -> Any:
        given.append(runs)
        return SimpleNamespace(problem=SimpleNamespace(runs=[]), check=SimpleNamespace(runs=[]))

    monkeypatch.setattr(diagnosing, "fit_baseline", baseline)
    monkeypatch.setattr(diagnosing, "recording_scales", lambda runs: None)
    monkeypatch.setattr(
        diagnosing, "SetFits", lambda *_, **__: SimpleNamespace(number=len(given), base=None, baseline=None)
    )
    monkeypatch.setattr(
        diagnosing,
        "searched",
        lambda fits, tell: ([fits], None, [shorter]) if fits.number == 1 else ([fits], "posterior", []),
    )
    search: Any = diagnosing._searched
    work = SimpleNamespace(enter=lambda *words: None, say=lambda text: None)
    found = search("engine", "rig", [long], [], work, Checkpoints(), None)
    fits, fitted, posterior = found
    assert given == [[long], [shorter]] and fits.number == 2 and fitted == [fits] and posterior == "posterior"
