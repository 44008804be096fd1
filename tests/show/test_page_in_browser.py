"""The page of 'show' in a real browser: it draws, turns and plays without a network, and fits a phone."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import SOFTWARE_GL, chromium

from sim_core.rigs import load_rig
from sysid.show.page import page
from sysid.show.subject import resting, still

pytestmark = pytest.mark.browser

COLOURED = """
const c = document.getElementById('gl'), d = document.createElement('canvas');
d.width = c.width; d.height = c.height; const g = d.getContext('2d'); g.drawImage(c, 0, 0);
const p = g.getImageData(0, 0, d.width, d.height).data; let n = 0, sum = 0;
for (let i = 0; i < p.length; i += 4) if (p[i + 3]) { n++; sum = (sum * 31 + p[i] + 7 * p[i + 1]) % 1000003; }
return [n / (p.length / 4), sum];
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium(*SOFTWARE_GL) as found:
        yield found


def moving_page(tmp_path: Path) -> Path:
    """The gel sensor carried down by 1 mm in five states, without mechanics."""
    from dataclasses import replace

    subject = still(load_rig("gel_sensor"))
    frames = [
        {**subject.layout.start, "finger": (np.array([0.0, 0.0, 0.005 - 0.00025 * k]), subject.frames[0]["finger"][1])}
        for k in range(5)
    ]
    states = resting(subject.layout, np.stack([subject.layout.carried(f) for f in frames]), frames)
    path = tmp_path / "view.html"
    path.write_text(page(replace(subject, times=np.arange(5.0), states=states, frames=tuple(frames)), {}))
    return path


@pytest.mark.parametrize("width", [390, 1280])
def test_the_page_draws_turns_and_plays(browser: Any, tmp_path: Path, width: int) -> None:
    size = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(moving_page(tmp_path).as_uri())

    def drawn(step: int) -> None:
        for _ in range(100):
            if browser.execute_script("return document.documentElement.dataset.drawn") == str(step):
                return
            time.sleep(0.1)
        raise AssertionError(f"state {step} was not drawn: {browser.get_log('browser')}")

    drawn(0)
    share, picture = browser.execute_script(COLOURED)
    assert share > 0.2
    browser.execute_script(
        "const t = document.getElementById('time'); t.value = 4; t.dispatchEvent(new Event('input'))"
    )
    drawn(4)
    moved = browser.execute_script(COLOURED)[1]
    assert moved != picture
    browser.execute_script("document.querySelector('[data-view=top]').click()")
    time.sleep(0.5)
    assert browser.execute_script(COLOURED)[1] != moved
    assert browser.execute_script("return document.documentElement.scrollWidth <= innerWidth")
    assert not [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert "49 of 49 points" in browser.execute_script("return document.querySelector('.eye + p').textContent")
