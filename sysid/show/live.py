"""A viewer of a subject in the browser: viser (extra ``live``) serves the scene and its controls until it is
stopped."""

from __future__ import annotations

import io
import socket
import threading
import time
from contextlib import redirect_stdout
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from sim_core.errors import ConfigError
from sysid.show.colouring import BODY, Colouring, chosen, telling_step
from sysid.show.live_scene import LiveScene
from sysid.show.raster import look_at
from sysid.show.style import colour_table
from sysid.show.subject import Subject
from sysid.show.viewpoint import direction, framed

if TYPE_CHECKING:
    import viser

HOST, PORT = "localhost", 8080
"""Where the viewer is served by default: to this machine alone."""

SPEEDS = {"1/20": 0.05, "1/5": 0.2, "1/2": 0.5, "1": 1.0, "2": 2.0, "5": 5.0}
"""Speeds of playing, over that of the motion."""

TICK_S = 0.04
"""How often a viewer that plays looks at the clock [s]."""

WINDOW_PX, ANGLE_DEG = (1280, 800), 40.0
"""Size of the window and vertical angle of view for which the first view is chosen."""

NEAREST = 0.005
"""How near the eye may come to what it turns about, as a share of the extent of what is simulated."""

HINT = "Every body, marker, frame and camera can be hidden in the scene tree."


class Viewer:
    """A subject that any number of browsers look at. ``address``: where; ``scene``: what is shown of it; ``time`` [s],
    ``play``, ``speed`` and ``quantity``: the controls, of which a rig at rest has the last alone."""

    def __init__(
        self,
        subject: Subject,
        coloured: dict[str, Colouring],
        *,
        by: str | None = None,
        host: str = HOST,
        port: int = PORT,
    ) -> None:
        check(host, port)
        import viser

        with redirect_stdout(io.StringIO()):  # viser has a greeting of its own
            self._server = viser.ViserServer(_numbers(host), port, label=subject.title, verbose=False)
        self.address = f"http://{host}:{self._server.get_port()}"
        self._subject, self._coloured = subject, coloured
        self._lock, self._stopped, self._playing = threading.RLock(), threading.Event(), False
        first = chosen(subject, coloured, by)
        self._step = telling_step(subject, first)
        with self._server.atomic():
            self._look()
            self.scene = LiveScene(self._server.scene, subject, first, self._step)
            self._add_controls(first)
        if subject.moves:
            threading.Thread(target=self._run, daemon=True).start()

    def show(self, t: float) -> None:
        """Show the state that is nearest to an instant [s]."""
        step = int(np.argmin(np.abs(self._subject.times - t)))
        with self._lock:
            if step != self._step:
                self._step = step
                with self._server.atomic():
                    self.scene.show(step)

    def colour(self, name: str) -> None:
        """Colour all bodies by a quantity, or with 'body' each in its own colour."""
        with self._lock, self._server.atomic():
            self.scene.colour(self._coloured.get(name))
            self._scale.content = scale(self._coloured.get(name))

    def stop(self) -> None:
        """Close all connections and give the port back."""
        self._stopped.set()
        with redirect_stdout(io.StringIO()):
            self._server.stop()

    def _look(self) -> None:
        """The view of the picture, where gravity pulls down."""
        points = framed(self._subject)
        towards, up = direction(self._subject, points)
        extent = float(np.ptp(points, axis=0).max())
        camera = self._server.initial_camera
        camera.position = look_at(points, towards, up, WINDOW_PX, ANGLE_DEG).eye
        camera.look_at = 0.5 * (points.min(axis=0) + points.max(axis=0))
        camera.fov, camera.near, camera.far = np.deg2rad(ANGLE_DEG), NEAREST * extent, 1e3 * extent
        self._server.scene.set_up_direction(up)

        def come_near(client: viser.ClientHandle) -> None:
            client.camera.min_orbit_distance = NEAREST * extent

        self._server.on_client_connect(come_near)

    def _add_controls(self, first: Colouring | None) -> None:
        gui, times = self._server.gui, self._subject.times
        gui.configure_theme(show_logo=False, show_share_button=False)
        if self._subject.moves:
            # Whole thousandths of a second, so that no digits of rounding are shown.
            begin, end = (round(float(t), 3) for t in times[[0, -1]])
            self.time = gui.add_slider("time [s]", begin, end, 0.001, float(np.clip(times[self._step], begin, end)))
            self.play = gui.add_button("Play")
            self.speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1")
            self.time.on_update(lambda event: self.show(event.target.value))
            self.play.on_click(lambda event: self._toggle())
        name = BODY if first is None else first.name
        self.quantity = gui.add_dropdown("colour", (BODY, *self._coloured), initial_value=name)
        self.quantity.on_update(lambda event: self.colour(event.target.value))
        self._scale = gui.add_html(scale(first))
        findings = "".join(f"<p>\u26a0 {escape(f.text)}</p>" for f in self._subject.findings)
        gui.add_html(f'<div style="font-size:0.85em;padding:0 1em">{findings}<p>{HINT}</p></div>')

    def _toggle(self) -> None:
        self._playing = not self._playing
        self.play.label = "Pause" if self._playing else "Play"

    def _run(self) -> None:
        """Moves the slider on while it plays, over and over again."""
        last = time.monotonic()
        while not self._stopped.wait(TICK_S):
            now = time.monotonic()
            if self._playing:
                t = self.time.value + SPEEDS[self.speed.value] * (now - last)
                self.time.value = t if t <= self.time.max else self.time.min  # type: ignore[misc]  # has a setter
            last = now


def scale(coloured: Colouring | None) -> str:
    """The colours of values with their ends, as HTML; empty without a quantity."""
    if coloured is None:
        return ""
    table = (255.0 * colour_table()[::32]).round().astype(int)
    colours = ",".join(f"rgb({r},{g},{b})" for r, g, b in table)
    return (
        f'<div style="padding:0 1em;font-size:0.85em">{escape(coloured.label)}: {escape(coloured.words)}'
        f'<div style="height:0.7em;background:linear-gradient(90deg,{colours})"></div>'
        f'<div style="display:flex;justify-content:space-between"><span>0</span><span>{coloured.top:g}</span></div>'
        "</div>"
    )


def check(host: str = HOST, port: int = PORT) -> None:
    """Whether a viewer can be served there. Raises ``ConfigError``."""
    try:
        import viser  # noqa: F401
    except ImportError:
        raise ConfigError(
            "The live viewer needs viser, which is missing.", "Install it (pip install 'thinshell_ros[live]')."
        ) from None
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_numbers(host), port))
        except OSError as error:
            raise ConfigError(
                f"The viewer cannot be served at {host}:{port}: {error.strerror}.", "Name another port with --port."
            ) from None


def _numbers(host: str) -> str:
    """The address of this machine is written in numbers: its name may stand for two, each with ports of its own."""
    return "127.0.0.1" if host == "localhost" else host


def serve(
    subject: Subject, coloured: dict[str, Colouring], by: str | None = None, host: str = HOST, port: int = PORT
) -> None:
    """Print the address of a :class:`Viewer` and keep it until Ctrl-C is pressed."""
    viewer = Viewer(subject, coloured, by=by, host=host, port=port)
    try:
        print(f"{viewer.address} until Ctrl-C", flush=True)
        threading.Event().wait()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.stop()
