"""What policies see: the components of observations that stand out of the noise, and how far the episode is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.policies.encoder import EXACT, MOST, fitted, read_encoder

NOISE = np.array([0.01, 0.01, 0.01, 1.0, 0.0, 0.0])


def observations(materials: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Of episodes with one number of a material each, which the first two entries tell; ``(n, 4, 6)``."""
    count = len(materials)
    drift = np.linspace(0.0, 5.0, 4)[None, :]
    shown = 0.1 * materials[:, None]
    entries = [shown + drift, -2.0 * shown + drift, np.zeros((count, 4)), np.zeros((count, 4)), np.zeros((count, 4))]
    made = np.tile(np.linspace(0.0, 1.0, 4), (count, 1))
    seen = np.stack([*entries, made], axis=2)
    return np.asarray(seen + NOISE * rng.standard_normal(seen.shape))


def test_what_tells_of_the_material_is_seen_and_noise_is_not() -> None:
    rng = np.random.default_rng(0)
    materials = rng.standard_normal(50)
    encoder = fitted(observations(materials, rng), NOISE)
    assert encoder.size == 2
    others = rng.standard_normal(200)
    for k, episode in enumerate(np.swapaxes(observations(others, rng), 0, 1)):
        seen = encoder.encode(episode)
        assert abs(np.corrcoef(seen[:, 0], others)[0, 1]) > 0.99, "not hidden by the noise of the fourth entry"
        assert 0.7 < seen[:, 0].std() < 1.4 and abs(seen[:, 0].mean()) < 0.3, "of order one before every decision"
        assert seen[:, 1] == pytest.approx(2.0 * k / 3.0 - 1.0)


def test_without_noise_an_entry_counts_by_its_scale() -> None:
    rng = np.random.default_rng(1)
    seen = np.zeros((40, 2, 3))
    seen[:, :, 0] = 10.0 * EXACT * rng.standard_normal((40, 1))
    seen[:, :, 1] = 0.1 * EXACT * rng.standard_normal((40, 1))
    seen[:, 1, 2] = 1.0
    encoder = fitted(seen, np.zeros(3))
    assert encoder.size == 2
    far = encoder.encode(np.array([[1e6, 0.0, 1.0]]))
    assert abs(far[0, 0]) == MOST


def test_an_encoder_is_read_as_it_was_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    seen = observations(rng.standard_normal(20), rng)
    encoder = fitted(seen, NOISE)
    encoder.write(tmp_path / "encoder.npz")
    assert np.array_equal(read_encoder(tmp_path / "encoder.npz").encode(seen[0]), encoder.encode(seen[0]))
    (tmp_path / "encoder.npz").write_bytes(b"PK")
    with pytest.raises(ConfigError, match=r"encoder.npz cannot be read.*Train anew"):
        read_encoder(tmp_path / "encoder.npz")
