"""What is shown: a rig as it stands, or what it does in an experiment, a recording or a trace."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sim_core.errors import ConfigError, ConvergenceError, ThinshellError
from sim_core.postprocess import Layout, Surface, lay_out, surfaces
from sim_core.postprocess.layout import within
from sim_core.preflight import Finding, review
from sim_core.rigs import MarkerSensor, OrthographicCamera, Rig, Rigid, WrenchSensor, marker_positions, seen_points
from sim_core.rigs.motion import compile_experiment, load_experiment
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.scene.scene import Frame
from sim_core.sensing.observe import Tracked, frame_of, taken
from sim_core.simulate import Simulation, interpolate, step_times
from sim_core.state_history import StateHistory, StateRecorder
from sysid.progress.callback import Progress

FRAMES = 96
"""States that are shown of a rollout at most, evenly spread."""


@dataclass(frozen=True)
class Marks:
    """Points that a sensor or a camera follows. ``measured``: what a recording has of them at the times shown, in the
    units of the channel ``(n, m, 3 or 2)``, NaN where nothing; ``ids`` ``(m,)``."""

    channel: str
    bodies: tuple[str, ...]
    tracked: tuple[Tracked, ...]
    ids: np.ndarray
    measured: np.ndarray | None = None

    def positions(self, x: np.ndarray) -> np.ndarray:
        """Where the points are in the world [m] ``(m, 3)`` when the nodes are at ``x``."""
        return np.vstack([t.positions(x) for t in self.tracked])


@dataclass(frozen=True)
class Subject:
    """A rig with what is drawn of it. ``skins``: surfaces of its bodies; ``times`` [s] ``(n,)``, and the ``states`` and
    ``frames`` of mounts then; ``markers`` of marker sensors and ``tracks`` of cameras by name; ``wrenches`` [N, N m]
    ``(n, 6)`` by sensor, and those ``measured_wrenches`` that a recording has; ``sought``: where points are to be at
    the end [m] ``(k, 3)``, by name; ``findings``: what looks wrong, in words; ``what``: 'rig', 'experiment',
    'recording' or 'trace'."""

    rig: Rig
    layout: Layout
    skins: tuple[Surface, ...]
    title: str
    what: str
    times: np.ndarray
    states: StateHistory
    frames: tuple[dict[str, Frame], ...]
    markers: dict[str, Marks]
    tracks: dict[str, Marks]
    wrenches: dict[str, np.ndarray] = field(default_factory=dict)
    measured_wrenches: dict[str, np.ndarray] = field(default_factory=dict)
    sought: dict[str, np.ndarray] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    duration: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether there is more than one instant."""
        return len(self.times) > 1

    def pixels(self, camera: str, step: int) -> np.ndarray:
        """Where the camera sees its points [px] ``(m, 2)``; NaN where they are out of the picture."""
        device = self.rig.cameras[camera]
        origin, rotation = self.frames[step][device.mount]
        points = rotation.inv().apply(self.tracks[camera].positions(self.states.positions[step]) - origin)
        return np.asarray(taken(device, points[None])[0])[: len(points)]

    def picture_shift(self, camera: str) -> np.ndarray:
        """By how much the picture of a camera is moved where it is shown [px] ``(2,)``: not at all, but for one whose
        crop is not known (positions counted from a marker), so that its points are in the middle."""
        device = self.rig.cameras[camera]
        if not isinstance(device, OrthographicCamera) or device.origin_id is None:
            return np.zeros(2)
        middle = 0.5 * np.array([device.width_px, device.height_px])
        return np.asarray(middle - np.nanmean(self.pixels(camera, 0), axis=0))

    def predicted_markers(self, sensor: str, steps: np.ndarray) -> np.ndarray:
        """Readings of a marker sensor [m] ``(k, m, 3)``, in its frame, at some of the instants."""
        device = self.rig.sensors[sensor]
        assert isinstance(device, MarkerSensor)
        found = []
        for k in steps:
            place = (device.pose.position(), device.pose.rotation())
            origin, rotation = within(self.layout.body_frame(device.body, self.frames[k]), place)
            found.append(rotation.inv().apply(self.markers[sensor].positions(self.states.positions[k]) - origin))
        return np.stack(found)


def subject_of(rig: Rig, what: str | None, on_progress: Progress | None = None) -> Subject:
    """What ``what`` names on a rig: nothing (the rig as it stands), a recording (a bag, or a window of one), a trace (a
    ``.npz`` of :func:`sim_core.trace_file.save_trace`) or an experiment."""
    say = on_progress or (lambda share, text: None)
    if what is None:
        return still(rig)
    path = Path(what)
    if path.suffix.lower() == ".npz":
        return of_trace(rig, path)
    from sysid.observations.selection import part_of
    from sysid.recording.find import is_recording

    if is_recording(part_of(path).path):
        return of_recording(rig, path, say)
    experiment = load_experiment(what)
    poses = compile_experiment(experiment, rig)
    end = max([experiment.duration_s or 0.0, *(p.times[-1] for p in poses.values())])
    return rolled(rig, poses, float(end), f"{experiment.name} on {rig.name}", "experiment", say)


def still(rig: Rig) -> Subject:
    """The rig as its file has it, before anything is simulated."""
    layout = lay_out(rig)
    x = layout.rest
    return _subject(
        layout, rig.name, "rig", np.zeros(1), resting(layout, x[None], [layout.start]), review(rig, layout=layout)
    )


def resting(layout: Layout, positions: np.ndarray, frames: list[dict[str, Frame]]) -> StateHistory:
    """States of given positions [m] ``(n, N, 3)`` without any force."""
    shape = positions.shape[:2]
    mounts = layout.start
    return StateHistory(
        positions,
        {m: np.stack([f[m][0] for f in frames]) for m in mounts},
        {m: np.stack([f[m][1].as_quat() for f in frames]) for m in mounts},
        {},
        np.zeros(shape),
        np.zeros(shape),
    )


def rolled(rig: Rig, poses: Mapping[str, PoseTrajectory], end: float, title: str, what: str, say: Progress) -> Subject:
    """What the rig does along ``poses`` until ``end`` [s]. Where a step does not converge, what was done until then."""
    layout = lay_out(rig)
    findings = list(review(rig, poses, layout=layout))
    for finding in findings:
        say(0.0, finding.text)
    times = step_times(0.0, end, rig.solver.dt_s) if end > 0.0 else np.zeros(1)
    sampled = {name: trajectory.sample(times) for name, trajectory in poses.items()}
    nominal = [{n: frame_of(p[k], q[k]) for n, (p, q) in sampled.items()} for k in range(len(times))]
    try:
        simulation = Simulation(build_scene(rig))
        simulation.reset(nominal[0])
    except ThinshellError as error:
        return _commanded(layout, poses, times, title, what, findings, error)
    shown = set(np.unique(np.linspace(0, len(times) - 1, min(FRAMES, len(times))).round().astype(int)))
    recorder = StateRecorder(simulation.scene)
    recorder.take(simulation.state, simulation.actual_frames(), simulation.contact_forces())
    kept, readings = [0], [simulation.read()]
    for k in range(1, len(times)):
        try:
            simulation.step(nominal[k], float(times[k] - times[k - 1]))
        except ConvergenceError as error:
            findings.append(
                Finding(
                    "stopped",
                    f"The simulation stops at {times[k - 1]:.3f} of {end:.3f} s: {error.problem}",
                    error.remedy or "The last state shown is the one before.",
                )
            )
            break
        say(k / (len(times) - 1), f"step {k} of {len(times) - 1}")
        if k in shown:
            recorder.take(simulation.state, simulation.actual_frames(), simulation.contact_forces())
            kept.append(k)
            readings.append(simulation.read())
    findings += [
        Finding("pressed far", least.sentence, "Press less deep, or give the gel finer cells.")
        for least in simulation.least_volumes.values()
        if least.ratio < least.softening
    ]
    states = recorder.history()
    findings += untouched(rig, states, findings)
    wrenches = {n: np.stack([r[n] for r in readings]) for n, s in rig.sensors.items() if isinstance(s, WrenchSensor)}
    return _subject(layout, title, what, times[kept], states, findings, wrenches, end)


def _commanded(
    layout: Layout, poses: Mapping[str, PoseTrajectory], times: np.ndarray, title: str, what: str,
    findings: list[Finding], error: ThinshellError,
) -> Subject:  # fmt: skip
    """The motion alone, every body carried by its mount, of a rig that cannot be simulated."""
    some = times[np.unique(np.linspace(0, len(times) - 1, min(FRAMES, len(times))).round().astype(int))]
    frames = layout.frames_along(poses, some)
    states = resting(layout, np.stack([layout.carried(f) for f in frames]), frames)
    missing = Finding("not simulated", f"This is the commanded motion alone, without any mechanics: {error.problem}",
                   error.remedy)  # fmt: skip
    return _subject(layout, title, what, some, states, [missing, *findings], None, float(times[-1]))


def untouched(rig: Rig, states: StateHistory, known: list[Finding]) -> list[Finding]:
    """A finding where contacts are declared and none of them bore a load at any instant that is shown."""
    if not rig.contacts or any(f.kind == "no contact" for f in known):
        return []
    if any(np.abs(force).any() for force in states.pair_forces.values()):
        return []
    names = ", ".join(c.name for c in rig.contacts)
    return [
        Finding(
            "no contact",
            f"Nothing came into contact, although contacts are declared ({names}).",
            "Move the end effector further, or begin nearer.",
        )
    ]


def of_trace(rig: Rig, path: Path) -> Subject:
    """A saved trace. Raises ``ConfigError`` where it holds no states, or those of another rig."""
    from sim_core.trace_file import load_sought, load_trace

    trace = load_trace(path)
    layout = lay_out(rig)
    if trace.states is None:
        raise ConfigError(f"The trace {path} holds no states.", "Simulate with keep_states=True, and save it again.")
    nodes = trace.states.positions.shape[1]
    if nodes < len(layout.rest) or set(trace.states.origins) != set(layout.start):
        raise ConfigError(
            f"The trace {path} has {nodes} nodes and the mounts {', '.join(sorted(trace.states.origins))}; "
            f"the rig {rig.name} has {len(layout.rest)} nodes and {', '.join(sorted(layout.start))}.",
            "Give the rig that it was made with.",
        )
    some = np.unique(np.linspace(0, len(trace.times) - 1, min(FRAMES, len(trace.times))).round().astype(int))
    wrenches = {n: trace.outputs[n][some] for n, kind in trace.kinds.items() if kind == "wrench"}
    states = trace.states.at(some)
    findings = untouched(rig, states, [])
    found = _subject(
        layout, f"{path.stem} on {rig.name}", "trace", trace.times[some], states, findings, wrenches,
        float(trace.times[-1]),
    )  # fmt: skip
    return replace(found, sought=load_sought(path))


def of_recording(rig: Rig, path: Path, say: Progress) -> Subject:
    """What the rig does along the recorded poses, with what was measured."""
    from sysid.model.load import load_run

    run = load_run(rig, path)
    found = rolled(rig, run.poses, run.end, f"{run.name} on {rig.name}", "recording", say)
    markers, tracks, wrenches = dict(found.markers), dict(found.tracks), {}
    for m in run.measured:
        values = held_where_known(m.t, m.values, found.times)
        if m.kind == "wrench":
            wrenches[m.channel] = values
            continue
        group, width = (markers, 3) if m.kind == "markers" else (tracks, 2)
        marks = group[m.channel]
        group[m.channel] = Marks(
            marks.channel, marks.bodies, marks.tracked, marks.ids,
            values.reshape(len(values), -1, width)[:, : len(marks.ids)],
        )  # fmt: skip
    return replace(found, markers=markers, tracks=tracks, measured_wrenches=wrenches)


def held_where_known(t: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Measured values ``(n, m)`` at other times, linear between samples, NaN before the first and after the last."""
    found = interpolate(t, values, at)
    found[(at < t[0] - 1e-9) | (at > t[-1] + 1e-9)] = np.nan
    return found


def _subject(
    layout: Layout,
    title: str,
    what: str,
    times: np.ndarray,
    states: StateHistory,
    findings: list[Finding],
    wrenches: dict[str, np.ndarray] | None = None,
    duration: float = 0.0,
) -> Subject:
    rig = layout.rig
    frames = [
        {m: frame_of(states.origins[m][k], states.quaternions[m][k]) for m in layout.start} for k in range(len(times))
    ]
    markers, tracks = marks_of(layout)
    return Subject(
        rig, layout, tuple(surfaces(layout)), title, what, times, states, tuple(frames), markers, tracks,
        wrenches or {}, {}, {}, tuple(findings), duration,
    )  # fmt: skip


def marks_of(layout: Layout) -> tuple[dict[str, Marks], dict[str, Marks]]:
    """Points of marker sensors and of cameras, by name."""
    rig = layout.rig
    bodies = {n: b for n, b in rig.bodies.items() if not isinstance(b, Rigid)}
    markers, tracks = {}, {}
    for name, sensor in rig.sensors.items():
        if isinstance(sensor, MarkerSensor):
            local, ids = marker_positions(sensor.points, bodies[sensor.body])
            markers[name] = Marks(name, (sensor.body,), (layout.tracked(sensor.body, local),), ids)
    for name, camera in rig.cameras.items():
        seen = seen_points(camera.sees, bodies)
        located = tuple(layout.tracked(body, local) for body, local, _ in seen)
        tracks[name] = Marks(name, tuple(b for b, _, _ in seen), located, np.concatenate([i for _, _, i in seen]))
    return markers, tracks
