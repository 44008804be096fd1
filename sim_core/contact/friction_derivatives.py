"""Exact derivatives of friction, common to all kinds of contact.

In terms of the slip w before it is projected (elastic slip remembered plus motion), the lagged normal m, the limit
and the spring of :mod:`sim_core.contact.pressure_and_friction`:

    u = (1 - m m^T) w,    F = dD/du,    new elastic slip u min(1, u_c / |u|),    slip speed max(0, |u| - u_c) / dt
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.energies.linearised import dot


@dataclass(frozen=True)
class FrictionDerivatives:
    """Friction of n samples: ``force`` [N] and new elastic ``slip`` [m], ``(n, 3)``, and derivatives by w, m, limit
    and spring of the force, of the slip (``(n, 3, .)`` each) and of the slip speed ``(n, 1, .)``."""

    force: np.ndarray
    slip: np.ndarray
    force_by: tuple[np.ndarray, ...]
    slip_by: tuple[np.ndarray, ...]
    speed_by: tuple[np.ndarray, ...]

    @staticmethod
    def chain(by: tuple[np.ndarray, ...], w: np.ndarray, m: np.ndarray) -> np.ndarray:
        """Derivative ``(n, ., q)`` by what w and m have the derivatives ``(n, 3, q)`` by."""
        return np.asarray(by[0] @ w + by[1] @ m)


def friction_derivatives(
    w: np.ndarray, m: np.ndarray, limit: np.ndarray, spring: np.ndarray, dt: float
) -> FrictionDerivatives:
    """Differentiate the law, F = u f; what changes with |u| alone changes along e = u / |u|. Without a limit nothing
    holds, moved or not."""
    along = dot(m, w)
    u = w - m * along[:, None]
    length = np.sqrt(dot(u, u))
    longest = 2.0 * limit / spring
    slides = length > longest
    beyond = slides | (limit <= 0.0)
    far = np.where(beyond & (length > 0.0), length, 1.0)
    e = u / np.where(length > 0.0, length, 1.0)[:, None]
    near = np.where(longest > 0.0, longest, 1.0)
    pull = np.where(beyond, limit / far, spring * (1.0 - 0.5 * length / near))
    kept = np.where(beyond, longest / far, 1.0)
    by_length = np.where(beyond, -pull / far, -0.5 * spring / near), np.where(beyond, -kept / far, 0.0)
    in_plane = np.eye(3) - m[:, :, None] * m[:, None, :]
    turned = -(along[:, None, None] * np.eye(3) + m[:, :, None] * w[:, None, :])
    rate = np.where(slides, 1.0 / dt, 0.0)

    def by_slip(share: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of u times a share, by w and m."""
        by_u = share[:, None, None] * np.eye(3) + (slope[:, None] * u)[:, :, None] * e[:, None, :]
        return by_u @ in_plane, by_u @ turned

    by_limit = 2.0 / spring  # of the longest elastic slip
    by_spring = -longest / spring
    held = 0.5 * spring * length / near**2  # of the pull by the longest elastic slip, before it is reached
    pulls = (
        np.where(beyond, 1.0 / far, held * by_limit),
        np.where(beyond, 0.0, 1.0 - 0.5 * length / near + held * by_spring),
    )
    shares = (np.where(beyond, by / far, 0.0) for by in (by_limit, by_spring))
    speeds = (-rate * by for by in (by_limit, by_spring))
    row = (rate[:, None] * e)[:, None, :]
    return FrictionDerivatives(
        u * pull[:, None],
        u * kept[:, None],
        (*by_slip(pull, by_length[0]), *((u * by[:, None])[..., None] for by in pulls)),
        (*by_slip(kept, by_length[1]), *((u * by[:, None])[..., None] for by in shares)),
        (row @ in_plane, row @ turned, *(by[:, None, None] for by in speeds)),
    )
