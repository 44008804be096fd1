"""Paths of rollouts made before, from which later ones of the same recording start their steps (warm starts).

A fit asks for the same rollout with other numbers again and again. Where bodies are soft solids that are in balance at
each instant, a step has one solution, and the search for it from the path of a rollout near by takes a third of the
factorisations (``warm_start`` of :func:`sim_core.simulate.simulate`). A sheet may have buckled to another side, which a
path would hide, and with inertia velocities lead as near: those are simulated by themselves.

Which rollout a path comes from does not depend on which process is faster: it is the first that was asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from threading import Lock

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig, Sheet
from sim_core.simulate import NodePath
from sysid.model.predictor import Prediction
from sysid.observations.observations import Run
from sysid.settings.model import MODEL


class RolloutPaths:
    """The first rollout of each recording, for each shape of the bodies and each sequence of steps."""

    def __init__(self) -> None:
        self._first: dict[object, Future[Prediction]] = {}
        self._lock = Lock()

    def start(
        self,
        rig: Rig,
        run: Run,
        refine: int,
        dt: float | None,
        begin: Callable[[bool, NodePath | None], Future[Prediction]],
    ) -> Future[Prediction]:
        """Start a rollout by ``begin(keep_path, warm_start)``: the first one keeps its path, which the others wait
        for."""
        if rig.solver.inertia or any(isinstance(body, Sheet) for body in rig.bodies.values()):
            return begin(False, None)
        shapes = repr([(name, getattr(body, "shape", None)) for name, body in rig.bodies.items()])
        steps = None if run.steps is None else run.steps.tobytes()
        key = (run.name, run.since, shapes, refine, dt or rig.solver.dt_s, steps)
        with self._lock:
            first = self._first.get(key)
            if first is None:
                if len(self._first) >= MODEL.kept_paths:
                    self._first.pop(next(iter(self._first)))
                started = self._first[key] = begin(True, None)
                return started
        try:
            return begin(False, first.result().trace.path)
        except (ThinshellError, CancelledError):
            return begin(False, None)
