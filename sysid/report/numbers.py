"""Numbers and units as a reader wants them: SI prefixes, as many digits as the interval supports."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

MISSING = "\u2013"
"""Shown where there is no number."""

MINUS = "\u2212"
TIMES = "\u00d7"

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}
_PREFIXED = {"Pa": 12, "N": 12, "J": 12, "W": 12, "Hz": 12, "V": 12, "A": 12, "m": 0, "s": 0, "rad": 0}
"""Units that take a prefix, with the largest power of ten that is customary."""

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Number:
    """A number to be shown. ``raw``: as computed, in SI units; None where missing; ``text``: in words; ``unit``: that
    of the text; ``at``: where the result as JSON has it, as a JSON pointer (RFC 6901)."""

    raw: float | None
    text: str
    unit: str = ""
    at: str = ""

    def found_at(self, at: str, unit: str = "") -> Number:
        """The same number with its place in the result, and the unit that is printed with it."""
        return replace(self, at=at, unit=unit)


@dataclass(frozen=True)
class Scale:
    """Shown value = value * ``factor``; ``unit``: with its prefix."""

    factor: float
    unit: str


def shown_unit(unit: str) -> str:
    """A unit in print: raised exponents, a raised dot between factors, nothing for a plain number."""
    unit = unit.strip()
    if unit in ("", "-", "1"):
        return ""
    unit = re.sub(r"(?<=[A-Za-z])\^?(-?[0-9])(?![0-9])", lambda m: m[1].translate(_SUPERSCRIPT), unit)
    return re.sub(r"\s+|\*", "·", unit)


def scale_for(unit: str, *values: float | None) -> Scale:
    """Prefix for the first finite value that is not zero; the other values share it."""
    given = [abs(v) for v in values if v is not None and math.isfinite(v) and v != 0.0]
    match = re.match(r"([A-Za-zµ]+)(?=$|[\s*/·])", unit.strip())
    if not given or match is None or match[1] not in _PREFIXED:
        return Scale(1.0, shown_unit(unit))
    power = 3 * math.floor(math.floor(math.log10(given[0]) + 1e-9) / 3)
    power = max(-12, min(power, _PREFIXED[match[1]]))
    return Scale(10.0**-power, _PREFIXES[power] + shown_unit(unit))


def fixed(value: float, decimals: int) -> str:
    """A finite number with given decimals, with a true minus sign."""
    text = f"{value:.{decimals}f}"
    if float(text) == 0.0:
        text = text.lstrip("-")
    return text.replace("-", MINUS)


def significant(value: float | None, digits: int = 3, strip: bool = False) -> str:
    """A number with significant digits; powers of ten where plain decimals would be long."""
    if value is None or math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    if value == 0.0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if -4 <= power < 5:
        text = fixed(value, max(0, digits - 1 - power))
        return text.rstrip("0").rstrip(".") if strip and "." in text else text
    if strip and "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return f"{mantissa.replace('-', MINUS)}{TIMES}10{str(power).translate(_SUPERSCRIPT)}"


def with_unit(value: float | None, unit: str, digits: int = 3, strip: bool = False) -> str:
    """A number and its unit, with a prefix."""
    scale = scale_for(unit, value)
    text = significant(None if value is None else value * scale.factor, digits, strip)
    return f"{text} {scale.unit}".rstrip()


def raw_number(value: float | None) -> float | None:
    """The number, or None where it is missing or not finite."""
    return float(value) if value is not None and math.isfinite(value) else None


def value_and_interval(value: float, interval: tuple[float, float], factor: float) -> tuple[Number, Number, Number]:
    """Value and ends of its interval with the same decimals: two digits of the half-width."""
    low, high = interval
    half = 0.5 * abs(high - low) * factor
    numbers = (value, low, high)
    signed = not low < 0.0 < high
    if not math.isfinite(half) or half == 0.0:
        return tuple(Number(raw_number(v), significant(v * factor, 4)) for v in numbers)  # type: ignore[return-value]
    decimals = max(0, 1 - math.floor(math.log10(half)))
    return tuple(Number(raw_number(v), _decimals(v * factor, decimals, signed)) for v in numbers)  # type: ignore[return-value]


def scale_of_interval(unit: str, value: float, interval: tuple[float, float], *others: float) -> Scale:
    """Prefix for a value with its interval: by the value, but by the interval where that dwarfs it."""
    ends = [abs(end) for end in interval if math.isfinite(end)]
    if ends and math.isfinite(value) and abs(value) < 0.01 * max(ends):
        return scale_for(unit, max(ends))
    return scale_for(unit, value, *interval, *others)


def _decimals(value: float, decimals: int, signed: bool) -> str:
    """With these decimals, or two significant digits where those would show less of a value whose sign is known."""
    if not math.isfinite(value):
        return significant(value)
    power = math.floor(math.log10(abs(value))) if value else 0
    if not signed and decimals <= 4 and power < 0:
        return fixed(value, decimals)
    if value and not -4 <= power < 5:
        return significant(value, min(max(decimals + power + 1, 2), 6))
    if value and signed:
        decimals = max(decimals, 1 - power)
    return fixed(value, min(decimals, 9))


def percent(share: float | None, digits: int = 2) -> str:
    """A share as a percentage."""
    if share is None or math.isnan(share):
        return MISSING
    hundred = 100.0 * share
    if 0.0 < hundred < 0.1:
        return "< 0.1 %"
    if 99.9 < hundred < 100.0:
        return "> 99.9 %"
    return f"{significant(hundred, digits + 1 if abs(hundred) >= 99 else digits)} %"


def times(ratio: float | None) -> str:
    """A ratio as a multiple."""
    if ratio is None or not math.isfinite(ratio):
        return MISSING
    return f"{fixed(ratio, 2) if 0.1 <= ratio < 10.0 else significant(ratio, 3)}{TIMES}"


def change(start: float, end: float) -> str:
    """A change in words that stay short: a percentage, or a factor where that is clearer."""
    if not (math.isfinite(start) and math.isfinite(end)):
        return MISSING
    if start == end:
        return "unchanged"
    if start == 0.0 or start * end <= 0.0:
        return "from zero" if start == 0.0 else "to zero" if end == 0.0 else "changes sign"
    ratio = end / start
    if ratio > 2.0:
        return f"{TIMES}{significant(ratio, 2)}"
    if ratio < 0.5:
        return f"÷{significant(1.0 / ratio, 2)}"
    moved = 100.0 * (ratio - 1.0)
    if abs(moved) < 0.05:
        return "under 0.1 %"
    return f"{'+' if moved > 0 else MINUS}{significant(abs(moved), 2)} %"


def seconds(value: float) -> str:
    """A duration."""
    if not math.isfinite(value):
        return MISSING
    if value < 120.0:
        return f"{significant(value, 2)} s"
    if value < 7200.0:
        return f"{significant(value / 60.0, 2)} min"
    return f"{significant(value / 3600.0, 2)} h"
