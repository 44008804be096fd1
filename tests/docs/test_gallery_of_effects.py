"""The pictures of the catalogue of effects: one for each, small, and of what the effect does."""

from __future__ import annotations

from pathlib import Path

import effects_catalogue
import gallery
import numpy as np
import pytest
from PIL import Image

from sim_core.effects import all_effects, effect_by_name

PICTURES = Path(gallery.OUT)
LARGEST_BYTES = 40_000


def test_pictures_are_of_effects_that_exist_and_small() -> None:
    drawn = {path.stem for path in PICTURES.glob("*.png")}
    assert drawn and drawn <= set(all_effects())
    assert max(path.stat().st_size for path in PICTURES.glob("*.png")) < LARGEST_BYTES


def test_the_catalogue_shows_the_pictures_that_there_are() -> None:
    page = effects_catalogue.page()
    for name in all_effects():
        assert (f"pictures/effects/{name}.png" in page) == (PICTURES / f"{name}.png").is_file()


@pytest.fixture(scope="module")
def pulled(tmp_path_factory: pytest.TempPathFactory) -> gallery.Stage:
    return gallery.stage("strip_coarse", "pull_taut", tmp_path_factory.mktemp("gallery"))


def test_the_signature_of_a_force_that_is_scaled_is_in_the_force(pulled: gallery.Stage, tmp_path: Path) -> None:
    effect = effect_by_name("wrench_gain")
    found = gallery.signature(effect, pulled)
    assert found is not None and found.measured.kind == "wrench" and found.column < 3
    assert found.largest == pytest.approx(np.abs(found.with_it - found.without).max() / found.noise)
    gallery.draw(effect, found, tmp_path / "gain.png")
    assert Image.open(tmp_path / "gain.png").width > 400


def test_an_effect_that_cannot_act_has_no_signature(pulled: gallery.Stage) -> None:
    assert gallery.signature(effect_by_name("gel_relaxation"), pulled) is None


def test_an_effect_that_there_is_not_is_an_error_that_names_the_nearest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert gallery.main(["wrench_gian"], tmp_path / "out") == 2
    assert capsys.readouterr().err == "error: No effect is called 'wrench_gian'. Did you mean 'wrench_gain'?\n"
    assert not (tmp_path / "out").exists()
