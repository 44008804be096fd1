"""The site: it is built without a warning, its links are whole, and a browser shows it without a network."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest
from chromium import chromium
from public_api import PUBLIC, names

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as 'make docs' does."""
    pytest.importorskip("mkdocs", reason="mkdocs is not installed: pip install '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    made = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
    assert made.returncode == 0, made.stdout + made.stderr
    return folder


class _Links(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {key: value or "" for key, value in attrs}
        self.anchors |= {given[key] for key in ("id", "name") if key in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag in ("script", "img", "link") and given.get("rel") not in ("canonical", "prev", "next"):
            self.loads += [given[key] for key in ("src", "href") if given.get(key)]


def parsed(page: Path) -> _Links:
    parser = _Links()
    parser.feed(page.read_text())
    return parser


def test_all_links_lead_somewhere_and_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    pages = {page: parsed(page) for page in site.rglob("*.html") if page.name != "404.html"}
    assert len(pages) > 50
    broken = []
    for page, found in pages.items():
        for link in found.links + found.loads:
            parts = urlsplit(link)
            if parts.scheme or link.startswith("//"):
                if link in found.loads and parts.scheme != "data":
                    broken.append((page.name, link))
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            target = target / "index.html" if target.is_dir() else target
            if not target.exists():
                broken.append((page.name, link))
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                if not parts.fragment.startswith("__"):
                    broken.append((page.name, link))
    assert broken == []


def test_every_public_name_has_its_place(site: Path) -> None:
    for module in PUBLIC:
        anchors = parsed(site / "reference" / "api" / f"{module}.html").anchors
        missing = [name for name in names(module) if not any(a.split(".")[-1] == name for a in anchors)]
        assert not missing, (module, missing)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium without a network."""
    with chromium("--disable-gpu", "--host-resolver-rules=MAP * ~NOTFOUND") as found:
        yield found


def sized(browser: Any, width: int) -> None:
    """Set the width of the window [px]."""
    screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)


@pytest.mark.browser
@pytest.mark.parametrize("width", [390, 1280])
def test_every_page_is_shown_from_a_folder(site: Path, browser: Any, width: int) -> None:
    sized(browser, width)
    wide = "return document.scrollingElement.scrollWidth - window.innerWidth"
    for page in sorted(site.rglob("*.html")):
        if page.name == "404.html":  # for servers
            continue
        browser.get(page.as_uri())
        assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
        assert browser.find_element("tag name", "h1").is_displayed()
        assert browser.execute_script(wide) <= 1, f"something of {page.name} is wider than the window"


@pytest.mark.browser
def test_search_finds_friction_in_pages_opened_from_a_folder(site: Path, browser: Any) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    sized(browser, 1280)
    browser.get((site / "tutorials" / "without_ros.html").as_uri())
    box = browser.find_element("css selector", "input.md-search__input")
    box.click()
    box.send_keys("friction")
    hits = WebDriverWait(browser, 30).until(lambda b: b.find_elements("css selector", "a.md-search-result__link"))
    assert any("friction" in hit.get_attribute("textContent").lower() for hit in hits)
    assert all(hit.get_attribute("href").startswith(site.as_uri()) for hit in hits)
