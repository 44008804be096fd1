"""Rolling shutter: a camera reads its picture row by row, so that each point is seen at the time of its row.

    p'(t) = p(t + T (v / H - 1/2)) = p + T (v / H - 1/2) dp/dt

with the time T from the first row to the last, the row v of the point and the height H of the picture; a stamp is that
of the middle row (Meingast, Geyer & Sastry, OMNIVIS 2005). The speed of a point is that between the frames before and
after, which asks for frames that are not much further apart than T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import Channel, ReadingMap
from sim_core.effects.scopes import Scope
from sim_core.rigs import OrthographicCamera


class RollingShutter(ReadingMap):
    """A camera that does not take all of a picture at once."""

    name = "rolling_shutter"
    title = "the camera reads its picture row by row"
    words = "Points low in the picture are seen later than points high in it, by up to the time of a readout."
    signature = "The residual of a track is proportional to its speed, with one sign above the middle, another below."
    source = "Meingast, Geyer & Sastry, OMNIVIS 2005"
    slot = "camera"
    follows = "sensor"
    passive = True
    scope = Scope(
        "a camera with a height",
        lambda rig: tuple(n for n, c in rig.cameras.items() if not isinstance(c, OrthographicCamera)),
    )
    twins = ("stream_delay", "camera_pose")
    separated_by = "The same motion once with the object high in the picture and once with it low."
    parameters = (
        EffectParameter("readout_s", "s", -0.2, 0.2, (0.02,), 0.0, False, 0.03, "from the first row to the last"),
    )
    example = {"readout_s": 0.03}

    def read(self, channel: Channel, readings: np.ndarray, values: Values) -> np.ndarray:
        seen = _Seen.of(channel, readings, values)
        return np.asarray(readings + seen.late * seen.speed(readings))

    def push(self, channel: Channel, readings: np.ndarray, change: np.ndarray, values: Values) -> np.ndarray:
        seen = _Seen.of(channel, readings, values)
        later = seen.per_row * change[..., 1:, :]
        return np.asarray(change + later * seen.speed(readings)[..., None] + seen.late[..., None] * seen.speed(change))

    def pull(self, channel: Channel, readings: np.ndarray, weights: np.ndarray, values: Values) -> np.ndarray:
        seen = _Seen.of(channel, readings, values)
        out = weights.copy()
        out[..., 1] += seen.per_row * (seen.speed(readings) * weights).sum(axis=-1)
        seen.add_speed_back(seen.late * weights, out)
        return np.asarray(out)


@dataclass(frozen=True)
class _Seen:
    """Points of a channel: ``late`` [s] ``(k, n, 1)``, by how much the row of each is read later, and ``per_row``, its
    derivative by the row; the frames ``before`` and ``after`` each ``(k, n)`` in which a point is in sight, and one
    over the time between them [1/s], 0 where there is none."""

    late: np.ndarray
    per_row: float
    before: np.ndarray
    after: np.ndarray
    rate: np.ndarray

    @staticmethod
    def of(channel: Channel, readings: np.ndarray, values: Values) -> _Seen:
        per_row = values["readout_s"] / channel.rig.cameras[channel.name].height_px
        late = per_row * readings[..., 1:] - 0.5 * values["readout_s"]
        order = np.argsort(channel.stamps, kind="stable")
        lost, frame = np.isnan(readings[..., 0]), np.arange(len(order))[:, None]
        before, after = order.copy(), order.copy()
        before[order[1:]], after[order[:-1]] = order[:-1], order[1:]
        before[order[:1]], after[order[-1:]] = order[:1], order[-1:]
        first, last = (np.where(lost[there], frame, there[:, None]) for there in (before, after))
        span = channel.stamps[last] - channel.stamps[first]
        rate = np.where(span > 0.0, 1.0 / np.where(span > 0.0, span, 1.0), 0.0)
        return _Seen(late, per_row, first, last, rate)

    def speed(self, points: np.ndarray) -> np.ndarray:
        """Speed [px/s] of points, or its change along changes of them, ``(k, n, 2, ...)``."""
        n = np.arange(points.shape[1])
        rate = self.rate.reshape(*self.rate.shape, *([1] * (points.ndim - 2)))
        return np.asarray((points[self.after, n] - points[self.before, n]) * rate)

    def add_speed_back(self, weights: np.ndarray, out: np.ndarray) -> None:
        """Add derivatives by the points, from those by their speeds, ``(k, n, 2)`` both."""
        n = np.arange(out.shape[1])
        np.add.at(out, (self.after, n), weights * self.rate[..., None])
        np.add.at(out, (self.before, n), -weights * self.rate[..., None])
