"""What 'show' draws: views that project right, surfaces that hide each other, files of every kind, words that fit."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sim_core.errors import ConfigError
from sim_core.rigs import Rig, load_rig, parse_rig, rig_to_yaml
from sim_core.rigs.load import config_folder
from sim_core.rigs.yamlfile import read_mapping
from sim_core.sensing.camera import project
from sysid.cli.app import main
from sysid.show.colouring import Colouring
from sysid.show.outputs import PAGE, PICTURE, show
from sysid.show.page import page
from sysid.show.payload import payload
from sysid.show.picture import Board
from sysid.show.raster import Skin, View, look_at, render
from sysid.show.scenery import Scenery, camera_view
from sysid.show.style import SOUGHT, by_value, rgb, round_length, round_up
from sysid.show.subject import resting, still, subject_of

WHITE = np.ones(3)
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


def square(z: float, colour: list[float], alpha: float = 1.0) -> Skin:
    corners = np.array([[-1.0, -1.0, z], [1.0, -1.0, z], [1.0, 1.0, z], [-1.0, 1.0, z]])
    return Skin(corners, SQUARE, np.repeat([colour], 4, axis=0), alpha, 0.0, 0.0)


def view(parallel: bool = False) -> View:
    scale = 20.0 if parallel else 100.0
    return View(np.array([0.0, 0.0, -5.0]), np.eye(3), (scale, scale), (32.0, 32.0), (64, 64), parallel)


@pytest.mark.parametrize("parallel", [False, True])
@pytest.mark.parametrize("order", [1, -1])
def test_the_nearer_surface_hides_the_other_whatever_the_order(parallel: bool, order: int) -> None:
    skins = [square(0.0, [1.0, 0.0, 0.0]), square(1e-5, [0.0, 0.0, 1.0])][::order]
    picture, _ = render(view(parallel), skins, WHITE)
    assert picture[32, 32].tolist() == [255, 0, 0]
    assert picture[2, 2].tolist() == [255, 255, 255]


def test_what_is_transparent_is_blended_over_what_is_behind_it_and_not_over_what_is_before_it() -> None:
    red, pane = square(0.0, [1.0, 0.0, 0.0]), [0.0, 0.0, 1.0]
    before, _ = render(view(), [red, square(-1.0, pane, 0.25)], WHITE)
    behind, _ = render(view(), [red, square(1.0, pane, 0.25)], WHITE)
    assert before[32, 32].tolist() == pytest.approx([191, 0, 64], abs=2)
    assert behind[32, 32].tolist() == [255, 0, 0]


def test_a_surface_covers_the_pixels_that_it_projects_to() -> None:
    picture, _ = render(view(), [square(0.0, [0.0, 0.0, 0.0])], WHITE)
    # 100 px at 5 m: 40 x 40 pixels.
    assert np.count_nonzero(picture[..., 0] < 128) == 40 * 40


def test_a_pixel_that_an_edge_crosses_has_the_mean_of_its_samples() -> None:
    half = replace(view(), centre_px=(32.5, 32.0))
    picture, _ = render(half, [square(0.0, [0.0, 0.0, 0.0])], WHITE)
    assert picture[32, 11:14, 0].tolist() == [255, 128, 0]


def test_of_a_closed_body_what_faces_away_is_not_drawn() -> None:
    front = square(0.0, [0.0, 0.0, 0.0])
    for triangles, drawn in ((SQUARE, False), (SQUARE[:, ::-1], True)):
        corner = front.vertices[triangles[0]]
        towards_eye = np.cross(corner[1] - corner[0], corner[2] - corner[0])[2] < 0.0
        assert towards_eye == drawn
        picture, _ = render(view(), [replace(front, triangles=triangles, closed=True)], WHITE)
        assert (picture[32, 32, 0] < 128) == drawn


@pytest.mark.parametrize("z", [0.0, 0.0137, 0.371, 1.93])
def test_a_plane_seen_from_straight_above_has_no_shades_of_depth(z: float) -> None:
    picture, _ = render(view(), [square(z, [1.0, 0.0, 0.0])], WHITE)
    inside = picture[28:36, 28:36].reshape(-1, 3)
    assert (inside == [255, 0, 0]).all()


def test_a_view_shows_all_points_as_near_as_it_can() -> None:
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (200, 3)) * [0.1, 0.05, 0.02]
    seen = look_at(points, np.array([0.5, 0.8, -0.3]), np.array([0.0, 0.0, 1.0]), (400, 300))
    pixel, depth = seen.project(points)
    assert (depth > 0.0).all()
    share = np.abs(pixel / [200.0, 150.0] - 1.0).max(axis=0)
    assert share.max() == pytest.approx(0.92, abs=0.01)


def test_the_eye_of_a_camera_puts_points_where_the_camera_does() -> None:
    layout = still(load_rig("card_press")).layout
    camera = layout.rig.cameras["outside"]
    frame = layout.camera_frame(camera, layout.start)
    points = layout.bodies["card"].rest
    pixel, _ = camera_view(camera, frame, camera.width_px).project(points)
    assert pixel == pytest.approx(project(camera, frame[1].inv().apply(points - frame[0])), abs=1e-6)


@pytest.mark.parametrize("name", ["gel_sensor", "balancing", "knit_acrylic_garter_x", "tactip_cr"])
def test_the_page_holds_what_it_shows_and_nothing_from_elsewhere(name: str) -> None:
    subject = still(load_rig(name))
    text = page(subject, {})
    assert len(text) < 5e6
    assert not re.findall(r"(?:src|href)\s*=|@import|https?://", text)
    head, block = payload(subject, {})
    raw = zlib.decompress(base64.b64decode(block))
    for body, skin in zip(head["bodies"], subject.skins, strict=True):
        entry = body["positions"]
        whole = np.frombuffer(raw, np.int16, entry["count"], entry["at"]).reshape(-1, 3)
        found = whole * head["unit"] + head["centre"]
        wanted = skin.vertices(subject.layout, subject.states.positions[0], subject.frames[0])
        assert np.abs(found - wanted).max() <= head["unit"]
    stored = re.search(r'id="head">(.*?)</script>', text, re.DOTALL)
    assert stored is not None
    assert json.loads(stored[1])["title"] == name


def test_where_things_are_to_be_is_drawn_in_picture_and_page() -> None:
    """Beyond all that there is, so that the view has to be wide enough for it, too."""
    points = np.array([[0.0, 0.0, 0.05], [0.03, 0.0, 0.05]])
    subject = replace(still(load_rig("gel_sensor")), sought={"block": points})
    board = Board(subject, None)
    picture, axes = board.draw(0), board._main.get_window_extent()
    for x, y in board._view.project(points)[0]:
        near = picture[round(picture.shape[0] - axes.y1 + y) - 6 :, round(axes.x0 + x) - 6 :][:13, :13].astype(int)
        assert (np.abs(near - (255 * rgb(SOUGHT)).round()).max(axis=2) < 60).sum() >= 8
    head, block = payload(subject, {})
    entry = head["sought"]["block"]
    whole = np.frombuffer(zlib.decompress(base64.b64decode(block)), np.int16, entry["count"], entry["at"])
    assert np.abs(whole.reshape(-1, 3) * head["unit"] + head["centre"] - points).max() <= head["unit"]
    assert "where it is to be in the end" in page(subject, {})
    assert "where it is to be" not in page(still(load_rig("gel_sensor")), {})


def test_a_legend_has_the_colours_in_which_bodies_are_drawn() -> None:
    subject = still(load_rig("gel_sensor"))
    kinds = {skin.kind: skin for skin in subject.skins}
    values = {s.body: np.zeros((1, len(s.local))) for s in subject.skins}
    coloured = Colouring("pressure", "kPa", "", values, 2.0)
    plain, valued = Scenery(subject, None), Scenery(subject, coloured)
    assert len(plain.swatch(kinds["gel"])) == len(plain.swatch(kinds["rigid"])) == 1
    ends = by_value(np.array([0.0, 2.0]), 2.0)
    np.testing.assert_allclose(valued.swatch(kinds["gel"])[[0, -1]], ends)
    drawn = {
        scenery: scenery.skins(0)[[s.body for s in subject.skins].index(kinds["rigid"].body)]
        for scenery in (plain, valued)
    }
    for scenery, skin in drawn.items():  # over white paper
        np.testing.assert_allclose(scenery.swatch(kinds["rigid"])[0], skin.alpha * skin.colours[0] + 1.0 - skin.alpha)


def test_words_of_a_rig_cannot_break_out_of_the_page() -> None:
    data = read_mapping(config_folder() / "rigs" / "gel_sensor.yaml")
    data["description"] = "</script><script>alert(1)</script>"
    text = page(still(parse_rig(data, "mischief")), {})
    assert "<script>alert" not in text


@pytest.mark.parametrize(("value", "up", "down"), [(0.0012, 0.0015, 0.001), (3.1, 5.0, 2.0), (70.0, 70.0, 50.0)])
def test_scales_end_at_round_numbers(value: float, up: float, down: float) -> None:
    assert round_up(value) == pytest.approx(up)
    assert round_length(value) == pytest.approx(down)


def short_press(tmp_path: Path) -> str:
    path = tmp_path / "short.yaml"
    path.write_text("name: short\nmotions: {finger: [{type: slide, by_m: [0.0, 0.0, -0.0015], speed_m_s: 0.03}]}\n")
    return str(path)


@pytest.mark.slow
def test_an_experiment_becomes_picture_page_and_animation(tmp_path: Path) -> None:
    out = tmp_path / "out"
    subject = show(load_rig("gel_sensor"), short_press(tmp_path), out, animation="gif")
    assert subject.findings == ()
    assert Image.open(out / PICTURE).size == (1760, 1100)
    with Image.open(out / "animation.gif") as moving:
        assert moving.n_frames == len(subject.times)  # type: ignore[attr-defined]
    text = (out / PAGE).read_text()
    assert '<option value="pressure">' in text and "curvature" not in re.findall(r'<option value="(\w*)"', text)
    (out / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match=r"notes\.txt"):
        show(load_rig("gel_sensor"), None, out)


def test_a_rig_that_cannot_be_simulated_is_shown_as_it_is_commanded(tmp_path: Path) -> None:
    data = read_mapping(config_folder() / "rigs" / "card_press.yaml")
    data["end_effectors"]["finger"]["start"]["position_m"] = [0.03, 0.0, 0.052]
    subject = subject_of(parse_rig(data, "through"), short_press(tmp_path))
    assert [f.kind for f in subject.findings] == ["not simulated", "bodies overlap"]
    assert subject.moves
    gel = subject.layout.bodies["gel"].nodes
    moved = subject.states.positions[-1][gel] - subject.states.positions[0][gel]
    assert moved == pytest.approx(np.tile([0.0, 0.0, -0.0015], (len(gel), 1)), abs=1e-9)


def test_what_was_measured_is_drawn_where_it_was_measured_however_far_markers_moved() -> None:
    start = still(load_rig("gel_sensor"))
    moved = start.layout.rest + np.array([4e-4, 0.0, 0.0])
    positions = np.stack([start.layout.rest, moved])
    frames = [start.layout.start] * 2
    subject = replace(
        start, times=np.array([0.0, 1.0]), states=resting(start.layout, positions, frames), frames=tuple(frames)
    )
    (camera,) = subject.rig.cameras
    pixels = np.stack([subject.pixels(camera, k) for k in (0, 1)])
    assert np.linalg.norm(pixels[1] - pixels[0], axis=1).max() > 1.0
    subject = replace(subject, tracks={camera: replace(subject.tracks[camera], measured=pixels)})
    board = Board(subject, None, small=True)
    board.draw(1)
    axes = board._cameras[camera]
    scale = board._size(axes)[1] / subject.rig.cameras[camera].height_px
    crosses = axes.collections[-1].get_offsets()
    assert np.abs(crosses - scale * pixels[1]).max() < 0.01 * np.abs(crosses).max()


def test_the_command_says_what_looks_wrong_and_where_the_files_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rig: Rig = load_rig("gel_sensor")
    camera = rig.cameras["inside"]
    blind = camera.model_copy(update={"pose": camera.pose.model_copy(update={"rpy_deg": (0.0, 0.0, 0.0)})})
    (tmp_path / "blind.yaml").write_text(rig_to_yaml(rig.model_copy(update={"cameras": {"inside": blind}})))
    assert main(["show", "blind.yaml"]) == 0
    output = capsys.readouterr()
    assert "warning: The camera inside sees none of its 49 markers" in output.err
    assert output.out.split() == ["show_gel_sensor/picture.png", "show_gel_sensor/view.html"]
    assert "sees none of its 49 markers" in (tmp_path / "show_gel_sensor" / "view.html").read_text()


@pytest.mark.parametrize(("words", "message"), [
    (["show", "gel_sensor", "--by", "presure"], "Did you mean 'pressure'?"),
    (["show", "gel_sensor", "--animation", "avi"], "--animation is 'avi'"),
    (["show", "gel_sensor", "none.npz"], "none.npz does not exist"),
    (["show", "gel_sensor", "pres_twist"], "Did you mean 'press_twist'?"),
    (["effects", "air_drg"], "Did you mean 'air_drag'?"),
])  # fmt: skip
def test_a_slip_of_the_pen_is_answered(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_effects_are_listed_and_described_in_full(capsys: pytest.CaptureFixture[str]) -> None:
    from sim_core.effects import all_effects

    assert main(["effects"]) == 0
    listed = capsys.readouterr().out
    assert all(effect.name in listed and effect.title in listed for effect in all_effects().values())
    assert main(["effects", "air_drag", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert found["name"] == "air_drag" and found["parameters"][0]["name"] == "drag_coefficient"
    assert main(["effects", "air_drag"]) == 0
    assert "effects: {air_drag: {drag_coefficient: ...}}" in capsys.readouterr().out
