"""Detection of dots on images drawn with known dot positions."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sysid.vision import DetectionParameters, detect_markers
from sysid.vision.render import draw_dots

RNG_SEED = 7


def draw(
    centres: np.ndarray,
    *,
    size: tuple[int, int] = (240, 200),
    diameter: float = 11.0,
    ground: np.ndarray | float = 0.0,
    dot: float = 255.0,
    fine: int = 5,
) -> np.ndarray:
    """Draw discs with smooth edges by supersampling; ``size`` is width, height; float image."""
    width, height = size
    offsets = (np.arange(fine) + 0.5) / fine - 0.5
    u = (np.arange(width)[:, None] + offsets).reshape(-1)
    v = (np.arange(height)[:, None] + offsets).reshape(-1)
    inside = np.zeros((height * fine, width * fine), dtype=bool)
    for cu, cv in centres:
        columns = np.flatnonzero(np.abs(u - cu) <= diameter)
        rows = np.flatnonzero(np.abs(v - cv) <= diameter)
        if not columns.size or not rows.size:
            continue
        patch = (u[columns][None, :] - cu) ** 2 + (v[rows][:, None] - cv) ** 2 <= diameter**2 / 4.0
        inside[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] |= patch
    cover = inside.reshape(height, fine, width, fine).mean(axis=(1, 3))
    return np.broadcast_to(ground, cover.shape) * (1.0 - cover) + dot * cover


def grid(pitch: float = 19.3, size: tuple[int, int] = (240, 200), margin: float = 15.0) -> np.ndarray:
    """Return dot centres that sit at all fractions of a pixel."""
    u, v = np.meshgrid(np.arange(margin, size[0] - margin, pitch), np.arange(margin, size[1] - margin, pitch))
    centres = np.stack([u.ravel(), v.ravel()], axis=1)
    return centres + np.random.default_rng(RNG_SEED).uniform(-1.0, 1.0, centres.shape)


def errors(found_uv: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return the distance [px] of each true centre to the nearest detection."""
    return np.linalg.norm(centres[:, None, :] - found_uv[None, :, :], axis=2).min(axis=1)


def coloured_ground(size: tuple[int, int]) -> np.ndarray:
    """Return uneven light such as that of a gel lit from the sides in three colours, shape (h, w, 3)."""
    v, u = np.mgrid[: size[1], : size[0]] / max(size)
    return np.stack([90 + 90 * u, 130 + 40 * v, 190 - 80 * u - 30 * v], axis=2)


def dark_dots(centres: np.ndarray, size: tuple[int, int], noise: float, diameter: float) -> np.ndarray:
    """Return an RGB image of dark dots on a coloured ground."""
    cover = draw(centres, size=size, diameter=diameter, dot=1.0)[..., None]
    image = coloured_ground(size) * (1.0 - 0.75 * cover)
    image = image + np.random.default_rng(RNG_SEED).normal(0.0, noise, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


def test_binary_dots_are_found_to_a_tenth_of_a_pixel() -> None:
    centres = grid()
    image = np.where(draw(centres) > 127.0, 255, 0).astype(np.uint8)
    found = detect_markers(image)
    assert len(found) == len(centres)
    error = errors(found.uv, centres)
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert error.max() < 0.2
    assert not found.merged.any()
    assert found.diameter_px == pytest.approx(11.0, rel=0.06)


@pytest.mark.parametrize("diameter", [6.0, 8.0, 10.0, 16.0, 24.0])
def test_smooth_dots_are_found_to_a_tenth_of_a_pixel_wherever_they_lie_on_its_grid(diameter: float) -> None:
    """Pixels at the rim count by how far they are beyond the threshold: none jumps into the centroid or out of it."""
    rng = np.random.default_rng(0)
    lattice = 20.0 + 2.5 * diameter * np.stack(np.meshgrid(np.arange(5), np.arange(3)), axis=-1).reshape(-1, 2)
    for _ in range(20):
        places = lattice + rng.uniform(0.0, 1.0, (15, 2))
        found = detect_markers(draw_dots(places, diameter, int(40 + 12 * diameter), int(40 + 8 * diameter))).uv
        assert len(found) == 15
        assert np.linalg.norm(found[:, None] - places, axis=-1).min(axis=0).max() < 0.1


def test_specks_and_streaks_do_not_count() -> None:
    centres = grid()
    image = np.where(draw(centres) > 127.0, 255, 0).astype(np.uint8)
    rng = np.random.default_rng(RNG_SEED)
    image[rng.integers(0, 200, 150), rng.integers(0, 240, 150)] = 255
    image[5:8, 20:200] = 255
    found = detect_markers(image)
    assert len(found) == len(centres)
    assert errors(found.uv, centres).max() < 0.6


def test_hairs_between_dots_do_not_join_them() -> None:
    centres = grid()
    image = np.where(draw(centres) > 127.0, 255, 0).astype(np.uint8)
    for u, v in centres.round().astype(int)[::3]:
        image[v, u : u + 20] = 255
        image[v : v + 20, u] = 255
    found = detect_markers(image)
    assert len(found) == len(centres)
    assert not found.merged.any()
    assert errors(found.uv, centres).max() < 0.4


@pytest.mark.parametrize("diameter", [6.0, 11.0, 18.0])
@pytest.mark.parametrize("polarity", ["bright", "dark"])
def test_grey_dots_with_noise_are_found_to_a_tenth_of_a_pixel(diameter: float, polarity: str) -> None:
    centres = grid(pitch=2.0 * diameter)
    dot, ground = (180.0, 60.0) if polarity == "bright" else (60.0, 180.0)
    image = draw(centres, diameter=diameter, ground=ground, dot=dot)
    image = image + np.random.default_rng(RNG_SEED).normal(0.0, 4.0, image.shape)
    found = detect_markers(np.clip(image, 0, 255).astype(np.uint8))
    assert len(found) == len(centres)
    error = errors(found.uv, centres)
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert found.diameter_px == pytest.approx(diameter, rel=0.25)


def test_dark_dots_on_uneven_coloured_light() -> None:
    size = (320, 240)
    centres = grid(pitch=30.0, size=size, margin=25.0)
    found = detect_markers(dark_dots(centres, size, noise=4.0, diameter=9.0))
    assert len(found) == len(centres)
    error = errors(found.uv, centres)
    assert np.sqrt(np.mean(error**2)) < 0.1


@pytest.mark.parametrize("gap", [8.0, 9.5, 10.9])
def test_touching_dots_are_cut_apart_and_trusted_less(gap: float) -> None:
    centres = np.concatenate([grid()[:60], [[225.3, 60.2], [225.3, 60.2 + gap]]])
    centres = centres[errors(centres[-2:], centres) > -1]
    far = np.linalg.norm(centres[:-2, None] - centres[None, -2:], axis=2).min(axis=1) > 14.0
    centres = np.concatenate([centres[:-2][far], centres[-2:]])
    image = np.where(draw(centres) > 127.0, 255, 0).astype(np.uint8)
    found = detect_markers(image)
    assert len(found) == len(centres)
    near = np.linalg.norm(found.uv[:, None] - centres[None, -2:], axis=2).argmin(axis=0)
    assert found.merged[near].all()
    assert found.merged.sum() == 2
    assert errors(found.uv, centres)[-2:].max() < 1.0
    assert found.quality[near].max() < 0.6 < found.quality[~found.merged].min()


def test_a_dot_cut_by_the_edge_is_trusted_less() -> None:
    centres = np.concatenate([grid(), [[239.0, 100.0]]])
    inner = np.linalg.norm(centres[:-1] - centres[-1], axis=1) > 14.0
    centres = np.concatenate([centres[:-1][inner], centres[-1:]])
    found = detect_markers(np.where(draw(centres) > 127.0, 255, 0).astype(np.uint8))
    edge = int(np.argmax(found.uv[:, 0]))
    assert found.quality[edge] < 0.5
    assert np.delete(found.quality, edge).min() > 0.8


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((100, 120), np.uint8), "uniform"),
        (np.full((100, 120), 255, np.uint8), "uniform"),
        (np.full((100, 120, 3), 93, np.uint8), "uniform"),
    ],
)
def test_an_empty_image_gives_no_markers_and_says_why(image: np.ndarray, words: str) -> None:
    found = detect_markers(image)
    assert len(found) == 0
    assert words in found.note
    assert found.image_size == (120, 100)


def test_a_gel_without_dots_gives_no_markers() -> None:
    rng = np.random.default_rng(RNG_SEED)
    image = coloured_ground((320, 240)) + rng.normal(0.0, 3.0, (240, 320, 3))
    found = detect_markers(np.clip(image, 0, 255).astype(np.uint8))
    assert len(found) == 0
    assert "times the noise of the ground" in found.note
    image[100:104, 140:143] = 30.0
    found = detect_markers(np.clip(image, 0, 255).astype(np.uint8))
    assert len(found) == 0
    assert "specks" in found.note


def test_parameters_that_cannot_work_are_refused() -> None:
    with pytest.raises(ConfigError, match="polarity is 'blue'"):
        DetectionParameters(polarity="blue")
    with pytest.raises(ConfigError, match="diameter_px is 0"):
        DetectionParameters(diameter_px=0.0)
