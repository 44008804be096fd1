"""Follows the tutorial of the nodes, docs/tutorials/from_nodes.md, and draws its pictures (``make tutorial``).

All commands of the page are one script, which is run in a new folder; what the nodes have written there is drawn.
Argument: a folder in which the script has been run already, to only draw again.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from PIL import Image

from sim_core.trajectories import Trajectory, read_trajectory
from sysid.recording import read_recording

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "tutorials" / "from_nodes.md"
OUT = ROOT / "docs" / "pictures" / "from_nodes"
RIG, ROBOT = "examples/closed_loop/strip.yaml", "examples/closed_loop/soft_robot.yaml"
SENSOR = "wrench_gel"
COLOURS = 64
REACHED_M = 2e-5
"""A depth is reached where no more than this [m] is left."""


def script(page: Path = PAGE) -> str:
    """The commands of a page, one after the other."""
    blocks = page.read_text().split("```sh\n")[1:]
    return "\n".join(block.partition("```")[0] for block in blocks)


def follow(folder: Path) -> int:
    """Run the script of the page in a folder, its output to ``log`` there; returns its exit code."""
    (folder / "examples").symlink_to(ROOT / "examples")
    before = "set -eu\ntrap 'kill $(jobs -p) 2>/dev/null || true' EXIT\n"
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    given = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **os.environ, "PATH": path}
    with (folder / "log").open("w") as log:
        done = subprocess.run(
            ["bash", "-c", before + script()], cwd=folder, env=given, stdout=log, stderr=subprocess.STDOUT, check=False
        )
    return done.returncode


@dataclass(frozen=True)
class Replay:
    """The way down of a replay, as recorded. ``depth_m`` ``(n,)``: how far the finger has come down, as measured,
    never less than before; ``force_n`` ``(n,)``: along z of the sensor, as it was read there; ``expected_n`` ``(n,)``:
    as the trajectory predicts it there."""

    depth_m: np.ndarray
    force_n: np.ndarray
    expected_n: np.ndarray

    @property
    def error_n(self) -> float:
        """Root mean square of what was read, less what was predicted [N]."""
        return float(np.sqrt(np.mean((self.force_n - self.expected_n) ** 2)))

    def from_other(self, other: Replay) -> float:
        """Root mean square of what was read, less what was read as deep in another replay [N]."""
        there = np.interp(self.depth_m, other.depth_m, other.force_n)
        return float(np.sqrt(np.mean((self.force_n - there) ** 2)))


def replay(bag: Path, trajectory: Trajectory) -> Replay:
    """Read a replay of a trajectory that only goes down."""
    recording = read_recording(bag)
    (poses,), (wrench,) = recording.poses.values(), recording.wrenches.values()
    z = next(iter(trajectory.end_effectors.values())).positions_m[:, 2]
    down = z[0] - np.interp(wrench.t, poses.t, poses.position[:, 2])
    end = int(np.argmax(down >= z[0] - z[-1] - REACHED_M))
    moving = np.arange(len(down)) < end
    moving &= down > REACHED_M
    depth = np.maximum.accumulate(down[moving])
    predicted = trajectory.predicted.wrenches[SENSOR].forces_n[:, 2]
    return Replay(depth, wrench.force[moving, 2], np.interp(depth, z[0] - z, predicted))


@dataclass(frozen=True)
class Followed:
    """What the script has written."""

    folder: Path

    def job(self, kind: str, number: int = 0) -> Path:
        """Folder of a job: of the first of its kind, or a later one."""
        return sorted((self.folder / "jobs").glob(f"{kind}_*"))[number]

    def replay(self, name: str) -> Replay:
        """A replay by the name of its bag."""
        number = 1 if name == "deployed" else 0
        return replay(self.folder / name, read_trajectory(self.job("optimisation", number) / "trajectory.json"))

    @property
    def fit(self) -> dict[str, list[float]]:
        """Limits of 95 % of what was fitted, by parameter."""
        found = json.loads((self.job("fit") / "fit.json").read_text())
        return {one["name"]: one["ci95"] for one in found["estimates"]}

    @property
    def diagnosis(self) -> dict[str, Any]:
        """The content of diagnosis.json."""
        found: dict[str, Any] = json.loads((self.job("diagnosis") / "diagnosis.json").read_text())
        return found


def draw(followed: Followed, out: Path) -> None:
    """The pictures of the page."""
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    out.mkdir(parents=True, exist_ok=True)
    robot, before, after = (followed.replay(name) for name in ("recording", "twin_before", "twin_after"))
    figure, axes = plt.subplots(1, 2, sharey=True, figsize=(8.6, 3.2), layout="constrained")
    for axis, twin, title in zip(axes, (before, after), ("before", "after"), strict=True):
        axis.plot(1e3 * robot.depth_m, robot.force_n, color="C3", lw=2.2, label="robot")
        axis.plot(1e3 * twin.depth_m, twin.force_n, color="C0", lw=1.2, label="twin")
        axis.set(title=f"The first motion, the twin {title} the deployment", xlabel="way down [mm]")
        axis.title.set_fontsize(9)
        axis.legend(fontsize=8)
    axes[0].set(ylabel="force on the finger [N]")
    _save(figure, out / "twin.png")

    deployed = followed.replay("deployed")
    figure, axes = plt.subplots(1, 2, sharey=True, figsize=(8.6, 3.2), layout="constrained")
    for axis, shown, title in zip(axes, (robot, deployed), ("first motion", "motion for the amended rig"), strict=True):
        axis.plot(1e3 * shown.depth_m, shown.force_n, color="C3", lw=2.2, label="robot")
        axis.plot(1e3 * shown.depth_m, shown.expected_n, color="k", lw=1.0, ls="--", label="predicted")
        axis.set(title=f"{title}: {1e3 * shown.error_n:.1f} mN rms apart", xlabel="way down [mm]")
        axis.title.set_fontsize(9)
        axis.legend(fontsize=8)
    axes[0].set(ylabel="force on the finger [N]")
    _save(figure, out / "prediction.png")


def _save(figure: Any, path: Path) -> None:
    import matplotlib.pyplot as plt

    written = io.BytesIO()
    figure.savefig(written, dpi=100)
    plt.close("all")
    picture = Image.open(written).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    picture.save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def main(folder: Path | None = None, out: Path = OUT) -> int:
    """Follow the page where no folder is given, and draw."""
    if folder is not None:
        draw(Followed(folder), out)
        return 0
    with tempfile.TemporaryDirectory() as made:
        code = follow(Path(made))
        print((Path(made) / "log").read_text())
        if code == 0:
            draw(Followed(Path(made)), out)
    return code


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:2])))
