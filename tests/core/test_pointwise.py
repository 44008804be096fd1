"""Laws of one formula: their derivatives, compiled and in numpy, and what is kept in the cache."""

import importlib.util
import math
import sys

import numpy as np
import pytest
from no_compiler import without_compiler

from sim_core.contact.pressure_and_friction import (
    friction_force,
    friction_potential,
    friction_stiffness,
    potential,
    pressure,
    slope,
)
from sim_core.core import language as lang
from sim_core.core import pointwise
from sim_core.core.build import compiler
from sim_core.core.language import mat3, vec3
from sim_core.core.lowering import LoweringError
from sim_core.core.pointwise import Law
from sim_core.energies.dihedral import angle, angle_gradient

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C++ compiler is installed")
ROUND_OFF = 1e-13
"""Relative, of the largest: a law rounds some dozen times, to 1.1e-16 each."""


def close(found, wanted):
    return found == pytest.approx(wanted, rel=0.0, abs=ROUND_OFF * np.abs(wanted).max())


def half(x: float) -> float:
    return 0.5 * x


def everything(x: float, y: float) -> float:
    """Every function and operator of laws, at x, y in (0, 1)."""
    a = math.exp(-x) * math.sin(y) + math.cos(x * y) / (1.0 + x) - math.tan(half(x)) ** 3
    b = math.sqrt(x + y) * math.log(1.0 + y) + math.atan2(y, x - 0.5) + x**y + x**1.5 + x**-2 + 2.0**x
    c = math.asin(half(x)) * math.acos(half(y)) + math.atan(x / y) + math.tanh(3.0 - x * y) + abs(x - y)
    return a + b * c + min(x, y, 0.3) * max(x, 2.0 * y) + pow(x, 3)


def integers(x: float, n: float) -> float:
    """Python's division of integers, of both signs."""
    i = int(n)
    return x * (100 * (i // 3) + 10 * (i % 3)) + i / 2 + (i // -4) * 1000 + i % -4 + x // 0.3 + x % 0.3


def branches(x: float, y: float) -> float:
    out = 0.0
    if x < y and not y > 0.9:
        out = x * y
        for k in range(3):
            out += x**2 if k != 1 else y
    elif 0.2 < x <= 0.8:
        n = 0
        while n < 2:
            n += 1
            out -= y * x
    return out


def points(n, count=2):
    return np.random.default_rng(3).uniform(0.05, 0.95, (count, n))


def in_numpy(law, *arguments):
    with (
        pytest.MonkeyPatch.context() as patch,
        pytest.warns(UserWarning, match="No C\\+\\+ compiler was found: the laws of effects"),
    ):
        without_compiler(patch)
        return Law(law)(*arguments)


@needs_compiler
@pytest.mark.parametrize("law", [everything, branches, integers])
def test_a_law_is_the_same_in_python_in_cpp_and_in_numpy(law):
    x, y = points(60)
    if law is integers:
        y = np.arange(60.0) - 30.0
    compiled, written = Law(law)(x, y), in_numpy(law, x, y)
    assert close(compiled.v, np.array([law(float(a), float(b)) for a, b in zip(x, y, strict=True)]))
    for part in "vdh":
        assert close(getattr(written, part), getattr(compiled, part)), part


@needs_compiler
@pytest.mark.parametrize("law", [everything, branches])
def test_derivatives_are_those_of_differences(law):
    x, y = points(60)
    compiled, h = Law(law), 1e-5
    here = compiled(x, y)
    for i, step in enumerate(([h, 0.0], [0.0, h])):
        low, high = (compiled(x + s * step[0], y + s * step[1]) for s in (-1.0, 1.0))
        smooth = np.abs(x - y) > h  # 'branches' jumps there
        smooth &= np.abs(x - 0.2) > h
        assert ((high.v - low.v) / (2 * h))[smooth] == pytest.approx(here.d[i][smooth], rel=1e-5, abs=1e-6)
        for j in range(2):
            wanted = ((high.d[j] - low.d[j]) / (2 * h))[smooth]
            assert here.second(i, j)[smooth] == pytest.approx(wanted, rel=1e-5, abs=1e-5)


def potential_at(g, stiffness, span, core):
    return potential(g, lang.Vector([stiffness, span, core]))


def pressure_at(g, stiffness, span, core):
    return pressure(g, lang.Vector([stiffness, span, core]))


def slope_at(g, stiffness, span, core):
    return slope(g, lang.Vector([stiffness, span, core]))


@needs_compiler
def test_derivatives_of_the_contact_law_are_the_written_ones():
    gap = np.linspace(-0.3, 1.4, 61) * 1e-4  # overlap, the straight part, the law itself, and beyond its range
    c = np.array([3e7, 1e-4, 0.2])
    energy, force, stiff = (Law(f)(gap, *c) for f in (potential_at, pressure_at, slope_at))
    assert close(-energy.d[0], force.v)
    assert close(-force.d[0], stiff.v)
    assert close(energy.second(0, 0), stiff.v)
    # Of degree 2 and 1 in the gap and the range (Euler's theorem of homogeneous functions).
    assert close(c[1] * energy.d[2], 2.0 * energy.v + gap * force.v)
    assert close(c[1] * force.d[2], force.v + gap * stiff.v)


def friction_energy_at(a, b, c, limit, stiffness):
    return friction_potential(vec3(a, b, c), limit, stiffness)


def friction_force_at(a, b, c, limit, stiffness, i):
    return friction_force(vec3(a, b, c), limit, stiffness)[int(i)]


def friction_stiffness_at(a, b, c, limit, stiffness, i, j):
    return friction_stiffness(vec3(a, b, c), limit, stiffness, mat3(1, 0, 0, 0, 1, 0, 0, 0, 1))[int(i), int(j)]


@needs_compiler
def test_derivatives_of_friction_are_the_written_ones():
    slips = np.random.default_rng(1).normal(size=(3, 40)) * np.geomspace(1e-6, 1e-3, 40)
    numbers = 0.3, 2e3  # the limit is reached at 3e-4 m
    energy = Law(friction_energy_at)(*slips, *numbers)
    force_at, stiffness_at = Law(friction_force_at, order=1), Law(friction_stiffness_at, order=1)
    for i in range(3):
        force = force_at(*slips, *numbers, i)
        assert close(energy.d[i], force.v)
        for j in range(3):
            stiff = stiffness_at(*slips, *numbers, i, j).v
            assert np.abs(energy.second(i, j) - stiff).max() < ROUND_OFF * numbers[1]
            assert np.abs(force.d[j] - stiff).max() < ROUND_OFF * numbers[1]


@needs_compiler
def test_a_resting_contact_has_the_stiffness_of_its_spring():
    """At no slip the energy goes with |u|, whose square root has no derivative, and the force is the one to use."""
    rest, force_at = np.zeros((3, 1)), Law(friction_force_at, order=1)
    for i in range(3):
        force = force_at(*rest, 0.3, 2e3, i)
        assert force.v[0] == 0.0
        assert force.d[:3, 0].tolist() == [2e3 * (i == j) for j in range(3)]


def hinge(a, b, c, d, e, f, g, h, i, j, k, m):
    return angle(vec3(a, b, c), vec3(d, e, f), vec3(g, h, i), vec3(j, k, m))


def hinge_gradient(a, b, c, d, e, f, g, h, i, j, k, m, n):
    return angle_gradient(vec3(a, b, c), vec3(d, e, f), vec3(g, h, i), vec3(j, k, m))[int(n)]


@needs_compiler
def test_derivatives_of_the_dihedral_angle_are_the_written_ones():
    flat = np.array([0, 0, 0, 1, 0, 0, 0.4, 1, 0, 0.5, -1, 0.0])[:, None]
    corners = flat + 0.3 * np.random.default_rng(2).normal(size=(12, 30))
    bent, gradient = Law(hinge)(*corners), Law(hinge_gradient, order=1)
    for n in range(12):
        written = gradient(*corners, n)
        assert np.abs(bent.d[n] - written.v).max() < ROUND_OFF * np.abs(bent.d).max()
        for m in range(12):
            assert np.abs(bent.second(n, m) - written.d[m]).max() < ROUND_OFF * np.abs(bent.h).max()


def users_law(folder, text):
    path = folder / "my_law.py"
    path.write_text(text)
    spec = importlib.util.spec_from_file_location("my_law", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@needs_compiler
def test_a_law_is_compiled_once_for_its_text_and_for_all_that_it_calls(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made, build = [], pointwise.build

    def counted(*given):
        made.append(build(*given))
        return made[-1]

    monkeypatch.setattr(pointwise, "build", counted)
    text = "STIFF = 2.0\ndef square(x):\n    return x * x\ndef law(x):\n    return STIFF * square(x)\n"
    for wanted, changed in ((1, text), (1, text), (1, text + "# another\n"), (2, text.replace("2.0", "3.0"))):
        law = Law(users_law(tmp_path, changed).law)
        assert law(np.array([2.0])).v[0] == 4.0 * (3.0 if "3.0" in changed else 2.0)
        assert len(made) == wanted
    changed = text.replace("x * x", "x * x * x")
    assert Law(users_law(tmp_path, changed).law)(np.array([2.0])).v[0] == 16.0
    assert len(made) == 3


@pytest.mark.parametrize("no_compiler", [False, True])
def test_a_law_that_cannot_be_lowered_says_so_with_and_without_a_compiler(tmp_path, monkeypatch, no_compiler):
    if no_compiler:
        without_compiler(monkeypatch)
    law = Law(users_law(tmp_path, "import numpy as np\ndef law(x):\n    return np.exp(x)\n").law)
    with pytest.raises(LoweringError, match=r"my_law.py:3: the law law calls np.exp. Laws call each other"):
        law(np.zeros(2))


@needs_compiler
def test_a_law_that_returns_two_numbers_is_an_error_in_words(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    law = Law(users_law(tmp_path, "def law(x):\n    return x, x\n").law)
    with pytest.raises(LoweringError, match=r"my_law.py could not be compiled.*Have it return one number"):
        law(np.zeros(2))


def test_no_law_is_needed_where_there_are_no_points():
    assert len(Law(half)(np.zeros(0)).v) == 0
    assert "my_law" not in sys.modules


def test_what_a_law_raises_where_c_calls_it_is_raised(monkeypatch):
    without_compiler(monkeypatch)
    law = Law(half)
    monkeypatch.setattr(law, "_jet", lambda x: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        law(np.ones(3))
