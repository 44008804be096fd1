"""What may be concealed: each changes the readings of a short motion; arms, sensors and clocks by hand; the signal."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.proof.truths import gel, strip
from sysid.proof.truths.arm import RIGID, ArmFaults, through
from sysid.proof.truths.camera import Pinhole
from sysid.proof.truths.conceal import LIBRARY, OUTSIDE, changes, draw
from sysid.proof.truths.noise import white
from sysid.proof.truths.paths import Path
from sysid.proof.truths.sensors import Clean, ClockFaults, WrenchFaults, noise_free
from sysid.proof.truths.signal import signal, whitened


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(LIBRARY))
def test_every_concealed_effect_shows(kind: str) -> None:
    rng = np.random.default_rng(1)
    if kind == "strip":
        stand = strip.draw_strip(rng)
        path = Path((0.0, strip.hanging(stand, -0.3) + 0.001, -0.3)).wait(0.05)
        path.move((0.0, -0.008, 0.0), 0.25).move((0.01, 0.0, 0.06), 0.2).wait(0.1)
    else:
        stand = gel.draw_pad(rng)
        path = Path((0.0, 0.0, 2e-5)).wait(0.03).move((0.0, 0.0, -stand.depth), 0.1).wait(0.1)
        path.move((1e-3, 0.0, 0.0), 0.1).move((0.0, 0.0, stand.depth + 1e-4), 0.1)

    def read(concealed: list) -> list:
        change = changes(stand, concealed)
        if kind == "strip":
            clean = strip.StripTruth(stand, change.strip, change.arm, elements=20, step_s=2e-3).run(path)
        else:
            clean = gel.PadTruth(stand, change.ball, change.arm, pitch_share=0.2).run(path)
        return [noise_free(clean, change.camera, change.wrench, change.clocks)]

    base = read([])
    assert np.array_equal(whitened(read([]), base, stand.levels), np.zeros_like(whitened(base, base, stand.levels)))
    for name in (*LIBRARY[kind], *OUTSIDE[kind]):
        change = np.abs(whitened(read([draw(rng, stand, name)]), base, stand.levels))
        assert np.isfinite(change).all() and change.max() > 1e-3, name


def test_arm_lags_and_plays() -> None:
    path = Path((0.0, 0.0, 0.0)).wait(0.2).move((1e-3, 0.0, 0.0), 0.5).wait(2.0).move((-1e-3, 0.0, 0.0), 0.5).wait(2.0)
    hand, measured = through(path, RIGID)
    assert hand is path and measured is path
    hand, measured = through(path, ArmFaults(play=(2e-4, 0.0, 0.0), offset=(0.0, 3e-4, 0.0)))
    assert hand(2.5) == pytest.approx([0.9e-3, 3e-4, 0.0])
    assert hand(5.0) == pytest.approx([1e-4, 3e-4, 0.0])
    assert measured(2.5) == pytest.approx([1e-3, 0.0, 0.0])
    hand, measured = through(path, ArmFaults(lag_s=0.1, delay_s=0.05, echo=True))
    t = np.linspace(0.3, 0.65, 9)
    assert (hand(t)[:, 0] < path(t - 0.05)[:, 0]).all()
    assert measured(t) == pytest.approx(path(t))
    assert hand(2.6) == pytest.approx([1e-3, 0.0, 0.0], abs=1e-7)


def still(seconds: float = 1.0) -> Clean:
    """A load that rises by 1 N/s along z, one marker that moves by 0.1 m/s along x, seen from above."""
    t = np.linspace(0.0, seconds, round(seconds / 1e-3) + 1)
    wrench = np.zeros((len(t), 6))
    wrench[:, 2] = t
    markers = np.zeros((len(t), 1, 3))
    markers[:, 0, 0] = 0.1 * t
    nowhere = lambda at: (np.zeros((len(at), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(at), 1)))  # noqa: E731
    return Clean(t, wrench, markers, nowhere, nowhere)


def above(**faults: object) -> Pinhole:
    turned = np.diag([1.0, -1.0, -1.0])
    return Pinhole(1000.0, (320.0, 240.0), (640, 480), np.array([0.0, 0.0, 1.0]), turned, **faults)  # type: ignore[arg-type]


def test_faults_of_sensors_and_clocks_by_hand() -> None:
    clean, sound = still(), above()
    wrench, uv = noise_free(clean, sound, WrenchFaults(), ClockFaults())
    assert wrench[50] == pytest.approx([0, 0, 0.5, 0, 0, 0], abs=1e-9)
    assert uv[15, 0] == pytest.approx([320.0 + 1000.0 * 0.05, 240.0])
    matrix = np.eye(6)
    matrix[0, 2] = 0.1
    faulty = WrenchFaults(matrix, bias=np.full(6, 0.2), drift=np.full(6, 0.3), filter_s=0.05)
    read, _ = noise_free(clean, sound, faulty, ClockFaults())
    late = 0.8 - 0.05
    assert read[80, 2] == pytest.approx(late + 0.2 + 0.3 * 0.8, abs=2e-3)
    assert read[80, 0] == pytest.approx(0.1 * late + 0.2 + 0.3 * 0.8, abs=2e-3)
    read, seen = noise_free(clean, sound, WrenchFaults(), ClockFaults(wrench_s=0.1, vision_s=-0.06))
    assert read[50, 2] == pytest.approx(0.4)
    assert seen[15, 0, 0] == pytest.approx(320.0 + 1000.0 * 0.056)
    _, bent = noise_free(clean, above(distortion=(0.2, 0.0, 0.0, 0.0, 0.0)), WrenchFaults(), ClockFaults())
    assert bent[15, 0, 0] == pytest.approx(320.0 + 1000.0 * 0.05 * (1 + 0.2 * 0.05**2))


def test_rolling_shutter_takes_low_rows_later() -> None:
    clean = still()
    clean.markers[..., 1] = -0.1
    _, uv = noise_free(clean, above(), WrenchFaults(), ClockFaults())
    _, rolled = noise_free(clean, above(line_s=1e-4), WrenchFaults(), ClockFaults())
    assert uv[15, 0, 1] == pytest.approx(340.0)
    assert rolled[15, 0, 0] - uv[15, 0, 0] == pytest.approx(1000.0 * 0.1 * 100 * 1e-4, rel=1e-6)


def test_signal_leaves_out_what_materials_absorb() -> None:
    levels = white(0.1, 0.1, 0.5)
    base = [(np.zeros((4, 6)), np.zeros((2, 3, 2)))]
    soft = [(np.tile([0, 0, 1.0, 0, 0, 0], (4, 1)), np.zeros((2, 3, 2)))]
    both = [(np.tile([0.3, 0, 5.0, 0, 0, 0], (4, 1)), np.zeros((2, 3, 2)))]
    assert signal(both, base, [soft], levels) == pytest.approx(np.sqrt(4) * 0.3 / 0.1)
    assert signal(soft, base, [soft], levels) == pytest.approx(0.0, abs=1e-9)
