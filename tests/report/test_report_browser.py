"""The reports in a real browser: they open from a file without a network, fit the screen, and are legible."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chromium import chromium
from report_examples import RUNS, make_diagnosis, make_errors, make_fit, make_series

from sysid.diagnosis.result import VERDICTS
from sysid.report import write_diagnosis_report, write_fit_report

pytest.importorskip("selenium.webdriver")

pytestmark = pytest.mark.browser

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
)
WIDTHS = (390, 1280)
PAGES = ("fit", "gaps", *VERDICTS)
SCHEMES = ("light", "dark")

LEAST_CONTRAST = """
const canvas = document.createElement('canvas'); canvas.width = canvas.height = 1;
const context = canvas.getContext('2d', {willReadFrequently: true});
const parse = (c) => {
    context.clearRect(0, 0, 1, 1); context.fillStyle = c; context.fillRect(0, 0, 1, 1);
    return [...context.getImageData(0, 0, 1, 1).data];
};
const light = (c) => {
    const l = c.slice(0, 3).map(v => v / 255).map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * l[0] + 0.7152 * l[1] + 0.0722 * l[2];
};
const background = (e) => {
    for (; e; e = e.parentElement) {
        const c = parse(getComputedStyle(e).backgroundColor);
        if (c[3] === 255) return c;
    }
    return [255, 255, 255, 255];
};
let worst = [99, '']; let seen = 0;
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
    const text = walker.currentNode.data.trim(); const e = walker.currentNode.parentElement;
    if (!text || ['SCRIPT', 'STYLE'].includes(e.tagName) || !e.checkVisibility()) continue;
    const style = getComputedStyle(e);
    const a = light(parse(e.namespaceURI.endsWith('svg') ? style.fill : style.color)), b = light(background(e));
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    seen += 1;
    if (contrast < worst[0]) worst = [contrast, text.slice(0, 60) + ' in ' + e.outerHTML.slice(0, 80)];
}
return [worst[0], worst[1], seen];
"""

SIZES = """
return [...document.querySelectorAll('svg, img')].filter(e => e.checkVisibility())
    .map(e => [e.getBoundingClientRect().width, e.getBoundingClientRect().height]);
"""

WIDER = """
const wide = document.documentElement.clientWidth;
const clipped = (e) => { for (; e; e = e.parentElement) if (getComputedStyle(e).overflowX !== 'visible') return true; };
return [...document.body.querySelectorAll('*')].filter(e => e.checkVisibility() && !e.closest('svg, .skip')
    && e.getBoundingClientRect().right > wide + 1 && !clipped(e.parentElement)).map(e => e.outerHTML.slice(0, 120));
"""


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser without a network."""
    with chromium(*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}") as started:
        started.execute_cdp_cmd("Network.enable", {})
        offline = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
        started.execute_cdp_cmd("Network.emulateNetworkConditions", offline)
        yield started


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A report of each kind, and a fit with long names and gaps."""
    folder = tmp_path_factory.mktemp("pages")
    out = {v: write_diagnosis_report(make_diagnosis(v), folder / f"{v}.html") for v in VERDICTS}
    out["fit"] = write_fit_report(make_fit(), folder / "fit.html")
    runs = (("2026-11-21_very_long_name_of_a_recording_" * 3, False),)
    long = make_fit(
        rig="a_rig_with_a_name_that_never_ends_" * 3,
        errors=make_errors(runs, before=1e9, after=float("nan")),
        series=make_series(runs, n=40),
        identifiability=[],
        converged=False,
        message="unbroken" * 30,
        notes=["note_without_spaces_" * 20],
    )
    out["gaps"] = write_fit_report(long, folder / "gaps.html")
    assert set(out) == set(PAGES) and RUNS
    return out


def show(driver: Any, path: Path, width: int = 1280, scheme: str = "light") -> None:
    """Open a page on a screen of a width and with a colour scheme."""
    screen = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 600}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    driver.get(path.as_uri())


@pytest.mark.parametrize("page", PAGES)
def test_it_opens_and_says_its_verdict_at_once(driver: Any, pages: dict[str, Path], page: str) -> None:
    driver.get_log("performance")
    show(driver, pages[page])
    assert driver.title.startswith(("Fit of ", "Diagnosis of "))
    heading = driver.find_element("css selector", "h1")
    assert heading.is_displayed() and len(heading.text) > 20
    assert heading.rect["y"] + heading.rect["height"] < 844, "the verdict is not on the first screen"
    assert driver.get_log("browser") == []
    requests = [e["message"] for e in driver.get_log("performance") if '"Network.requestWillBeSent"' in e["message"]]
    assert all(pages[page].as_uri() in r or '"url":"data:' in r for r in requests), requests


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("page", PAGES)
def test_it_fits_the_screen(driver: Any, pages: dict[str, Path], page: str, width: int) -> None:
    show(driver, pages[page], width)
    driver.execute_script("document.querySelectorAll('details').forEach(d => d.open = true)")
    inner, wide = driver.execute_script(
        "return [document.documentElement.clientWidth, document.documentElement.scrollWidth]"
    )
    assert wide <= inner <= width
    assert driver.execute_script(WIDER) == []
    sizes = driver.execute_script(SIZES)
    assert sizes and all(w > 20 and h > 5 for w, h in sizes), sizes


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("page", PAGES)
def test_every_text_stands_out_from_its_background(driver: Any, pages: dict[str, Path], page: str, scheme: str) -> None:
    show(driver, pages[page], scheme=scheme)
    driver.execute_script("document.querySelectorAll('details').forEach(d => d.open = true)")
    contrast, where, seen = driver.execute_script(LEAST_CONTRAST)
    assert seen > 100
    assert contrast >= 4.5, where


def test_dark_and_light_differ(driver: Any, pages: dict[str, Path]) -> None:
    colours = []
    for scheme in SCHEMES:
        show(driver, pages["named"], scheme=scheme)
        colours.append(driver.execute_script("return getComputedStyle(document.body).backgroundColor"))
    assert colours[0] != colours[1]


def test_details_open_with_the_keyboard(driver: Any, pages: dict[str, Path]) -> None:
    from selenium.webdriver.common.keys import Keys

    show(driver, pages["fit"])
    closed = driver.find_element("css selector", "details:not([open])")
    closed.find_element("css selector", "summary").send_keys(Keys.ENTER)
    assert closed.get_attribute("open") is not None


def test_it_prints(driver: Any, pages: dict[str, Path]) -> None:
    import base64

    show(driver, pages["named"], scheme="dark")
    printed = driver.execute_cdp_cmd("Page.printToPDF", {"printBackground": False})
    data = base64.b64decode(printed["data"])
    assert data.startswith(b"%PDF") and data.count(b"/Type /Page\n") < 20
