"""Product of the Hessian over all nodes, prescribed ones included, with a move of the nodes."""

import taichi as ti

from sim_core.kernels import F1, F2, I1, vec3


@ti.kernel
def nodal_product(start: I1, column: I1, place: I1, values: F1, move: F2, out: F2):
    """out = H move, with the blocks i <= j of :class:`sim_core.energies.term.PairTable`."""
    ti.loop_config(serialize=True)
    for i in range(move.shape[0]):
        for a in ti.static(range(3)):
            out[i, a] = 0.0
    ti.loop_config(serialize=True)
    for i in range(move.shape[0]):
        own = vec3(move[i, 0], move[i, 1], move[i, 2])
        total = vec3(0.0, 0.0, 0.0)
        for k in range(start[i], start[i + 1]):
            j = column[k]
            base = 9 * place[k]
            other = vec3(move[j, 0], move[j, 1], move[j, 2])
            for a in ti.static(range(3)):
                for b in ti.static(range(3)):
                    if j != i:
                        total[a] += values[base + 3 * a + b] * other[b]
                        out[j, b] = out[j, b] + values[base + 3 * a + b] * own[a]
                    else:
                        total[a] += values[base + 3 * ti.min(a, b) + ti.max(a, b)] * own[b]
        for a in ti.static(range(3)):
            out[i, a] = out[i, a] + total[a]
