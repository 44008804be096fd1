"""Makes the pictures of the documentation and of the README (``make pictures``); needs Chromium and chromedriver.

The report that is photographed is that of ``make demo``, which has to have been run before. Arguments: the folder of
the demonstration (default: out/demo) and the folder for the pictures (default: docs/pictures).
"""

from __future__ import annotations

import io
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image

from sim_core.rigs import load_rig
from sysid.demo import DEFAULT
from sysid.report import REPORT
from sysid.show import show

ROOT = Path(__file__).resolve().parents[2]
SECTIONS = {"verdict": "header.hero", "how_sure": "#how-sure", "where": "#where", "held_out": "#held-out"}
"""Pictures of the report of a diagnosis, each with the selector of what it shows."""
SHOWN = {"card_press": ("card_press", "press_post"), "gel_sensor": ("gel_sensor", "press_twist")}
"""Pictures by ``thinshell show``: rig and experiment."""
WIDTH, SCALE = 1000, 1.4
"""Width of the window [px], and pixels of a picture for one of the window."""
COLOURS = 256
"""Colours of a picture of a page, which make it a third as large."""


@contextmanager
def browser() -> Iterator[Any]:
    """Headless Chromium."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium") or shutil.which("google-chrome"))
    for flag in ("--headless=new", "--no-sandbox", "--hide-scrollbars", "--disable-dev-shm-usage"):
        options.add_argument(flag)
    with webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver"))) as found:
        yield found


def of_report(page: Path, out: Path) -> None:
    """Parts of the report ``page`` of a diagnosis, one file each."""
    with browser() as driver:
        screen = {"width": WIDTH, "height": 900, "deviceScaleFactor": SCALE, "mobile": False}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        driver.get(page.resolve().as_uri())
        for name, selector in SECTIONS.items():
            element = driver.find_element("css selector", selector)
            save(Image.open(io.BytesIO(element.screenshot_as_png)), out / f"{name}.png", few=True)


def of_rigs(out: Path) -> None:
    """Rigs at the most telling moment of an experiment."""
    for name, (rig, experiment) in SHOWN.items():
        with tempfile.TemporaryDirectory() as folder:
            show(load_rig(rig), experiment, Path(folder) / "shown", animation="none")
            save(Image.open(Path(folder) / "shown" / "picture.png"), out / f"{name}.png")


def save(picture: Image.Image, path: Path, few: bool = False) -> None:
    """Write a picture that is no wider than a page. ``few``: with few colours."""
    whole = picture.convert("RGB")
    most = round(WIDTH * SCALE)
    if whole.width > most:
        whole = whole.resize((most, round(whole.height * most / whole.width)), Image.Resampling.LANCZOS)
    if few:
        whole = whole.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    whole.save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def main(demo: Path = ROOT / DEFAULT, out: Path = ROOT / "docs" / "pictures") -> int:
    """All pictures."""
    page = demo / REPORT
    if not page.is_file():
        print(f"There is no {page}: run 'make demo' first.", file=sys.stderr)
        return 2
    out.mkdir(exist_ok=True)
    of_report(page, out)
    of_rigs(out)
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:])))
