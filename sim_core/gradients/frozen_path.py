"""Responses of a rollout to amendments of finite size, along its frozen path.

A law with a threshold (yield, static friction, pull-off) has no derivative where it vanishes, and a rollout for each
law and each size costs too much to look at a library of them. The amended law is therefore evaluated at its finite size
on the path x_n that the baseline has taken, with its own internal variables carried along that path,

    dF_n = F'(x_n; x_{n-1}, z'_{n-1}) - F(x_n; x_{n-1}, z_{n-1}),

and dF_n is propagated by the linearised steps of the baseline, whose factors are there already: one evaluation of the
law and one back-substitution a step, instead of a rollout. The result is exact to first order in dF and of any order in
the size of the law on the given path (a secant, not a derivative). What the law would change by taking another path, a
contact made or lost for one, is left out.

A parameter may also change in time: a modulus E (1 + a f(t)), a hand that is off by a f(t). What that does is the
parameter's derivative of each step, weighed by the course f at its end.

An end effector that gives way moves by its compliance times the load that the baseline puts on it, which is propagated
like any motion of a mount. All of these are columns of the core next to the derivatives (:mod:`sim_core.core.amended`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sim_core.core.amended import Followed
from sim_core.core.rollout import CoreRollout, tell, trace_of
from sim_core.core.slopes import Modulations, NumberSlopes
from sim_core.gradients.amendments import Amendment, Modulation
from sim_core.gradients.directions import Direction, slopes
from sim_core.gradients.tangent import boundary_motions, differentiated, start_of
from sim_core.permanent_state import PermanentState
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Scene
from sim_core.solve.report import NewtonSettings
from sim_core.trace import NodePath, Trace


def simulate_responses(
    scene: Scene,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    along: Sequence[Direction],
    amendments: Sequence[Amendment],
    modulations: Sequence[Modulation] = (),
    on_step: Callable[[int, int], None] | None = None,
    *,
    keep_path: bool = False,
    warm_start: NodePath | None = None,
    left: PermanentState | None = None,
) -> tuple[Trace, dict[str, np.ndarray]]:
    """Trace of a rollout, and for every channel ``(n_times, ..., n_along + n_amendments + n_modulations)``: its
    derivatives by the directions, then its responses to the amendments, then to the modulations.

    A direction may also be of finite width, from the baseline to a rig with other numbers or commands; its derivative
    is then the secant in these numbers, and to first order in what they do. Times [s] ``(n_times,)``.
    ``keep_path``, ``warm_start``, ``left``: as of :func:`sim_core.gradients.tangent.simulate_tangent`, without
    derivatives by what comes after ``along``.
    """
    first = len(along)
    whole = [*along, *_idle(scene.rig, len(amendments) + len(modulations))]
    moving = boundary_motions(scene, poses, times, whole)
    keys, table = slopes(scene, whole)
    sums = _sums(modulations, first + len(amendments), times - times[0])
    for of, to in zip(sums.of, sums.to, strict=True):  # which numbers the sums have
        table[:, to] += np.abs(table[:, of])
    rollout = CoreRollout(scene, poses, times, NewtonSettings(), NumberSlopes(keys, table, sums), _mixed(moving, sums))
    if left is not None:
        left = left.along(np.arange(first), len(whole))
    start = start_of(rollout, moving[0], len(whole), left)
    mounts = list(scene.start)
    for column, amendment in enumerate(amendments, first):
        differs, compliance = amendment.differences(scene)
        if differs:
            Followed(amendment.scene, rollout, column, left, amendment.kept)
        for mount, given in compliance.items():
            rollout.give_way(mounts.index(mount), scene.carried(mount), given, column)
    return differentiated(rollout, whole, start, on_step, keep_path=keep_path, warm_start=warm_start, left=left)


def let_remember(
    scene: Scene,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    amendments: Sequence[Amendment],
    left: PermanentState | None = None,
) -> Trace:
    """A rollout along the path of which ``amendments`` remember, without a response to them; what lasts of that is
    :attr:`Amendment.kept`. ``left``: what an earlier rollout has left of the bodies."""
    rollout = CoreRollout(scene, poses, times, NewtonSettings())
    followed = []
    for amendment in amendments:
        amendment.differences(scene)
        followed.append(Followed(amendment.scene, rollout, None, left, amendment.kept))
    tell(scene, rollout, rollout.settle(left=left), None)
    for chunk in rollout.run():
        tell(scene, rollout, chunk, None)
    for amendment, own in zip(amendments, followed, strict=True):
        amendment.kept = own.lasting()
    return trace_of(rollout, {}, [])


def _idle(rig: Rig, count: int) -> list[Direction]:
    """Directions along which no number of the rig changes."""
    return [Direction(f"response {k}", rig, rig, 1.0) for k in range(count)]


def _sums(modulations: Sequence[Modulation], first: int, times: np.ndarray) -> Modulations:
    """Columns from the ``first`` on as sums of those of directions, with the courses at the ``times`` [s]."""
    columns = enumerate(modulations, first)
    entries = [(direction, to, course) for to, m in columns for direction, course in m.courses.items()]
    weights = np.array([course(times) for _, _, course in entries]).reshape(len(entries), len(times)).T
    of, to = (np.array([entry[k] for entry in entries], dtype=int) for k in (0, 1))
    return Modulations(of, to, np.ascontiguousarray(weights))


def _mixed(moving: Sequence[Mapping[str, np.ndarray]], sums: Modulations) -> Sequence[Mapping[str, np.ndarray]]:
    """Motions of mounts at all times, or one, all the time, with those of the columns that are sums."""
    if not any(moving) or not len(sums.of):
        return moving
    out = []
    for k, weights in enumerate(sums.weights):
        mixed = {name: motion.copy() for name, motion in moving[k if len(moving) > 1 else 0].items()}
        for motion in mixed.values():
            np.add.at(motion.T, sums.to, (motion[:, sums.of] * weights).T)
        out.append(mixed)
    return out
