"""Animations: true speed, one picture over another without traces, and the pane that stays the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

from sim_core.rigs import load_rig
from sysid.show.animation import animate, chosen_states, durations
from sysid.show.pane import Pane
from sysid.show.picture import Board
from sysid.show.subject import Subject, resting, still


@pytest.fixture(scope="module")
def lowered() -> Subject:
    """The gel sensor carried down in seven states at uneven times, without mechanics."""
    subject = still(load_rig("gel_sensor"))
    origin, turn = subject.frames[0]["finger"]
    times = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 4.0])
    frames = [{**subject.layout.start, "finger": (origin - [0.0, 0.0, 0.0005 * t], turn)} for t in times]
    states = resting(subject.layout, np.stack([subject.layout.carried(f) for f in frames]), frames)
    return replace(subject, times=times, states=states, frames=tuple(frames))


@pytest.mark.parametrize(("count", "seconds", "shown"), [(96, 2.0, 17), (96, 12.0, 48), (5, 2.0, 5), (2, 2.0, 2)])
def test_eight_states_a_second_are_shown_with_the_first_and_the_last(count: int, seconds: float, shown: int) -> None:
    found = chosen_states(count, seconds)
    assert len(found) == shown
    assert (found[0], found[-1]) == (0, count - 1)


def test_pictures_come_when_they_are_due_to_a_hundredth_of_a_second() -> None:
    times = np.linspace(0.3, 5.0, 39)
    stays = durations(times, 4.7)
    assert all(stay % 10 == 0 for stay in stays)
    due = np.concatenate([[0], np.cumsum(stays)[:-1]])
    assert np.abs(due - 1000.0 * (times - 0.3)).max() <= 5.001


def test_a_gif_plays_at_the_true_speed_in_its_true_colours(lowered: Subject, tmp_path: Path) -> None:
    reported: list[float] = []
    animate(lowered, None, tmp_path / "a.gif", lambda share, text: reported.append(share))
    assert reported[-1] == 1.0
    board = Board(lowered, None, small=True)
    with Image.open(tmp_path / "a.gif") as moving:
        assert moving.n_frames == 7  # type: ignore[attr-defined]
        stays = []
        for k in range(7):
            moving.seek(k)
            stays.append(moving.info["duration"])
            off = np.asarray(moving.convert("RGB")).astype(int) - board.draw(k)
            assert np.abs(off).mean() < 1.5
            assert off[-1, -1].tolist() == [0, 0, 0]
    assert stays[:6] == [500, 500, 500, 500, 500, 1500]


def test_a_picture_keeps_no_traces_of_the_one_before(lowered: Subject) -> None:
    board = Board(lowered, None, small=True)
    first = board.draw(0)
    assert np.abs(board.draw(6).astype(int) - first).max() > 100
    assert np.array_equal(board.draw(0), first)


def test_a_pane_lies_over_pictures_and_under_what_is_drawn_above_it() -> None:
    figure = Figure(figsize=(1.0, 1.0), dpi=100, facecolor="none")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 0.5, 1.0), facecolor="none")
    axes.axis("off")
    axes.add_patch(Rectangle((0.0, 0.0), 1.0, 0.5, facecolor="#0000ff", alpha=0.5, linewidth=0))
    pane = Pane(canvas)
    bar = axes.add_patch(Rectangle((0.0, 0.0), 1.0, 0.25, facecolor="#00ff00", linewidth=0))
    for _ in range(2):
        pane.begin()
        pane.put(axes, np.full((100, 50, 3), [255, 0, 0], dtype=np.uint8))
        drawn = pane.finish([bar])
        assert drawn[25, 25].tolist() == [255, 0, 0]
        assert drawn[60, 25].tolist() == pytest.approx([127, 0, 128], abs=1)
        assert drawn[90, 25].tolist() == [0, 255, 0]
        assert drawn[50, 75].tolist() == [255, 255, 255]
