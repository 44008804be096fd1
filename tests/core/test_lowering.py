"""Laws in C++ are those that Python runs."""

from pathlib import Path

import laws_of_the_core
import numpy as np
import pytest
from lowered_laws import Kernels

from sim_core.core.build import compiler
from sim_core.core.law_sources import PACKAGE, decorators
from sim_core.core.lowering import Library, LoweringError

MODULES = sorted(
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
    for path in PACKAGE.rglob("*.py")
    if "@lang.func" in (text := path.read_text()) or "@lang.kernel" in text
)
OF_THE_CORE = Path(laws_of_the_core.__file__)
"""Kernels of laws that no kernel of the package calls."""
ROUND_OFF = 1e-13
"""Of the largest number in an array: sums have up to some hundred terms, each rounded to 1.1e-16."""


def kernels_of(module: str) -> list[str]:
    source = Library().source(module)
    assert source is not None
    return [name for name in source.laws if "lang.kernel" in decorators(source.functions[name])]


@pytest.mark.skipif(compiler() is None, reason="no C++ compiler is installed")
@pytest.mark.parametrize("module", [*(m for m in MODULES if kernels_of(m)), "laws_of_the_core"])
def test_laws_compute_in_cpp_what_they_compute_in_python(module, tmp_path):
    kernels = Kernels(tmp_path, module, OF_THE_CORE if module == "laws_of_the_core" else None)
    for name in kernels.names:
        differs = False
        for seed in range(12):
            given = kernels.arrays(name, np.random.default_rng(seed))
            wanted, found = ([a.copy() for a in given] for _ in range(2))
            kernels.by_python(name, wanted)
            kernels.by_header(name, found)
            for before, right, left in zip(given, wanted, found, strict=True):
                written = (before != right) | (before != left)
                differs |= bool(written.any())
                scale = np.abs(right[written & np.isfinite(right)]).max(initial=0.0)
                np.testing.assert_allclose(left, right, rtol=0.0, atol=ROUND_OFF * scale, err_msg=f"{name}, {seed}")
        assert differs, f"{name} writes nothing on any of these arrays, so nothing was compared"


def test_every_law_is_called_by_a_kernel_that_is_compared():
    library = Library()
    for module in MODULES:
        source = library.source(module)
        for name in kernels_of(module):
            library.need(source, source.functions[name])
    source = library.source("laws_of_the_core", OF_THE_CORE)
    for name in source.laws:
        library.need(source, source.functions[name])
    for module in MODULES:
        for name in library.source(module).laws:
            assert (module, name) in library.functions, f"{module}.{name}"


CANNOT = {
    "a = [x]\n    return a": ("the expression '[x]'", 4),
    "return x[0:2]": ("the slice 'x[0:2]'", 4),
    "return np.exp(x)": ("calls np.exp", 4),
    "return x.mean": ("uses 'x.mean'", 4),
    "return x * SCALE": ("uses 'SCALE', which its module does not define as a number", 4),
    "if x > 0.0:\n        y = x\n    return y": ("'y' outside of the block that assigns it first", 6),
    "y = z = x\n    return y": ("several variables at once", 4),
    "for i in x:\n        pass\n    return x": ("loops over x", 4),
    "with x:\n        pass": ("'with'", 4),
    "return f(x)": ("calls itself", 3),
    "return lang.min(x, y=2.0)": ("names arguments of lang.min", 4),
    "return 'x'": ("the constant 'x'", 4),
    "return x if x in (1, 2) else 0.0": ("compares by 'x in (1, 2)'", 4),
    "for i in range(4, 0, -1):\n        x += i\n    return x": ("counts in steps", 4),
}


@pytest.mark.parametrize("body", CANNOT)
def test_what_cannot_be_lowered_is_named_with_its_line_and_a_remedy(body, tmp_path):
    words, line = CANNOT[body]
    path = tmp_path / "laws_of_mine.py"
    path.write_text(f"from sim_core.core import language as lang\n@lang.func\ndef f(x):\n    {body}\n")
    library = Library()
    source = library.source("laws_of_mine", path)
    with pytest.raises(LoweringError) as raised:
        library.need(source, source.functions["f"])
    assert words in raised.value.problem
    assert f"{path}:{line}" in raised.value.problem or (words, line) == ("calls itself", 3)
    assert raised.value.remedy


def test_constants_of_other_modules_become_numbers(tmp_path):
    path = tmp_path / "laws_of_mine.py"
    path.write_text(
        "import math\nfrom sim_core.contact.pressure_and_friction import RANGE, CORE_FREE\n"
        "HALF = 0.5 * math.pi\ndef f(c):\n    return HALF * c[RANGE] + CORE_FREE\n"
    )
    library = Library()
    source = library.source("laws_of_mine", path)
    text = library.need(source, source.functions["f"]).text
    assert "return R(1.5707963267948966) * c[1] + R(0.2);" in text
