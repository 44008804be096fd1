"""Every number on the page of a diagnosis stands in ``diagnosis.json``, under a name and in its unit."""

from __future__ import annotations

import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from report_examples import RUNS, make_diagnosis, make_errors

from sim_core.effects import all_effects, split_key
from sysid.diagnosis.result import VERDICTS, Misfit
from sysid.report import write_diagnosis_report
from sysid.report.numbers import MINUS, TIMES, shown_unit

PREFIXES = {"p": 1e-12, "n": 1e-9, "µ": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}
SHARES = ("share", "probability", "explained", "held_out_gain")
PICTURES = {"svg", "script", "style", "figure", "code", "pre", "title"}
PICTURE_CLASSES = {"axis", "legend", "number"}
"""What is drawn, typed or counted: axes of time, edges between colours, commands, ordinals."""
CONSTANTS = ("95 %", f"1{TIMES}")
"""Numbers of the page itself: what an interval is, and what a perfect model reaches."""
VOID = {"meta", "link", "br", "img", "input", "hr"}


class Walk(HTMLParser):
    """Numbers that are marked, with their attributes and texts, and all words that stand outside of them."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.marked: list[tuple[dict[str, str], str]] = []
        self.words: list[str] = []
        self._open: list[tuple[str, bool]] = []
        self._number: dict[str, str] | None = None
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {k: v or "" for k, v in attrs}
        if tag == "data":
            self._number = found
        drawn = tag in PICTURES or bool(PICTURE_CLASSES & set(found.get("class", "").split()))
        drawn |= found.get("id") == "provenance"
        if tag not in VOID:
            self._open.append((tag, drawn or (bool(self._open) and self._open[-1][1])))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        del tag, attrs

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            self._open.pop()
        if tag == "data":
            self._number = None

    def handle_data(self, data: str) -> None:
        if self._number is not None:
            self.marked.append((self._number, data))
        elif self._open and not self._open[-1][1] and self._open[-1][0] != "footer":
            self.words.append(" ".join(data.split()))


def resolved(data: Any, pointer: str) -> tuple[Any, list[Any]]:
    """What a JSON pointer names, and all that holds it from the outside in."""
    held = []
    for part in pointer.removeprefix("/").split("/"):
        held.append(data)
        part = part.replace("~1", "/").replace("~0", "~")
        data = data[int(part)] if isinstance(data, list) else data[part]
    return data, held


def unit_of(pointer: str, held: list[Any]) -> str:
    """The unit that the result says for a number."""
    name = pointer.rsplit("/", 1)[1]
    if name.endswith("_over_noise"):
        return TIMES
    if name in SHARES:
        return "%"
    if name == "seconds" or pointer.startswith(("/located/windows", "/parted")):
        return "s"
    if pointer.startswith("/upper_limits"):
        effect, amplitude = name.removeprefix("effects.").rsplit(".", 1)
        described = next(e for e in all_effects().values() if e.name == split_key(effect)[0])
        return next(p.unit for p in described.parameters if p.name == amplitude)
    return str(next(h["unit"] for h in reversed(held) if isinstance(h, dict) and "unit" in h))


def strings(data: Any) -> set[str]:
    """All words of a result, names among them, but for where it comes from."""
    if isinstance(data, dict):
        return set().union(*(strings(v) | {k} for k, v in data.items() if k != "provenance"), {""})
    if isinstance(data, list):
        return set().union(*(strings(v) for v in data), {""})
    return {" ".join(data.split())} if isinstance(data, str) else set()


def check(walk: Walk, data: Any) -> None:
    """Raise ``AssertionError`` where the page shows a number that the result has not, or another one."""
    for attributes, text in walk.marked:
        pointer, unit = attributes["data-at"], attributes["data-unit"]
        value, held = resolved(data, pointer)
        assert float(attributes["value"]) == value, pointer
        wanted = shown_unit(unit_of(pointer, held))
        number = re.sub(
            rf"(%|{TIMES}|s|min|h)$", "", text.replace(MINUS, "-").replace(f"{TIMES}10", "e").strip()
        ).strip()
        number = number.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
        if wanted in ("%", TIMES):
            assert unit == wanted
            factor = 0.01 if wanted == "%" else 1.0
        elif pointer == "/seconds":
            factor = {"s": 1.0, "min": 60.0, "h": 3600.0}[unit]
        else:
            assert unit.endswith(wanted), (pointer, unit, wanted)
            factor = PREFIXES[unit.removesuffix(wanted) if wanted else unit]
        if number[0] in "<>":
            bound = factor * float(number[1:])
            assert value < bound if number[0] == "<" else value > bound, (pointer, text, value)
            continue
        mantissa, _, power = number.partition("e")
        step = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2])) * factor
        assert math.isclose(float(number) * factor, value, rel_tol=0.006, abs_tol=0.51 * step), (pointer, text, value)
    known = sorted((s for s in strings(data) if re.search(r"\d", s)), key=len, reverse=True)
    bags = data["provenance"].get("bags") or []
    kept = sum(bag["held_out"] for bag in bags)
    counts = (f"fitted to {len(bags) - kept} recording", f"; {kept} more w")
    for words in walk.words:
        for said in (*known, *CONSTANTS, *counts):
            words = words.replace(said, "")
        assert not re.search(r"\d", words), words


def walked(page: Path, diagnosis: Any) -> tuple[Walk, Any]:
    return Walk(page.read_text(encoding="utf-8")), json.loads(json.dumps(diagnosis.to_json()))


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_number_on_the_page_is_in_the_result(diagnosis_pages: dict[str, Path], verdict: str) -> None:
    walk, data = walked(diagnosis_pages[verdict], make_diagnosis(verdict))
    assert len(walk.marked) > 40
    check(walk, data)


def test_a_replay_that_parted_from_its_prediction_opens_the_page_with_that_window(tmp_path: Path) -> None:
    """The recording that fits best is shown first, though others are missed more, and no time far from the window."""
    diagnosis = make_diagnosis("named", parted={"press_2": ((1.31, 1.52), (3.1, 3.2))})
    walk, data = walked(write_diagnosis_report(diagnosis, tmp_path / "a.html"), diagnosis)
    check(walk, data)
    assert any("While it was replayed, press_2 parted from its prediction:" in words for words in walk.words)
    marked = [a["data-at"] for a, _ in walk.marked]
    assert {f"/parted/press_2/{k}/{i}" for k in (0, 1) for i in (0, 1)} <= set(marked)
    first = (tmp_path / "a.html").read_text().partition('<div class="first">')[2].partition("</figure>")[0]
    shown = re.search(r"of press_2 .* instants from (\S+) to (\S+) s", first)
    assert shown is not None
    begin, end = float(shown[1]), float(shown[2])
    assert 1.0 < begin < 1.31 and 1.52 < end < 1.8
    assert "press_2 parted from its prediction: 1.31 to 1.52 s, 3.10 to 3.20 s" in diagnosis.table()


def test_many_recordings_are_numbers_of_the_result_too(tmp_path: Path) -> None:
    runs = (*RUNS, *((f"slide_{k}", True) for k in range(2, 9)))
    errors = tuple(make_errors(runs, before=9.0, after=7.1))
    amended = tuple(make_errors(runs, before=7.1, after=1.03))
    many = make_diagnosis("named", baseline=Misfit(48.0, 51.0, errors), amended=Misfit(1.0, 1.1, amended))
    walk, data = walked(write_diagnosis_report(many, tmp_path / "page.html"), many)
    check(walk, data)


@pytest.mark.parametrize("fault", ["value", "unit", "words"])
def test_the_walk_finds_what_is_not_in_the_result(diagnosis_pages: dict[str, Path], fault: str) -> None:
    walk, data = walked(diagnosis_pages["named"], make_diagnosis("named"))
    if fault == "value":
        data["effects"][0]["parameters"][0]["value"] *= 1.02
    elif fault == "unit":
        data["fit"]["baseline"]["errors"][0]["unit"] = "px"
    else:
        data["sentence"] = data["sentence"].replace("30 %", "31 %")
    with pytest.raises(AssertionError):
        check(walk, data)


def test_the_page_speaks_of_no_nats_and_no_squared_units(diagnosis_pages: dict[str, Path]) -> None:
    for page in diagnosis_pages.values():
        words = " ".join(Walk(page.read_text(encoding="utf-8")).words)
        assert not re.search(r"\bnats?\b|log evidence|mean square\b|squared", words, re.IGNORECASE)
