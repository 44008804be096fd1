"""The live viewer in a real browser: it draws the scene, says what is wrong with it, and goes to another instant."""

from __future__ import annotations

import io
import shutil
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image

from sysid.show.colouring import colourings
from sysid.show.live import Viewer
from tests.show.test_page_in_browser import FLAGS
from tests.show.test_show_live import pressed_gel

webdriver = pytest.importorskip("selenium.webdriver")

pytestmark = pytest.mark.browser

PATIENCE_S = 60.0
RED = (150, 90, 90)
"""The strained gel is redder than its ground: at least the first, at most the others."""


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    pytest.importorskip("viser", reason="viser, of the extra 'live', is not installed.")
    subject = pressed_gel()
    found = Viewer(subject, colourings(subject), port=0)
    yield found
    found.stop()


@pytest.fixture
def browser() -> Iterator[Any]:
    chromium, driver = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("Chromium and chromedriver are not installed.")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in (*FLAGS, "--window-size=1200,800"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    with webdriver.Chrome(options, webdriver.ChromeService(driver)) as found:
        yield found


def red(browser: Any) -> float:
    """Share of the picture, left of the controls, that is as red as a strained gel."""
    picture = np.asarray(Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB")).astype(int)[:, :850]
    return float(np.mean((picture[..., 0] > RED[0]) & (picture[..., 1] < RED[1]) & (picture[..., 2] < RED[2])))


def until(browser: Any, holds: Any) -> bool:
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if holds():
            return True
        time.sleep(0.5)
    return False


def test_the_scene_is_drawn_and_goes_to_another_instant(viewer: Viewer, browser: Any) -> None:
    viewer.colour("strain")
    viewer.show(0.4)
    browser.get(viewer.address)
    assert until(browser, lambda: "strain [%]" in browser.execute_script("return document.body.innerText"))
    said = browser.execute_script("return document.body.innerText")
    assert "overlap at the start" in said and "cannot see any of its 49 markers" in said
    assert until(browser, lambda: red(browser) > 0.003), "the squeezed gel is drawn in the colour of its strain"
    viewer.show(0.0)
    assert until(browser, lambda: red(browser) < 0.001), "the gel at rest is pale"
    assert not [line for line in browser.get_log("browser") if line["level"] == "SEVERE"]
