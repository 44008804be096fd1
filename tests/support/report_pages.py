"""What a report is as a file, and what holds for every one: complete and self-contained."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

from sysid.diagnosis.result import Diagnosis
from sysid.fit.result import FitResult
from sysid.report import write_diagnosis_report, write_fit_report

VOID = {"meta", "link", "br", "img", "input", "hr", "rect", "path", "use", "source"}


class Page(HTMLParser):
    """What a page holds; raises on tags that do not match."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.ids: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.numbers: set[float] = set()
        self.text = ""
        self.scripts: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for key, value in attrs:
            self.attributes.append((tag, key, value or ""))
            if key == "id":
                self.ids.append(value or "")
            if (tag, key) == ("data", "value"):
                self.numbers.add(float(value or "nan"))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open and self.open[-1] == tag, (tag, self.open[-3:], self.getpos())
            self.open.pop()

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts.append(data)
        elif not self.open or self.open[-1] != "style":
            self.text += data

    @property
    def words(self) -> str:
        return " ".join(self.text.split())


def fit_page(tmp_path: Path, result: FitResult) -> Page:
    path = write_fit_report(result, tmp_path / "fit.html")
    assert path == tmp_path / "fit.html"
    return checked(path)


def diagnosis_page(tmp_path: Path, diagnosis: Diagnosis) -> Page:
    return checked(write_diagnosis_report(diagnosis, tmp_path / "diagnosis.html"))


def checked(path: Path) -> Page:
    """What holds for every report."""
    text = path.read_text(encoding="utf-8")
    assert len(text.encode()) < 5_000_000
    page = Page(text)
    assert len(page.ids) == len(set(page.ids)), "an id occurs twice"
    for tag, key, value in page.attributes:
        if key in ("src", "href", "srcset", "data", "poster", "action"):
            assert value.startswith(("#", "data:")), (tag, key, value)
    for pattern in (r"https?://", r"@import", r"url\((?!#)"):
        assert not re.search(pattern, text), pattern
    assert not re.search(r"\b(nan|NaN|None(?! (is|was|of) )|inf|Infinity|Undefined)\b", page.words), page.words
    targets = {v[1:] for _, k, v in page.attributes if k == "href" and v.startswith("#")}
    clips = set(re.findall(r"url\(#([^)]*)\)", text))
    assert targets | clips <= set(page.ids)
    assert "#0a0b" not in text, "a colour was not replaced"
    for tag, key, value in page.attributes:
        assert (tag, key) != ("svg", "aria-label") or value
    return page
