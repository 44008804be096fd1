"""Surface response of an elastic layer bonded to a rigid plate, in closed form for every wave number.

A traction t exp(i k . x) on the top of a layer of the thickness h gives a displacement C(k) t exp(i k . x). Across the
wave vector (SH) C = tanh(k h) / (G k). Along it and normal (P-SV) the four solutions of Navier's equations

    u_x = i U, u_z = W:  (1, 1) e^{kz},  (1, -1) e^{-kz},  (z, z - kappa / k) e^{kz},  (z, -z - kappa / k) e^{-kz}

with kappa = 3 - 4 nu are joined so that they vanish at the plate, z = -h (Johnson, Contact Mechanics, 1985, app. 2). At
k = 0 the layer shears, h / G, and is compressed, h (1 - 2 nu) / (2 G (1 - nu)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

Array = np.ndarray


@dataclass(frozen=True)
class Layer:
    """Thickness [m], shear modulus [Pa], Poisson's ratio."""

    thickness: float
    shear: float
    poisson: float


def along_and_normal(layer: Layer, k: Array) -> Array:
    """Compliance [m/Pa] between (T, N) and (U, W) with t_x = i T, t_z = N, shape ``(n, 2, 2)``, for k > 0 [1/m]."""
    kappa = 3.0 - 4.0 * layer.poisson
    ratio = 2.0 * layer.poisson / (1.0 - 2.0 * layer.poisson)  # lambda / G
    depth = k * layer.thickness
    one, small = np.ones_like(depth), np.exp(-np.minimum(depth, 600.0))
    # Lengths in 1/k; the solutions that grow downwards are scaled to one at the plate.
    top = {"U": [one, small, 0 * one, 0 * one], "W": [one, -small, -kappa * one, -kappa * small]}
    slope = {"U": [one, -small, one, small], "W": [one, small, (1 - kappa) * one, (kappa - 1) * small]}
    plate_u = np.stack([small, one, -depth * small, -depth * one], axis=-1)
    plate_w = np.stack([small, -one, (-depth - kappa) * small, (depth - kappa) * one], axis=-1)
    u, w = np.stack(top["U"], -1), np.stack(top["W"], -1)
    du, dw = np.stack(slope["U"], -1), np.stack(slope["W"], -1)
    shear, normal = du + w, ratio * (dw - u) + 2.0 * dw
    system = np.stack([plate_u, plate_w, shear, normal], axis=-2)
    load = np.zeros((len(k), 4, 2))
    load[:, 2, 0] = load[:, 3, 1] = 1.0
    coefficients = np.linalg.solve(system, load)
    return np.asarray(np.stack([u, w], axis=-2) @ coefficients / (layer.shear * k)[:, None, None])


def response(layer: Layer, points: int, pitch: float) -> Array:
    """Compliance of the layer on a periodic square grid, in the order of ``rfft2``: complex [m/Pa], shape
    ``(points, points // 2 + 1, 3, 3)``."""
    kx = 2 * np.pi * fft.fftfreq(points, pitch)[:, None]
    ky = 2 * np.pi * fft.rfftfreq(points, pitch)[None, :]
    size = np.hypot(kx, ky)
    k = size.ravel()[1:]
    plane = along_and_normal(layer, k)
    across = np.tanh(k * layer.thickness) / (layer.shear * k)
    cos, sin = (np.broadcast_to(c, size.shape).ravel()[1:] / k for c in (kx, ky))
    out = np.zeros((size.size, 3, 3), dtype=complex)
    out[1:, 0, 0] = plane[:, 0, 0] * cos**2 + across * sin**2
    out[1:, 1, 1] = plane[:, 0, 0] * sin**2 + across * cos**2
    out[1:, 0, 1] = out[1:, 1, 0] = (plane[:, 0, 0] - across) * cos * sin
    out[1:, 0, 2], out[1:, 1, 2] = 1j * plane[:, 0, 1] * cos, 1j * plane[:, 0, 1] * sin
    out[1:, 2, 0], out[1:, 2, 1] = -1j * plane[:, 1, 0] * cos, -1j * plane[:, 1, 0] * sin
    out[1:, 2, 2] = plane[:, 1, 1]
    g, nu = layer.shear, layer.poisson
    out[0] = layer.thickness * np.diag([1 / g, 1 / g, (1 - 2 * nu) / (2 * g * (1 - nu))])
    return out.reshape(*size.shape, 3, 3)


class Surface:
    """A square patch of the top surface, ``points`` by ``points`` at ``pitch`` [m], and the whole period around it.

    ``displacement``: of the patch by tractions on it, without images of other periods but those of the period itself,
    which is many thicknesses wide. ``softest``: greatest eigenvalue of the compliance [m/Pa].
    """

    def __init__(self, layer: Layer, points: int, pitch: float, period: int) -> None:
        self.layer, self.points, self.pitch, self.period = layer, points, pitch, period
        whole = response(layer, period, pitch)
        self._whole = np.ascontiguousarray(np.moveaxis(whole, (2, 3), (0, 1)))
        kernel = fft.irfft2(self._whole, s=(period, period))
        near = np.r_[0:points, -points:0]
        self._near = fft.rfft2(kernel[:, :, near[:, None], near[None, :]])
        self.softest = float(np.abs(np.linalg.eigvalsh(np.moveaxis(self._near, (0, 1), (2, 3)))).max())
        place = (np.arange(points) - (points - 1) / 2) * pitch
        self.x, self.y = np.meshgrid(place, place, indexing="ij")

    def displacement(self, traction: Array) -> Array:
        """Displacement of the patch [m] by a traction on it [Pa], both ``(3, points, points)``."""
        size = (2 * self.points, 2 * self.points)
        hat = fft.rfft2(traction, s=size)
        return np.asarray(fft.irfft2(_product(self._near, hat), s=size)[:, : self.points, : self.points])

    def everywhere(self, traction: Array) -> Array:
        """Displacement of the whole period, whose middle is that of the patch, shape ``(3, period, period)``."""
        full = np.zeros((3, self.period, self.period))
        first = (self.period - self.points) // 2
        full[:, first : first + self.points, first : first + self.points] = traction
        return np.asarray(fft.irfft2(_product(self._whole, fft.rfft2(full)), s=(self.period, self.period)))


def _product(kernel: Array, hat: Array) -> Array:
    return np.asarray(sum(kernel[:, b] * hat[b] for b in range(3)))
