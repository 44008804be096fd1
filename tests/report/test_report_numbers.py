"""Numbers and units as they are shown."""

from __future__ import annotations

import math

import pytest

from sysid.report.numbers import (
    MINUS,
    change,
    percent,
    scale_for,
    shown_unit,
    significant,
    value_and_interval,
    with_unit,
)

NAN = float("nan")


@pytest.mark.parametrize(
    ("unit", "shown"),
    [
        ("N m", "N·m"),
        ("-", ""),
        ("", ""),
        ("kg/m3", "kg/m³"),
        ("m/s^2", "m/s²"),
        ("1/m", "1/m"),
        ("N s/m", "N·s/m"),
        ("px", "px"),
    ],
)
def test_units_in_print(unit: str, shown: str) -> None:
    assert shown_unit(unit) == shown


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (2.03e9, "Pa", "2.03 GPa"),
        (999.9e6, "Pa", "1000 MPa"),
        (1e3, "Pa", "1.00 kPa"),
        (4.2e-6, "N m", "4.20 µN·m"),
        (-3.1e-3, "N", f"{MINUS}3.10 mN"),
        (2.31e-4, "m/N", "231 µm/N"),
        (0.45, "-", "0.450"),
        (1180.0, "kg/m3", "1180 kg/m³"),
        (2000.0, "m", "2000 m"),
        (3e-14, "Pa", "0.0300 pPa"),
        (6.5e-9, "kg/m3", "6.50×10⁻⁹ kg/m³"),  # noqa: RUF001
        (0.0, "N", "0 N"),
        (NAN, "N", "\u2013 N"),
        (math.inf, "Pa", "∞ Pa"),
    ],
)
def test_values_take_the_customary_prefix(value: float, unit: str, text: str) -> None:
    assert with_unit(value, unit) == text


def test_over_twelve_decades_no_number_is_lost_or_long() -> None:
    for power in range(-12, 13):
        for unit in ("Pa", "m", "-", "N m", "1/s"):
            text = with_unit(1.234 * 10.0**power, unit)
            assert "123" in text.replace(".", "") and len(text) < 20, text


def test_value_and_interval_share_digits_and_unit() -> None:
    factor = scale_for("Pa", 2.0312e9).factor
    shown = [n.text for n in value_and_interval(2.0312e9, (1.981e9, 2.083e9), factor)]
    assert shown == ["2.031", "1.981", "2.083"]
    assert [n.raw for n in value_and_interval(2.0312e9, (1.981e9, 2.083e9), factor)] == [2.0312e9, 1.981e9, 2.083e9]


def test_a_wide_interval_keeps_two_digits_of_its_lower_end() -> None:
    assert [n.text for n in value_and_interval(2.0, (0.0123, 400.0), 1.0)] == ["2.0", "0.012", "400"]


def test_intervals_that_are_missing_or_endless() -> None:
    value, low, high = value_and_interval(2.0, (NAN, math.inf), 1.0)
    assert (value.text, low.text, high.text) == ("2.000", "\u2013", "∞")
    assert low.raw is None and high.raw is None


@pytest.mark.parametrize(
    ("start", "end", "text"),
    [
        (3.0, 2.0, f"{MINUS}33 %"),
        (1.0, 5.0, "\u00d75.0"),
        (5.0, 1.0, "÷5.0"),
        (0.0, 1.0, "from zero"),
        (-1.0, 1.0, "changes sign"),
        (2.0, 2.0, "unchanged"),
        (NAN, 1.0, "\u2013"),
    ],
)
def test_changes(start: float, end: float, text: str) -> None:
    assert change(start, end) == text


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.993, "99.3 %"),
        (0.5, "50 %"),
        (1.0, "100 %"),
        (0.0, "0 %"),
        (1e-9, "< 0.1 %"),
        (0.99999, "> 99.9 %"),
        (NAN, "\u2013"),
    ],
)
def test_shares(share: float, text: str) -> None:
    assert percent(share) == text


def test_significant_digits() -> None:
    assert significant(1.0304) == "1.03"
    assert significant(-0.00012345, 2) == f"{MINUS}0.00012"
    assert significant(2e9, 4, strip=True) == "2\u00d710⁹"
    assert significant(9.999, 3) == "10.0"
    assert significant(None) == "\u2013"
