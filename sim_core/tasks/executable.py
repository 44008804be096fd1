"""Actions that hands can execute: those that keep to the limits of speed, acceleration and jerk that the rig gives.

An action asks for velocities at knots. With the curve that is replayed, a cubic spline through the poses at the steps,
the velocity, the acceleration and the jerk of a hand are linear in it: q_m(t) = D_m(t) a, m = 1, 2, 3. What asks for
too much is scaled down as a whole, turns first,

    w' = s_w w,   s_w = min(1, min_mt L^w_m / |D_m w|),
    v' = s_v v,   s_v = min(1, min_mt (L_m - R_m(w')) / (|D_m v| + |D_m c|)),

v and c the translation and the closing of a hand, w its turn, and R_m what a turn adds at a finger at the distance r of
the hand's centre: |omega| r; |alpha| r + |omega|^2 r; |jerk| r + 3 |omega| |alpha| r + |omega|^3 r (of these, the last
two at their limits). So an action within
the limits stays what it is, and each motion within them is that of an action. A profile that is constant between knots
changes velocities at once, which no limit of the acceleration allows: it stays what it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from sim_core.rigs.limits import JERK_S, HandLimits

FINE_S = 0.001
"""Interval [s] at which the curve is looked at."""

RESERVE = 0.05
"""Share of the limits that is left for what is not linear: turns that follow each other, and splines of quaternions."""


@dataclass(frozen=True)
class HandSpan:
    """One hand of a task. ``bounds`` ``(7,)`` [m, rad] and ``active``, components that have one; ``reach_m``: largest
    distance of a finger from its centre; ``limits`` of its fingers."""

    bounds: np.ndarray
    active: np.ndarray
    reach_m: float
    limits: Sequence[HandLimits]

    def most(self) -> tuple[np.ndarray, np.ndarray]:
        """Least limits of speed, acceleration and jerk of its fingers: ``(3,)`` of translations, ``(3,)`` of turns."""
        moves = [(x.max_speed_m_s, x.max_acceleration_m_s2, x.max_jerk_m_s3) for x in self.limits]
        turns = [
            (x.max_angular_speed_rad_s, x.max_angular_acceleration_rad_s2, x.max_angular_jerk_rad_s3)
            for x in self.limits
        ]
        share = 1.0 - RESERVE
        return share * np.array(moves).min(axis=0), share * np.array(turns).min(axis=0)


class ExecutableActions:
    """Scales actions ``(size,)`` into the limits, and takes derivatives back. ``weights``: share of each knot's
    velocity in each step ``(steps, knots)``; ``times`` [s] of all poses, of which the hands act from the number
    ``first`` on."""

    def __init__(self, weights: np.ndarray, times: np.ndarray, first: int, hands: Mapping[str, HandSpan]) -> None:
        steps, self._knots = weights.shape
        ways = np.zeros((len(times), self._knots))
        ways[first + 1 : first + steps + 1] = np.cumsum(weights, axis=0)
        ways[first + steps + 1 :] = ways[first + steps]
        curve = CubicSpline(times, ways)
        fine = np.arange(times[0], times[-1] + 0.5 * FINE_S, FINE_S)

        def bent(when: np.ndarray) -> np.ndarray:
            inside = (when >= times[0]) & (when <= times[-1])
            return np.asarray(curve(np.clip(when, times[0], times[-1]), 2) * inside[:, None])

        starts = np.concatenate([fine - JERK_S, fine])
        self._rates = (curve(fine, 1), curve(fine, 2), (bent(starts + JERK_S) - bent(starts)) / JERK_S)
        self._hands = dict(hands)

    def _parts(self, action: np.ndarray) -> list[tuple[HandSpan, slice, np.ndarray]]:
        """Each hand, where its entries are, and what they ask for: ``(knots, 7)`` [m, rad] a step."""
        at, found = 0, []
        for hand in self._hands.values():
            count = self._knots * len(hand.active)
            motion = np.zeros((self._knots, 7))
            motion[:, hand.active] = action[at : at + count].reshape(self._knots, -1) * hand.bounds[hand.active]
            found.append((hand, slice(at, at + count), motion))
            at += count
        return found

    def scaled(self, action: np.ndarray) -> np.ndarray:
        """The action that is executed for an action ``(size,)``."""
        out = np.array(action, dtype=float)
        for hand, entries, motion in self._parts(out):
            turn, _ = self._turn_scale(hand, motion)
            move, _, _ = self._move_scale(hand, motion, turn)
            out[entries] = (out[entries].reshape(self._knots, -1) * self._scales(hand, move, turn)).ravel()
        return out

    def pull(self, action: np.ndarray, by_scaled: np.ndarray) -> np.ndarray:
        """Derivatives of a loss by an action ``(size,)`` from those by the action that is executed for it."""
        action, by_scaled = np.asarray(action, dtype=float), np.asarray(by_scaled, dtype=float)
        out = np.empty_like(action)
        for hand, entries, motion in self._parts(action):
            turn, by_turn = self._turn_scale(hand, motion)
            move, by_move, by_turned = self._move_scale(hand, motion, turn)
            own = by_scaled[entries].reshape(self._knots, -1)
            given = np.zeros((self._knots, 7))
            given[:, hand.active] = own / hand.bounds[hand.active]
            moving, turning = _MOVES, _TURNS
            along = float((given[:, moving] * motion[:, moving]).sum())
            given_turn = given[:, turning] + along * by_turned  # by what is turned in the end
            total = np.zeros((self._knots, 7))
            total[:, moving] = move * given[:, moving] + along * by_move
            total[:, turning] = turn * given_turn + float((given_turn * motion[:, turning]).sum()) * by_turn
            out[entries] = (total[:, hand.active] * hand.bounds[hand.active]).ravel()
        return out

    @staticmethod
    def _scales(hand: HandSpan, move: float, turn: float) -> np.ndarray:
        return np.where(np.isin(hand.active, _TURNS), turn, move)

    def _turn_scale(self, hand: HandSpan, motion: np.ndarray) -> tuple[float, np.ndarray]:
        """s_w, and its derivative by the turns ``(knots, 3)``."""
        scale, slope = 1.0, np.zeros((self._knots, 3))
        for rates, most in zip(self._rates, hand.most()[1], strict=True):
            values = rates @ motion[:, _TURNS]
            sizes = np.linalg.norm(values, axis=1)
            row = int(np.argmax(sizes))
            if most < scale * sizes[row]:
                scale = most / sizes[row]
                slope = -scale / sizes[row] ** 2 * np.outer(rates[row], values[row])
        return scale, slope

    def _move_scale(self, hand: HandSpan, motion: np.ndarray, turn: float) -> tuple[float, np.ndarray, np.ndarray]:
        """s_v, its derivative by translations and closing ``(knots, 4)``, and by turns as scaled ``(knots, 3)``."""
        scale, by_moves, by_turned = 1.0, np.zeros((self._knots, 4)), np.zeros((self._knots, 3))
        turned = turn * motion[:, _TURNS]
        spins = [rates @ turned for rates in self._rates]
        for order, (rates, most) in enumerate(zip(self._rates, hand.most()[0], strict=True)):
            moves, closing = rates @ motion[:, :3], rates @ motion[:, 6]
            lengths = np.linalg.norm(moves, axis=1)
            sizes = lengths + np.abs(closing)
            added, parts = _added(order, spins, hand.reach_m, hand.most()[1])
            left = np.maximum(most - added, 0.0)
            shares = np.where(sizes > 0.0, left / np.where(sizes > 0.0, sizes, 1.0), np.inf)
            row = int(np.argmin(shares))
            if shares[row] < scale:
                scale = float(shares[row])
                unit = moves[row] / lengths[row] if lengths[row] > 0.0 else np.zeros(3)
                by_size = np.append(np.outer(rates[row], unit), np.sign(closing[row]) * rates[row][:, None], axis=1)
                by_moves = -scale / sizes[row] * by_size
                by_turned = np.zeros((self._knots, 3))
                for other, factor in parts.items():
                    spin = spins[other][row]
                    length = float(np.linalg.norm(spin))
                    if length > 0.0:
                        by_turned -= factor[row] / (sizes[row] * length) * np.outer(self._rates[other][row], spin)
        return scale, by_moves, by_turned


_MOVES, _TURNS = np.array([0, 1, 2, 6]), np.array([3, 4, 5])


def _added(
    order: int, spins: Sequence[np.ndarray], reach: float, most: np.ndarray
) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """R_m ``(n,)`` of the order 0 (speed) to 2 (jerk), and its derivatives by |omega|, |alpha| or |jerk|, as far as it
    has them, by their orders. ``most``: the limits of these three."""
    omega, alpha, jerk = (np.linalg.norm(spin, axis=1) for spin in spins)
    arm = np.full(len(spins[order]), reach)
    if order == 0:
        return reach * omega, {0: arm}
    if order == 1:
        return reach * (alpha + omega**2), {0: 2.0 * reach * omega, 1: arm}
    return reach * (jerk + 3.0 * most[0] * most[1] + most[0] ** 3), {2: arm}
