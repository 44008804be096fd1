"""Predictions for runs and their derivatives, with scenes kept from one evaluation to the next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np

from sim_core.errors import ThinshellError
from sim_core.gradients import Direction, simulate_tangent
from sim_core.gradients.amendments import Amendment, Modulation
from sim_core.gradients.frozen_path import simulate_responses
from sim_core.rigs import Rig
from sim_core.scene import Scene, build_scene
from sim_core.scene.kept import KeptScenes, built_from
from sim_core.simulate import NodePath, Trace, simulate
from sysid.model.marker_registration import placed, placed_along
from sysid.model.parameters import FitParameter, acting_in, fit_parameters, rig_at, rig_in, start_of
from sysid.model.responses import Modulated, SizedEffects, change, way_of, with_effects
from sysid.model.sensor_streams import clock_response, predicted, predicted_derivatives, stream_derivatives
from sysid.model.sequence import LeftBefore, frozen_before
from sysid.model.time_span import after_known_motion, rollout_times
from sysid.observations.observations import Measured, Run
from sysid.progress.rollout_costs import OnStep
from sysid.settings.model import MODEL


@dataclass(frozen=True)
class Prediction:
    """Predictions of one run at its measured stamps, by channel: ``(n, m)`` and, if asked for, their
    derivatives in the fitted scale ``(n, m, p)``; NaN: out of sight, or later than the motion is known
    (:mod:`sysid.model.time_span`). ``trace``: the rollout itself."""

    values: dict[str, np.ndarray]
    derivatives: dict[str, np.ndarray]
    trace: Trace


class SerialPredictor:
    """Evaluates rigs on runs in this process."""

    def __init__(self) -> None:
        self._scenes = KeptScenes()
        self._amended: dict[object, Scene] = {}
        self._left = LeftBefore()

    def predict(
        self,
        rig: Rig,
        run: Run,
        refine: int = 1,
        dt: float | None = None,
        *,
        keep_path: bool = False,
        warm_start: NodePath | None = None,
        on_step: OnStep | None = None,
    ) -> Prediction:
        """Predict one run. ``keep_path``, ``warm_start``, ``on_step``: as of
        :func:`sim_core.simulate.simulate`."""
        scene = self._scenes.of(rig, refine)
        rig = placed(scene, run.firsts)
        scene.use(rig)
        dt = dt or rig.solver.dt_s
        left, times = self._left.of(scene, run, dt, refine), rollout_times([rig], run, dt)
        trace = simulate(scene, run.poses, times, on_step, keep_path=keep_path, warm_start=warm_start, left=left)
        return Prediction(_at_stamps(trace, rig, run), {}, trace)

    def submit(self, rig: Rig, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        """A prediction without derivatives, made at once."""
        return _made(lambda: self.predict(rig, run, refine, dt))

    def submit_with_derivatives(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        refine: int = 1,
        dt: float | None = None,
    ) -> Future[Prediction]:
        """A prediction with derivatives, made at once."""
        return _made(lambda: self.predict_with_derivatives(rig, run, parameters, scaled, refine, dt))

    def predict_all(
        self, rig: Rig, runs: Sequence[Run], parameters: Sequence[FitParameter], scaled: np.ndarray
    ) -> list[Prediction]:
        """Predictions with derivatives of several runs."""
        return [self.predict_with_derivatives(rig, run, parameters, scaled) for run in runs]

    def predict_with_derivatives(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        refine: int = 1,
        dt: float | None = None,
        *,
        keep_path: bool = False,
        warm_start: NodePath | None = None,
        on_step: OnStep | None = None,
    ) -> Prediction:
        """Predict one run at ``scaled`` values of the parameters, with derivatives, which are zero by those that other
        runs have for themselves. ``keep_path``, ``warm_start``, ``on_step``: as of
        :func:`sim_core.simulate.simulate`."""
        own = acting_in(parameters, run.name)
        if len(own) < len(parameters):
            found = self.predict_with_derivatives(
                rig,
                run,
                [parameters[k] for k in own],
                scaled[own],
                refine,
                dt,
                keep_path=keep_path,
                warm_start=warm_start,
                on_step=on_step,
            )
            wide = {c: np.zeros((*d.shape[:-1], len(parameters))) for c, d in found.derivatives.items()}
            for c, d in found.derivatives.items():
                wide[c][..., own] = d
            return replace(found, derivatives=wide)
        scene = self._scenes.of(rig_at(rig, parameters, scaled), refine)
        here = placed(scene, run.firsts)
        scene.use(here)
        along = [_direction(here, parameters, scaled, k) for k in range(len(parameters))]
        along = placed_along(scene, run.firsts, along)
        dt = dt or here.solver.dt_s
        left = self._left.along(scene, run, dt, refine, along)
        times = rollout_times([here, *(end for d in along for end in (d.low, d.high))], run, dt)
        trace, raw = simulate_tangent(
            scene, run.poses, times, along, on_step, keep_path=keep_path, warm_start=warm_start, left=left
        )
        values = _at_stamps(trace, here, run)
        derivatives = {}
        for m in run.measured:
            mechanical = predicted_derivatives(trace, raw[m.channel], here, m.channel, m.t, run.since)
            readings = values[m.channel].reshape(mechanical.shape[:-1])
            total = mechanical + stream_derivatives(trace, along, m.channel, m.t, run.since, readings)
            derivatives[m.channel] = total.reshape(*values[m.channel].shape, len(along))
        return Prediction(values, derivatives, trace)

    def predict_responses(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        candidates: Sequence[SizedEffects],
        modulated: Sequence[Modulated] = (),
        *,
        keep_path: bool = False,
        warm_start: NodePath | None = None,
        on_step: OnStep | None = None,
    ) -> Prediction:
        """As :meth:`predict_with_derivatives`, with the responses of all readings to each of the ``candidates``, then
        to changes of parameters in time, after the derivatives (:mod:`sysid.model.responses`); NaN: one that could not
        be simulated. Changes are in the fitted scale of the parameters."""
        own = acting_in(parameters, run.name)
        scene = self._scenes.of(rig_in(rig, parameters, scaled, run.name))
        here = placed(scene, run.firsts)
        scene.use(here)
        mine = [parameters[k] for k in own]
        along = placed_along(scene, run.firsts, [_direction(here, mine, scaled[own], k) for k in range(len(mine))])
        rigs = [with_effects(here, effects) for effects in candidates]
        ways = [way_of(here, effects, built_from) for effects in candidates]
        steps = [k for k, way in enumerate(ways) if way == "numbers"]
        laws = [k for k, way in enumerate(ways) if way == "law"]
        secants = [Direction(str(k), here, rigs[k], 1.0) for k in steps]
        amendments = [Amendment(str(k), rigs[k], self._with_laws(rigs[k])) for k in laws]
        frozen_before(scene, run, here.solver.dt_s, amendments)
        times = rollout_times([here, *(end for d in along for end in (d.low, d.high)), *rigs], run, here.solver.dt_s)
        changing = fit_parameters(here, list(dict.fromkeys(p.parameter for m in modulated for p in m.parts)))
        at = start_of(here, changing)
        moved = [_direction(here, changing, at, k) for k in range(len(changing))]
        first, names = len(along) + len(secants), [p.name for p in changing]
        courses = [Modulation({first + names.index(p.parameter): p.course for p in m.parts}) for m in modulated]
        whole = [*along, *secants, *moved]
        left = self._left.along(scene, run, here.solver.dt_s, 1, along)
        if left is not None:
            left = left.along(np.arange(len(along)), len(whole))
        trace, raw = simulate_responses(
            scene,
            run.poses,
            times,
            whole,
            amendments,
            courses,
            on_step,
            keep_path=keep_path,
            warm_start=warm_start,
            left=left,
        )
        values = _at_stamps(trace, here, run)
        others: dict[int, dict[str, np.ndarray]] = {}
        for k, way in enumerate(ways):
            if way == "clock":
                late = {m.channel: _late(trace, here, rigs[k], run, m) for m in run.measured}
                others[k] = {c: np.where(np.isfinite(values[c]), np.nan_to_num(v), 0.0) for c, v in late.items()}
            elif way == "reading":
                others[k] = change(_at_stamps(trace, rigs[k], run), values)
            elif way == "rollout":
                try:
                    others[k] = change(self.predict(rigs[k], run, warm_start=warm_start).values, values)
                except ThinshellError:
                    others[k] = {c: np.full_like(v, np.nan) for c, v in values.items()}
        place = {k: len(along) + n for n, k in enumerate(steps)}
        place |= {k: len(whole) + n for n, k in enumerate(laws)}
        derivatives = {}
        for m in run.measured:
            there = values[m.channel]
            mechanical = predicted_derivatives(trace, raw[m.channel], here, m.channel, m.t, run.since)
            readings = there.reshape(mechanical.shape[:-1])
            streams = stream_derivatives(trace, along, m.channel, m.t, run.since, readings)
            flat = mechanical.reshape(*there.shape, -1)
            ends = len(parameters) + np.cumsum([0, len(candidates), len(modulated)])
            out = np.zeros((*there.shape, ends[-1]))
            out[..., ends[1] :] = flat[..., flat.shape[-1] - len(modulated) :]
            out[..., own] = flat[..., : len(along)] + streams.reshape(*there.shape, len(along))
            for k in range(len(candidates)):
                out[..., len(parameters) + k] = flat[..., place[k]] if k in place else others[k][m.channel]
            derivatives[m.channel] = out
        return Prediction(values, derivatives, trace)

    def _with_laws(self, rig: Rig) -> Scene:
        """A scene for the laws of a rig, shared by rigs with the same laws of other sizes."""
        key = (built_from(rig), "laws")
        if key not in self._amended:
            self._amended[key] = build_scene(rig)
        return self._amended[key]

    def submit_responses(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        candidates: Sequence[SizedEffects],
        modulated: Sequence[Modulated] = (),
    ) -> Future[Prediction]:
        """A prediction with responses, made at once."""
        return _made(lambda: self.predict_responses(rig, run, parameters, scaled, candidates, modulated))


def _made(prediction: Callable[[], Prediction]) -> Future[Prediction]:
    future: Future[Prediction] = Future()
    try:
        future.set_result(prediction())
    except ThinshellError as error:
        future.set_exception(error)
    return future


def _direction(rig: Rig, parameters: Sequence[FitParameter], scaled: np.ndarray, k: int) -> Direction:
    """Parameter number ``k`` as a direction in the fitted scale, within its bounds."""
    bounds = parameters[k].scaled_bounds
    ends = [float(np.clip(scaled[k] + s, *bounds)) for s in (-MODEL.rig_difference_step, MODEL.rig_difference_step)]
    rigs = [rig_at(rig, parameters, np.where(np.arange(len(scaled)) == k, end, scaled)) for end in ends]
    return Direction(parameters[k].name, rigs[0], rigs[1], ends[1] - ends[0])


def _at_stamps(trace: Trace, rig: Rig, run: Run) -> dict[str, np.ndarray]:
    """Readings by channel ``(n, m)``; NaN where they show motion that is not known."""
    found = {}
    for m in run.measured:
        values = predicted(trace, rig, m.channel, m.t, run.since).reshape(len(m.t), -1)
        found[m.channel] = np.where(after_known_motion(rig, run, m)[:, None], np.nan, values)
    return found


def _late(trace: Trace, rig: Rig, other: Rig, run: Run, measured: Measured) -> np.ndarray:
    """What the clocks of another rig change in a channel ``(n, m)``."""
    return clock_response(trace, rig, other, measured.channel, measured.t, run.since).reshape(len(measured.t), -1)
