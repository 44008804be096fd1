"""Which rollouts are warm-started from which."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sim_core.rigs import Rig, load_rig
from sim_core.simulate import NodePath
from sysid.model.predictor import Prediction
from sysid.model.rollout_paths import RolloutPaths
from sysid.observations.observations import Run
from sysid.settings.model import MODEL

RUN = Run("press", "", (), {}, (), 1.0)


@pytest.fixture(scope="module")
def rig() -> Rig:
    given = load_rig("gel_sensor")
    return given.model_copy(update={"solver": given.solver.model_copy(update={"inertia": False})})


class Rollouts:
    """Rollouts that are done at once; ``asked``: for each, whether it keeps its path, and which path it starts from."""

    def __init__(self) -> None:
        self.asked: list[tuple[bool, NodePath | None]] = []
        self.fail = False

    def __call__(self, keep_path: bool, warm_start: NodePath | None) -> Future[Prediction]:
        self.asked.append((keep_path, warm_start))
        future: Future[Prediction] = Future()
        if self.fail:
            future.set_exception(ConvergenceError("It does not converge.", "Use shorter steps."))
        else:
            path = NodePath(np.zeros(1), np.full((1, 3, 3), len(self.asked)))
            future.set_result(cast(Prediction, SimpleNamespace(trace=SimpleNamespace(path=path))))
        return future


def test_later_rollouts_of_a_recording_start_from_the_path_of_the_first(rig: Rig) -> None:
    paths, begin = RolloutPaths(), Rollouts()
    for given in (rig, rig.model_copy(update={"effects": {"gel_relaxation": {}}})):
        paths.start(given, RUN, 1, None, begin)
    assert begin.asked[0] == (True, None)
    keep, warm_start = begin.asked[1]
    assert not keep and warm_start is not None and warm_start.positions[0, 0, 0] == 1.0


@pytest.mark.parametrize("other", ["run", "refine", "step", "steps", "shape"])
def test_rollouts_of_something_else_have_paths_of_their_own(rig: Rig, other: str) -> None:
    paths, begin = RolloutPaths(), Rollouts()
    paths.start(rig, RUN, 1, None, begin)
    gel = rig.bodies["gel"]
    finer = gel.model_copy(update={"shape": gel.shape.model_copy(update={"cells": (6, 6, 2)})})
    paths.start(
        rig.model_copy(update={"bodies": {**rig.bodies, "gel": finer}}) if other == "shape" else rig,
        replace(RUN, name="rub") if other == "run" else replace(RUN, steps=np.arange(3.0)) if other == "steps" else RUN,
        2 if other == "refine" else 1,
        0.01 if other == "step" else None,
        begin,
    )
    assert begin.asked == [(True, None)] * 2


def test_what_may_take_another_branch_is_simulated_by_itself(rig: Rig) -> None:
    paths, begin = RolloutPaths(), Rollouts()
    for given in (load_rig("gel_sensor"), load_rig("strip_pull")):
        for _ in range(2):
            paths.start(given, RUN, 1, None, begin)
    assert begin.asked == [(False, None)] * 4


def test_a_first_rollout_that_fails_fails_no_other_one(rig: Rig) -> None:
    paths, begin = RolloutPaths(), Rollouts()
    begin.fail = True
    failed = paths.start(rig, RUN, 1, None, begin)
    begin.fail = False
    assert paths.start(rig, RUN, 1, None, begin).result() and begin.asked[1] == (False, None)
    with pytest.raises(ConvergenceError):
        failed.result()


def test_so_many_paths_are_kept_at_most(rig: Rig) -> None:
    paths, begin = RolloutPaths(), Rollouts()
    for k in range(MODEL.kept_paths + 1):
        paths.start(rig, replace(RUN, name=str(k)), 1, None, begin)
    paths.start(rig, replace(RUN, name=str(MODEL.kept_paths)), 1, None, begin)
    paths.start(rig, replace(RUN, name="0"), 1, None, begin)
    assert [keep for keep, _ in begin.asked[-2:]] == [False, True]
