"""Simulated recordings: run an experiment on a rig and write the bag that its sensors would give."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim_core.contact_wrenches import contact_topic, contact_wrenches
from sim_core.errors import ConfigError
from sim_core.rigs import MarkerSensor, OrthographicCamera, PinholeCamera, Rig, WrenchSensor
from sim_core.rigs.motion import Experiment, compile_experiment
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import Scene, build_scene
from sim_core.sensing.observe import Observer
from sim_core.simulate import Trace, interpolate, simulate, step_times
from sysid.model.sensor_streams import predicted, total_delay
from sysid.progress.callback import Progress
from sysid.recording import RecordingWriter

__all__ = [
    "WhiteNoise",
    "simulate_to_bag",
    "write_trace",
]

START_NS = 1_000_000_000
"""Stamp of the first message; zero stamps mean 'no stamp'."""

POSE_RATE_HZ = 100.0
"""Rate of poses, and of the wrenches of contacts."""

BASE_FRAME = "base_link"
"""Frame of the world where a rig has no end effectors that name it."""

Noise = Callable[[str, str, np.ndarray, np.ndarray], np.ndarray]
"""Noise for (channel, kind, stamps ``(k,)``, clean readings ``(k, ...)``): same shape as the readings."""


@dataclass(frozen=True)
class WhiteNoise:
    """The noise that a rig declares: independent normal errors of the sensors' standard deviations."""

    rig: Rig
    seed: int

    def __call__(self, channel: str, kind: str, stamps: np.ndarray, clean: np.ndarray) -> np.ndarray:
        names = [*self.rig.sensors, *self.rig.cameras]
        rng = np.random.default_rng([self.seed, names.index(channel)])
        draw = rng.standard_normal(clean.shape)
        if kind == "wrench":
            noise = self.rig.sensors[channel].noise
            assert isinstance(self.rig.sensors[channel], WrenchSensor)
            return draw * np.repeat([noise.force_n, noise.torque_nm], 3)  # type: ignore[union-attr]
        source = self.rig.sensors.get(channel) or self.rig.cameras[channel]
        return draw * (source.noise.position_m if kind == "markers" else source.noise.position_px)  # type: ignore[union-attr]


def simulate_to_bag(
    rig: Rig,
    experiment: Experiment,
    out: Path,
    *,
    seed: int = 0,
    refine: int = 1,
    noise: Noise | None = None,
    contact_forces: bool = False,
    on_progress: Progress | None = None,
) -> str:
    """Simulate and write a contract bag; the returned text says what was written.

    ``noise``: what it adds to clean readings; by default what the rig declares, drawn from ``seed``.
    ``refine``: cells in each direction and steps in time, as a multiple of the rig's, so that the recording
    carries less of the error of mesh and time step. ``contact_forces``: also force and torque of each declared contact,
    without noise (topics ``contacts/FIRST/SECOND``). Streams that lead show what would follow with the hands held.
    """
    poses = compile_experiment(experiment, rig)
    duration = max([experiment.duration_s or 0.0, *(p.times[-1] for p in poses.values())])
    if duration <= 0.0:
        raise ConfigError(f"The experiment {experiment.name!r} moves nothing.", "Give it motions, waits or duration_s.")
    scene = build_scene(rig, refine)
    times = _times(rig, scene, float(duration), rig.solver.dt_s / refine)

    def on_step(done: int, total: int) -> None:
        if on_progress is not None:
            on_progress(done / total, f"step {done} of {total}")

    trace = simulate(scene, poses, times, on_step, keep_states=contact_forces)
    wrenches: dict[str, np.ndarray] = {}
    if trace.states is not None:
        wrenches = contact_wrenches(scene, trace.states.positions, trace.states.pair_forces)
    counts = write_trace(rig, trace, poses, out, noise or WhiteNoise(rig, seed), float(duration), wrenches)
    worst = max((r.iterations for r in trace.reports), default=0)
    touched = max((r.contacts for r in trace.reports), default=0)
    lines = [f"{out}: {duration:.2f} s, {len(times) - 1} steps, at most {worst} Newton iterations a step."]
    if rig.contacts and not touched:
        lines.append("Nothing came into contact.")
    lines += [least.sentence for least in trace.least_volumes if least.ratio < least.softening]
    lines += [f"  {topic}: {count} messages" for topic, count in counts.items()]
    return "\n".join(lines)


def _times(rig: Rig, scene: Scene, end: float, dt: float) -> np.ndarray:
    """Instants of the steps [s] until ``end``, and on with the hands where they are then as far as streams lead."""
    kinds = Observer(scene).kinds
    lead = max((-total_delay(rig, channel, kind) for channel, kind in kinds.items()), default=0.0)
    count = max(0, int(np.ceil(lead / dt - 1e-9)))
    return np.concatenate([step_times(0.0, end, dt), end + dt * np.arange(1, count + 1)])


def write_trace(
    rig: Rig,
    trace: Trace,
    poses: Mapping[str, PoseTrajectory],
    out: Path,
    noise: Noise,
    end: float | None = None,
    wrenches: Mapping[str, np.ndarray] | None = None,
) -> dict[str, int]:
    """Write a trace as the streams of the rig until ``end`` [s], by default its own, each with its rate, latency and
    noise; counts by topic. ``wrenches``: of contacts by name at the times of the trace ``(n, 6)``, written as they are,
    in the frame of the poses."""
    end = float(trace.times[-1]) if end is None else end
    counts: dict[str, int] = {}
    with RecordingWriter(out) as bag:
        for name, effector in rig.end_effectors.items():
            stamps = _stamps(POSE_RATE_HZ, end)
            positions, quaternions = poses[name].sample(stamps)
            for topic in (effector.topics.target_pose, effector.topics.current_pose):
                for t, p, q in zip(stamps, positions, quaternions, strict=True):
                    bag.pose(topic, _ns(t), p, q, effector.base_frame)
                counts[topic] = len(stamps)
        for name, sensor in rig.sensors.items():
            stamps = _stamps(sensor.rate_hz, end)
            clean = predicted(trace, rig, name, stamps)
            read = clean + noise(name, trace.kinds[name], stamps, clean)
            frame = sensor.frame_id or name
            counts[sensor.topic] = len(stamps)
            for t, value in zip(stamps, read, strict=True):
                if isinstance(sensor, WrenchSensor):
                    bag.wrench(sensor.topic, _ns(t), value[:3], value[3:], frame)
                elif isinstance(sensor, MarkerSensor):
                    bag.markers(sensor.topic, _ns(t), value, trace.outputs[name][0], trace.ids[name], frame)
        for name, camera in rig.cameras.items():
            stamps = _stamps(camera.rate_hz, end)
            clean = predicted(trace, rig, name, stamps)
            read = clean + noise(name, "tracks", stamps, clean)
            frame = camera.frame_id or name
            counts[camera.topics.marker_tracks] = len(stamps)
            for t, uv in zip(stamps, read, strict=True):
                seen = np.isfinite(uv).all(axis=1)
                bag.tracks(
                    camera.topics.marker_tracks, _ns(t), uv[seen], trace.ids[name][seen],
                    np.ones(int(seen.sum())), frame,
                )  # fmt: skip
            if not isinstance(camera, OrthographicCamera):
                model = "plumb_bob" if isinstance(camera, PinholeCamera) else "equidistant"
                bag.camera_info(
                    camera.topics.camera_info, START_NS, camera.matrix(), camera.distortion, model,
                    camera.width_px, camera.height_px, frame,
                )  # fmt: skip
                counts[camera.topics.camera_info] = 1
        for name, values in (wrenches or {}).items():
            stamps, topic = _stamps(POSE_RATE_HZ, end), contact_topic(name)
            frame = next((e.base_frame for e in rig.end_effectors.values()), BASE_FRAME)
            for t, value in zip(stamps, interpolate(trace.times, values, stamps), strict=True):
                bag.wrench(topic, _ns(t), value[:3], value[3:], frame)
            counts[topic] = len(stamps)
    return counts


def _stamps(rate_hz: float, end: float) -> np.ndarray:
    return np.arange(int(np.floor(end * rate_hz + 1e-9)) + 1) / rate_hz


def _ns(t: float) -> int:
    return START_NS + round(t * 1e9)
