"""Inertia, gravity and dead loads: the quadratic part of the incremental potential.

E = f/2 (x - xhat)^T M (x - xhat) - x . q,    f = 1/tau^2 (0 without inertia),  q = M g + loads
"""

import taichi as ti

from sim_core.kernels import F1, F2, I1


@ti.kernel
def inertia_energy(x: F2, predicted: F2, load: F2, start: I1, column: I1, mass: F1, factor: F1, out: F1):
    ti.loop_config(serialize=True)
    for i in range(x.shape[0]):
        e = 0.0
        for c in ti.static(range(3)):
            e -= load[i, c] * x[i, c]
        if factor[0] > 0.0:
            for k in range(start[i], start[i + 1]):
                j = column[k]
                for c in ti.static(range(3)):
                    e += 0.5 * factor[0] * mass[k] * (x[i, c] - predicted[i, c]) * (x[j, c] - predicted[j, c])
        out[0] = out[0] + e


@ti.kernel
def inertia_gradient(x: F2, predicted: F2, load: F2, start: I1, column: I1, mass: F1, factor: F1, out: F2):
    """Write (not add) the gradient."""
    ti.loop_config(serialize=True)
    for i in range(x.shape[0]):
        for c in ti.static(range(3)):
            out[i, c] = -load[i, c]
        if factor[0] > 0.0:
            for k in range(start[i], start[i + 1]):
                j = column[k]
                for c in ti.static(range(3)):
                    out[i, c] = out[i, c] + factor[0] * mass[k] * (x[j, c] - predicted[j, c])
