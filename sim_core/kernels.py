"""What laws do with rows and blocks of arrays."""

from sim_core.core import language as lang
from sim_core.core.language import vec3


@lang.func
def row(values: lang.template(), i: lang.i32):
    """Row of an array ``(n, 3)`` as a vector."""
    return vec3(values[i, 0], values[i, 1], values[i, 2])


@lang.func
def add_block(start: lang.template(), column: lang.template(), place: lang.template(), out: lang.template(), i, j, m):
    """Add the 3 x 3 block d2E/dx_i dx_j, listed once for i != j, to the Hessian's values at pair (i, j)."""
    low = lang.min(i, j)
    high = lang.max(i, j)
    left = start[low]
    right = start[low + 1] - 1
    while left < right:
        middle = (left + right) // 2
        if column[middle] < high:
            left = middle + 1
        else:
            right = middle
    if column[left] == high:
        base = 9 * place[left]
        for a in range(3):
            for b in range(3):
                if i < j:
                    out[base + 3 * a + b] = out[base + 3 * a + b] + m[a, b]
                elif i > j:
                    out[base + 3 * b + a] = out[base + 3 * b + a] + m[a, b]
                elif a <= b:
                    out[base + 3 * a + b] = out[base + 3 * a + b] + m[a, b]
