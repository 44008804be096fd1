"""What Taichi says of a kernel that is wrong, with the places that :mod:`sim_core.kernels` gives it."""

from pathlib import Path

import numpy as np
import pytest
import taichi as ti

from sim_core.kernels import F1, BoundKernel


@ti.kernel
def wrong(a: F1):
    for i in range(3):
        a[i] = nowhere_defined  # noqa: F821


def test_a_kernel_that_is_wrong_is_told_with_file_line_and_text():
    with pytest.raises(ti.TaichiNameError) as told:
        BoundKernel(wrong, np.zeros(3))()
    line = next(
        k for k, text in enumerate(Path(__file__).read_text().splitlines(), 1) if "a[i] = nowhere_defined" in text
    )
    said = str(told.value)
    assert f'File "{__file__}", line {line}, in wrong:\na[i] = nowhere_defined' in said
    assert "is not defined" in said


@ti.kernel
def doubled(a: F1):
    for i in range(3):
        a[i] = 2.0 * a[i]


def test_a_kernel_is_compiled_when_it_is_first_called():
    """And what its arrays hold then is what it works on."""
    a = np.zeros(3)
    bound = BoundKernel(doubled, a)
    assert not doubled._primal.compiled_kernels
    a[:] = [1.0, 2.0, 3.0]
    for expected in ([2.0, 4.0, 6.0], [4.0, 8.0, 12.0]):
        bound()
        assert np.array_equal(a, expected)
    assert len(doubled._primal.compiled_kernels) == 1
