"""The live viewer: what its nodes hold at each instant, what a browser is sent, and how it is refused."""

from __future__ import annotations

import io
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from chromium import SOFTWARE_GL, chromium

from sim_core.rigs import load_rig
from sysid.cli.app import main
from sysid.show.colouring import colourings
from sysid.show.glb import binary_gltf, linear
from sysid.show.live import Viewer
from sysid.show.raster import Skin
from sysid.show.scenery import Scenery
from sysid.show.subject import Subject, resting, still

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

PATIENCE_S = 300.0


def pressed_gel() -> Subject:
    """The gel sensor and a block carried down in five states, the gel squeezed more and more, without mechanics."""
    rig = load_rig("gel_sensor")
    block = rig.bodies["block"].model_copy(update={"mount": "finger"})
    subject = still(rig.model_copy(update={"bodies": {**rig.bodies, "block": block}}))
    layout = subject.layout
    origin, turn = subject.frames[0]["finger"]
    frames = [{**layout.start, "finger": (origin - [0.0, 0.0, 0.00025 * k], turn)} for k in range(5)]
    x = np.stack([layout.carried(f) for f in frames])
    gel = layout.bodies["gel"].nodes
    x[:, gel, 2] += 0.02 * np.arange(5)[:, None] * (x[:, gel, 2] - x[:, gel, 2].mean(axis=1, keepdims=True))
    states = resting(layout, x, frames)
    return replace(subject, times=np.linspace(0.0, 0.4, 5), states=states, frames=tuple(frames), what="experiment")


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    pytest.importorskip("viser", reason="viser, of the extra 'live', is not installed.")
    subject = pressed_gel()
    found = Viewer(subject, colourings(subject), port=0)
    yield found
    found.stop()


def read_glb(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, and colours from 0 to 1 as stored, as trimesh reads them."""
    import trimesh

    (mesh,) = trimesh.load(io.BytesIO(data), file_type="glb", process=False).geometry.values()
    return np.asarray(mesh.vertices), np.asarray(mesh.visual.vertex_attributes["color"])[:, :3] / 65535.0


def test_intensities_are_those_of_the_standard() -> None:
    # IEC 61966-2-1: half of the scale is 21.4 % of the light; the straight part has the slope 1 / 12.92.
    assert linear(np.array([0.0, 0.04, 0.5, 1.0])) == pytest.approx([0.0, 0.04 / 12.92, 0.21404, 1.0], abs=1e-5)


def test_a_surface_is_read_back_from_its_file() -> None:
    pytest.importorskip("trimesh", reason="trimesh, of the extra 'live', is not installed.")
    corners = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.01]])
    colours = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.5, 0.5, 0.0]])
    vertices, found = read_glb(binary_gltf(Skin(corners, np.array([[0, 1, 2]]), colours)))
    assert vertices == pytest.approx(corners, abs=1e-8)
    assert found == pytest.approx(linear(colours), abs=0.003)


@pytest.mark.parametrize("quantity", ["body", "displacement", "strain"])
def test_each_instant_shows_its_own_state(viewer: Viewer, quantity: str) -> None:
    subject, scene = viewer._subject, viewer.scene
    viewer.colour(quantity)
    scenery = Scenery(subject, colourings(subject).get(quantity))
    for k in (3, 0, 4, 1):
        viewer.show(float(subject.times[k]) + 0.01)
        skins = {s.body: skin for s, skin in zip(subject.skins, scenery.skins(k), strict=True)}
        (shown,) = {node.name: node for node in scene.bodies["gel"] if node.visible}.values()
        vertices, colours = read_glb(shown.glb_data)
        assert np.abs(vertices - skins["gel"].vertices).max() < 1e-7
        assert np.abs(colours - linear(skins["gel"].colours)).max() < 0.003
        assert np.abs(scene.rigid["block"].vertices - skins["block"].vertices).max() < 1e-7
        origin, turn = subject.frames[k]["finger"]
        assert scene.frames["finger"].position == pytest.approx(origin)
        assert np.abs(scene.frames["finger"].wxyz @ turn.as_quat()[[3, 0, 1, 2]]) == pytest.approx(1.0)
        eye, _ = subject.layout.camera_frame(subject.rig.cameras["inside"], subject.frames[k])
        assert np.abs(scene.cameras["inside"].points[0, 0] - eye).max() < 1e-6
        marks = subject.tracks["inside"].positions(subject.states.positions[k])
        assert np.abs(scene.points["inside"].points - marks).max() < 1e-7


class Browser:
    """What a browser knows: properties and visibility of nodes by name, controls by label, how near [m] the eye may
    come."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self.nodes: dict[str, dict[str, Any]] = {}
        self.controls: dict[str, str] = {}
        self.nearest = np.inf

    def read_until(self, done: Callable[[], bool]) -> None:
        import msgspec
        import zstandard

        end = time.monotonic() + PATIENCE_S
        while not done():
            raw = bytes(self._connection.recv(timeout=end - time.monotonic()))
            size = int.from_bytes(raw[8:16], "little")
            window = msgspec.msgpack.decode(zstandard.decompress(raw[16 : 16 + size]))
            at, parts = 16 + size, []
            for length in window["binaryBufferLengths"]:
                at += -at % 8
                parts.append(raw[at : at + length])
                at += length
            for message in window["messages"]:
                self._take(message, parts)

    def look(self) -> None:
        """Say where the eye is, with which a browser begins."""
        eye = {"wxyz": [1.0, 0.0, 0.0, 0.0], "position": [0.0, 0.0, -0.1], "look_at": [0.0, 0.0, 0.0]}
        size = {"image_height": 600, "image_width": 800, "fov": 1.0, "near": 0.001, "far": 10.0}
        self._send({"type": "ViewerCameraMessage", **eye, **size, "up_direction": [0.0, 1.0, 0.0]})

    def move(self, label: str, value: object) -> None:
        """Move a control."""
        self._send({"type": "GuiUpdateMessage", "uuid": self.controls[label], "updates": {"value": value}})

    def _send(self, message: dict[str, Any]) -> None:
        import msgspec

        self._connection.send(msgspec.msgpack.encode(message))

    def _take(self, message: dict[str, Any], parts: list[bytes]) -> None:
        def plain(value: Any) -> Any:
            if isinstance(value, dict) and "__binary_index" in value:
                return np.frombuffer(parts[value["__binary_index"]], value["dtype"])
            return value

        kind = message["type"]
        if kind == "SetCameraMinOrbitDistanceMessage":
            self.nearest = message["min_orbit_distance"]
        elif kind == "SetSceneNodeVisibilityMessage":
            self.nodes[message["name"]]["visible"] = message["visible"]
        elif kind == "SceneNodeUpdateMessage":
            self.nodes[message["name"]].update({n: plain(v) for n, v in message["updates"].items()})
        elif "name" in message and "props" in message:
            self.nodes[message["name"]] = {n: plain(v) for n, v in message["props"].items()}
        elif "uuid" in message and "label" in message.get("props", {}):
            self.controls[message["props"]["label"]] = message["uuid"]

    def shown(self, body: str) -> list[str]:
        """Nodes of a body that are seen."""
        return [n for n, node in self.nodes.items() if n.startswith(f"/bodies/{body}/") and node.get("visible", True)]


@pytest.fixture
def browser(viewer: Viewer) -> Iterator[Browser]:
    import viser
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    protocol = Subprotocol(f"viser-v{viser.__version__}")
    address = viewer.address.replace("http://", "ws://")
    with connect(address, subprotocols=[protocol], max_size=None, compression=None) as connection:
        found = Browser(connection)
        found.look()
        yield found


def test_a_browser_is_sent_the_scene_and_moves_it_by_the_slider(viewer: Viewer, browser: Browser) -> None:
    subject = viewer._subject
    browser.read_until(lambda: {"time [s]", "Play", "speed", "colour"} <= set(browser.controls))
    browser.read_until(lambda: browser.nearest < 0.001)
    assert {"/markers/inside", "/frames/finger", "/cameras/inside", "/bodies/block"} <= set(browser.nodes)
    for k in (1, 4):
        browser.move("time [s]", float(subject.times[k]))
        browser.read_until(lambda k=k: browser.shown("gel") == [f"/bodies/gel/{k}"])  # type: ignore[misc]
        vertices, _ = read_glb(browser.nodes[f"/bodies/gel/{k}"]["glb_data"])
        wanted = subject.skins[0].vertices(subject.layout, subject.states.positions[k], subject.frames[k])
        assert np.abs(vertices - wanted).max() < 1e-7
    browser.move("colour", "body")
    browser.read_until(lambda: browser.nodes["/bodies/block"]["opacity"] is None)


def test_what_plays_goes_on_by_itself_until_it_is_paused(viewer: Viewer, browser: Browser) -> None:
    browser.read_until(lambda: {"time [s]", "Play"} <= set(browser.controls))
    viewer.speed.value = "1/20"
    viewer.time.value = 0.0  # type: ignore[misc]
    viewer._toggle()
    assert viewer.play.label == "Pause"
    for state in ("/bodies/gel/1", "/bodies/gel/2"):
        browser.read_until(lambda state=state: browser.shown("gel") == [state])  # type: ignore[misc]
    viewer._toggle()
    assert viewer.play.label == "Play"


def test_a_viewer_is_reached_from_its_own_machine_alone(viewer: Viewer) -> None:
    port = int(viewer.address.rpartition(":")[2])
    with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=PATIENCE_S) as page:
        assert b"<html" in page.read().lower()
    # Another address of this machine, which a viewer on all networks would answer.
    with socket.socket() as other, pytest.raises(OSError):
        other.settimeout(PATIENCE_S)
        other.connect(("127.0.0.2", port))


def test_a_port_in_use_is_refused_before_anything_is_simulated(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser", reason="viser, of the extra 'live', is not installed.")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["show", "gel_sensor", "press_twist", "--live", "--port", str(port)]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err == (
        f"thinshell: The viewer cannot be served at localhost:{port}: Address already in use. "
        "Name another port with --port.\n"
    )


def test_a_missing_extra_is_reported_with_what_installs_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["show", "gel_sensor", "--live"]) == 2
    assert capsys.readouterr().err == (
        "thinshell: The live viewer needs viser, which is missing. Install it (pip install 'thinshell_ros[live]').\n"
    )


@pytest.mark.parametrize(("words", "message"), [
    (["--live", "--out", "there"], "--live writes no files"),
    (["--port", "8081"], "Add --live"),
    (["--live", "--by", "presure"], "Did you mean 'pressure'?"),
])  # fmt: skip
def test_options_that_do_not_go_together_are_refused(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["show", "gel_sensor", *words]) == 2
    assert message in capsys.readouterr().err


def test_the_command_prints_the_address_and_ends_with_an_interrupt() -> None:
    pytest.importorskip("viser", reason="viser, of the extra 'live', is not installed.")
    command = [sys.executable, "-m", "sysid", "show", "gel_sensor", "--live", "--port", "0"]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # a background shell ignores it
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "Nothing looks wrong.\n"
        address = process.stdout.readline().split()[0]
        with urllib.request.urlopen(address, timeout=PATIENCE_S) as page:
            assert page.status == 200
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert "Traceback" not in errors


RED = (150, 90, 90)
"""The strained gel is redder than its ground: at least the first, at most the others."""


def red(viewer: Viewer) -> float:
    """Share of a small picture of the scene that is as red as a strained gel. The browser draws it when it gets to it,
    however slow it is without a graphics card; Chromium's driver waits ten seconds for a picture of the page."""
    (client,) = viewer._server.get_clients().values()
    picture = client.get_render(150, 200, transport_format="png")[..., :3].astype(int)
    return float(np.mean((picture[..., 0] > RED[0]) & (picture[..., 1] < RED[1]) & (picture[..., 2] < RED[2])))


def until(holds: Callable[[], bool]) -> bool:
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if holds():
            return True
        time.sleep(0.5)
    return False


@pytest.mark.browser
def test_chromium_draws_the_scene_and_another_instant(viewer: Viewer) -> None:
    viewer.colour("strain")
    viewer.show(0.4)
    with chromium(*SOFTWARE_GL, "--window-size=640,480") as page:
        page.get(viewer.address)
        assert until(lambda: "strain [%]" in page.execute_script("return document.body.innerText"))
        said = page.execute_script("return document.body.innerText")
        assert "overlap at the start" in said and "cannot see any of its 49 markers" in said
        assert until(lambda: red(viewer) > 0.003), "the squeezed gel is drawn in the colour of its strain"
        viewer.show(0.0)
        assert until(lambda: red(viewer) < 0.001), "the gel at rest is pale"
        assert not [line for line in page.get_log("browser") if line["level"] == "SEVERE"]
