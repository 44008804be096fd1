"""Labelled presses, each an image at rest, as recordings that a fit can follow.

A robot presses a domed pad on a plate, slides and turns it there, and takes one image; every press stands for itself,
without force and without a time base. The pose topic then holds no path but six labels, packed in a pose in the frame
of the plate with z into it: slide x, y and depth z of the pad's pole [m], and tilts rx, ry and twist rz, turned about
fixed axes one after the other. :func:`write_presses` makes up the path that such labels mean: above the plate, straight
down, along the plate, and off again, a press after the other, at a pace without meaning. A rig without inertia does not
see the pace; the tracks hold one reading a press, at the end of its slide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError, RecordingError
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sysid.recording import Recording, RecordingWriter, TrackStream, read_recording
from sysid.vision.field import Points, pitch_of
from sysid.vision.motion import SlideSign, explain_by_poses, pattern_motion, slide_sign

Floats = NDArray[np.float64]

EVERY = 5
"""A press whose number this divides is held out."""

CLEAR_M = 1e-3
"""Height of the pole above the plate between presses."""

APPROACH_S, DOWN_S, SLIDE_S, LIFT_S = 1.0, 2.0, 3.0, 1.0
"""Made-up durations of the parts of a press; with steps of 1 s, their numbers of steps."""

POSE_S = 0.5
"""Time between poses that are written."""

START_NS = 1_000_000_000
"""Stamp of the first message of a recording that is written."""

FARTHEST_PITCH = 0.3
"""A pin of the unloaded image is a rig's pin if it is no farther from it, in distances between neighbours."""


@dataclass(frozen=True)
class Presses:
    """Labelled presses with their tracks, one row a press."""

    number: NDArray[np.int64]
    """Number of the image: its stamp in whole seconds, less 1, ``(n,)``."""
    labels: Floats
    """Slide x, y and depth [m], tilts rx, ry and twist rz [rad], ``(n, 6)``."""
    uv: Floats
    """Pins [px], NaN where lost, ``(n, m, 2)``."""
    rest: Points
    """Pins of the unloaded image [px], ``(m, 2)``."""
    tracks: TrackStream
    """The stream that the pins are from."""

    def __len__(self) -> int:
        """Return the number of presses."""
        return len(self.number)

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """Which presses are for tests, ``(n,)``."""
        return np.asarray(self.number % EVERY == 0)

    @property
    def tilt(self) -> Floats:
        """Angle between the pad's axis and the plate's normal [rad], for small angles, ``(n,)``."""
        return np.asarray(np.hypot(self.labels[:, 3], self.labels[:, 4]))

    def slide_sign(self) -> SlideSign:
        """Which way the pad went, from the images of the presses that are not held out."""
        motion = pattern_motion(self.rest, self.uv)
        return slide_sign(explain_by_poses(motion, self.labels, self.held_out, depth=2))

    def spread(self, among: NDArray[np.bool_], count: int) -> NDArray[np.intp]:
        """Rows of ``count`` presses of those marked in ``among`` ``(n,)``, spread evenly over their order in depth."""
        rows = np.flatnonzero(among)
        if len(rows) < count:
            raise RecordingError(
                f"{len(rows)} presses fit, fewer than the {count} that are wanted.",
                "Allow for more tilt, or ask for fewer presses.",
            )
        order = rows[np.argsort(self.labels[rows, 2], kind="stable")]
        return np.asarray(order[np.linspace(0, len(order) - 1, count).round().astype(int)])


def read_presses(recording: Recording) -> Presses:
    """Presses of a recording with tracks (``thinshell track``), whose first image, without a pose, is unloaded."""
    if len(recording.tracks) != 1 or len(recording.poses) != 1:
        raise RecordingError(
            f"{recording.provenance.path} holds {len(recording.tracks)} streams of tracks and {len(recording.poses)} "
            "of poses; labelled presses are one of each.",
            "Find the pins with 'thinshell track' first.",
        )
    tracks, poses = next(iter(recording.tracks.values())), next(iter(recording.poses.values()))
    place = np.searchsorted(tracks.t, poses.t)
    place = np.where(place < len(tracks), place, 0)
    if (np.abs(tracks.t[place] - poses.t) > 1e-3).any() or 0 in place:
        raise RecordingError(
            f"{recording.provenance.path}: poses and images are not one for one after a first image without a pose.",
            "Labelled presses have one pose an image, of the same stamp, and begin with the unloaded sensor.",
        )
    angles = Rotation.from_quat(poses.quaternion).as_euler("xyz")
    number = np.rint(poses.t + 1e-9 * recording.t0_ns).astype(np.int64) - 1
    return Presses(number, np.hstack([poses.position, angles]), tracks.uv[place], tracks.uv[0], tracks)


def pins_of(rig: Rig, camera: str, rest: Points) -> tuple[NDArray[np.int64], float]:
    """The rig's number of each pin of an unloaded image ``(m, 2)`` [px], -1 where it has none; and how far apart they
    are [px], root mean square of both coordinates.

    Raises ``RecordingError`` when a pin of the rig is not where the rig says.
    """
    simulation = Simulation(build_scene(rig))
    expected = simulation.read()[camera]
    ids = np.asarray(simulation.observer.ids[camera], dtype=np.int64)
    gap = np.linalg.norm(expected[:, None] - rest[None], axis=2)
    own, found = linear_sum_assignment(np.where(np.isfinite(gap), gap, 1e6))
    far = gap[own, found] > FARTHEST_PITCH * pitch_of(expected)
    if len(own) < len(expected) or far.any():
        raise RecordingError(
            f"{int(far.sum()) + len(expected) - len(own)} of the {len(expected)} pins of the rig {rig.name!r} are not "
            f"in the unloaded image, which has {len(rest)}.",
            f"Correct the places of the pins, or scale, centre and pose of the camera {camera!r}.",
        )
    numbers = np.full(len(rest), -1, dtype=np.int64)
    numbers[found] = ids[own]
    return numbers, float(np.sqrt(np.mean((expected[own] - rest[found]) ** 2)))


def press_path(labels: Floats, sense: float) -> tuple[PoseTrajectory, Floats]:
    """The made-up path through presses ``(n, 6)`` and the instant of each reading [s] ``(n,)``.

    The pad ends where ``sense`` is +1: at slide and twist, having come down at neither; where it is -1: at neither,
    having come down at both, so that it went by minus the label.
    """
    times, positions, rotations, readings = [], [], [], []
    now = -APPROACH_S
    for x, y, depth, rx, ry, rz in labels:
        begin, end = (0.0, 1.0) if sense > 0.0 else (1.0, 0.0)
        for share, z, duration in (
            (begin, -CLEAR_M, APPROACH_S),
            (begin, depth, DOWN_S),
            (end, depth, SLIDE_S),
            (end, -CLEAR_M, LIFT_S),
        ):
            now += duration
            times.append(now)
            positions.append([share * x, share * y, z])
            rotations.append([rx, ry, share * rz])
        readings.append(times[-2])
    quaternions = Rotation.from_euler("xyz", rotations).as_quat()
    return PoseTrajectory.from_samples(np.array(times), np.array(positions), quaternions), np.array(readings)


def write_presses(
    presses: Presses, rows: NDArray[np.intp], sense: float, rig: Rig, numbers: NDArray[np.int64], out: Path
) -> None:
    """Write some presses, one after the other, as a recording of the rig. ``numbers``: as of :func:`pins_of`."""
    (effector,) = rig.end_effectors.values()
    (camera,) = rig.cameras.values()
    path, readings = press_path(presses.labels[rows], sense)
    mine = numbers >= 0
    with RecordingWriter(out) as bag:
        bag.remark(
            "presses",
            f"{len(rows)} labelled presses, images {', '.join(map(str, presses.number[rows]))}. Stamps and paths are "
            "made up: each press goes straight down, along the plate and off again; the tracks are one image at rest "
            "each.",
        )
        stamps = np.arange(0.0, path.times[-1] + POSE_S, POSE_S)
        for t, position, quaternion in zip(stamps, *path.sample(stamps), strict=True):
            bag.pose(effector.topics.target_pose, _ns(t), position, quaternion, effector.base_frame)
        for t, row in zip(readings, rows, strict=True):
            uv = presses.uv[row][mine]
            trust = np.isfinite(uv).all(axis=1).astype(float)
            bag.tracks(camera.topics.marker_tracks, _ns(t), uv, numbers[mine], trust, presses.tracks.frame_id)


def _ns(t: float) -> int:
    return START_NS + round(1e9 * t)


@dataclass(frozen=True)
class Baseline:
    """A prediction of held-out presses that knows no mechanics."""

    name: str
    miss_px: float
    """Root mean square of both coordinates of all pins [px]."""


def baselines(presses: Presses, train: NDArray[np.intp], test: NDArray[np.intp]) -> list[Baseline]:
    """Pins that do not move, and least-squares polynomials of the labels from the training presses and from all that
    are not held out."""
    everything = np.flatnonzero(~presses.held_out)
    found = [Baseline("pins that do not move", _rms(presses.uv[test] - presses.rest))]
    for name, rows, squares in (
        (f"linear in the labels, from the same {len(train)} presses", train, False),
        (f"linear in the labels, from all {len(everything)} that are not held out", everything, False),
        (f"linear and quadratic, from all {len(everything)}", everything, True),
    ):
        moved = (presses.uv[rows] - presses.rest).reshape(len(rows), -1)
        seen = np.isfinite(moved).all(axis=0)
        slopes = np.linalg.lstsq(_terms(presses.labels[rows], squares), moved[:, seen], rcond=None)[0]
        left = (presses.uv[test] - presses.rest).reshape(len(test), -1)[:, seen]
        found.append(Baseline(name, _rms(left - _terms(presses.labels[test], squares) @ slopes)))
    return found


def _terms(labels: Floats, squares: bool) -> Floats:
    """Regressors: 1, the labels in mm and tenths of a radian, and, if asked for, their products."""
    scaled = labels / [1e-3, 1e-3, 1e-3, 0.1, 0.1, 0.1]
    columns = [np.ones(len(labels)), *scaled.T]
    if squares:
        columns += [scaled[:, i] * scaled[:, j] for i in range(6) for j in range(i, 6)]
    return np.column_stack(columns)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def select(presses: Presses, most_tilt_deg: float, counts: Sequence[int]) -> tuple[NDArray[np.intp], ...]:
    """Rows of the presses to fit and of those to hold out, spread over depth, none tilted by more than given."""
    upright = presses.tilt < np.deg2rad(most_tilt_deg)
    train, test = counts
    return presses.spread(upright & ~presses.held_out, train), presses.spread(upright & presses.held_out, test)


def prepare(rig: Rig, bag: Path, out: Path, most_tilt_deg: float, train: int, test: int) -> str:
    """Write ``train`` and ``held_out`` into the folder ``out``, and say what was found: ``thinshell presses``."""
    if len(rig.end_effectors) != 1 or len(rig.cameras) != 1:
        raise ConfigError(
            f"The rig {rig.name!r} has {len(rig.end_effectors)} end effectors and {len(rig.cameras)} cameras.",
            "Give the rig of a pad that one end effector presses and one camera sees.",
        )
    (camera,) = rig.cameras
    presses = read_presses(read_recording(bag, need_pose=False))
    numbers, apart = pins_of(rig, camera, presses.rest)
    sign = presses.slide_sign()
    to_fit, to_test = select(presses, most_tilt_deg, (train, test))
    for name, rows in (("train", to_fit), ("held_out", to_test)):
        write_presses(presses, rows, float(np.sign(sign.alignment)), rig, numbers, Path(out) / name)
    lines = [
        f"{len(presses)} presses. From the images of those that are not held out: {sign}; the pad's x points "
        f"{np.rad2deg(sign.roll_rad) % 360.0:.1f} deg from u towards v.",
        f"The {int((numbers >= 0).sum())} pins of the rig are within {apart:.2f} px (RMS) of the unloaded image.",
        f"Tilted by less than {most_tilt_deg:g} deg, spread over depth: images {_listed(presses, to_fit)} to fit, "
        f"{_listed(presses, to_test)} held out.",
        "RMS of u and v over all pins of the held-out presses, predicted without mechanics:",
    ]
    lines += [f"  {b.miss_px:6.3f} px  {b.name}" for b in baselines(presses, to_fit, to_test)]
    return "\n".join([*lines, f"Written to {out}: train, held_out."])


def _listed(presses: Presses, rows: NDArray[np.intp]) -> str:
    return ", ".join(map(str, presses.number[rows]))
