"""Numbers by which results are decided stand in the settings of their room, each with unit, meaning and origin."""

from __future__ import annotations

import ast
import dataclasses
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from sim_core.settings import CHOSEN, described
from sysid.settings import all_settings

ROOT = Path(__file__).parents[2]
ROOMS = sorted(all_settings())

FACTS = {
    "first_shapes UNITS",
    "start_poses UNITS",
    "wrench_units UNITS",
    "wrench_units TORQUE_UNITS",
    "outliers DIMENSIONS",
    "common_mode KINDS",
    "mixture COLOURS, SHARES",
    "stillness STILL_WITHIN",
    "wrench_mistakes FORCE_UNITS",
    "wrench_mistakes TORQUE_LENGTHS",
    "marker_mistakes LENGTHS",
    "marker_mistakes PICTURES",
}
"""Tables of units, dimensions and modes, and a grid of a quadrature, which decide nothing."""


def numbers_of(path: Path) -> Iterator[tuple[str, int]]:
    """Names and lines of the constants of a module that are a number or hold one."""
    for statement in ast.parse(path.read_text()).body:
        if isinstance(statement, ast.Assign):
            targets, value = statement.targets, statement.value
        elif isinstance(statement, ast.AnnAssign) and statement.value is not None:
            targets, value = [statement.target], statement.value
        else:
            continue
        names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        if any(n.isupper() for n in names) and has_number(value):
            yield ", ".join(names), statement.lineno


def has_number(value: ast.AST) -> bool:
    """Whether an expression has a number in it, other than as an index or an argument of a call that is no
    arithmetic."""
    if isinstance(value, ast.Call):
        function = ast.unparse(value.func)
        arithmetic = function.startswith(("np.", "math.")) or function in ("max", "min", "float", "int")
        return arithmetic and any(has_number(argument) for argument in value.args)
    if isinstance(value, ast.Subscript):
        return False
    if isinstance(value, ast.Constant):
        return isinstance(value.value, (int, float)) and not isinstance(value.value, bool)
    return any(has_number(child) for child in ast.iter_child_nodes(value))


@pytest.mark.parametrize("room", ROOMS)
def test_no_module_of_the_room_has_numbers_of_its_own(room: str) -> None:
    loose = [
        f"{path.relative_to(ROOT)}:{line} {name}"
        for path in sorted((ROOT / "sysid" / room).rglob("*.py"))
        for name, line in numbers_of(path)
        if f"{path.stem} {name}" not in FACTS
    ]
    assert not loose, f"move these to sysid/settings/{room}.py: {loose}"


@pytest.mark.parametrize("room", ROOMS)
def test_each_setting_has_its_unit_its_meaning_and_how_it_was_chosen(room: str) -> None:
    settings = all_settings()[room]
    assert dataclasses.is_dataclass(settings) and type(settings).__dataclass_params__.frozen  # type: ignore[attr-defined]
    assert type(settings).__doc__
    for one in described(settings):
        assert one.unit and one.chosen in CHOSEN
        assert one.meaning[0].isupper() and one.meaning.endswith("."), one.name
        assert one.name.islower() and len(one.name) > 3


@cache
def attributes_read() -> set[str]:
    """All of the form ``ROOM.setting`` in modules other than the settings'."""
    modules = [path for path in (ROOT / "sysid").rglob("*.py") if path.parent.name != "settings"]
    return {found for path in modules for found in re.findall(r"\b[A-Z_]+\.[a-z]\w*", path.read_text())}


@pytest.mark.parametrize("room", ROOMS)
def test_each_setting_is_read_somewhere(room: str) -> None:
    unread = {f"{room.upper()}.{one.name}" for one in described(all_settings()[room])} - attributes_read()
    assert not unread


@pytest.mark.parametrize(
    "code",
    [
        "FAR = 3.0",
        "A, B = 1, 2",
        "SD: dict[str, float] = {'a': -0.1}",
        "T = (0.5, 'x')",
        "W = max(2, N)",
        "R = np.full(3, 0.1)",
    ],
)
def test_a_loose_number_is_found(tmp_path: Path, code: str) -> None:
    (tmp_path / "module.py").write_text(f'{code}\nNAME = "3"\nKEYS = tuple(range(3))\n')
    assert len(list(numbers_of(tmp_path / "module.py"))) == 1
