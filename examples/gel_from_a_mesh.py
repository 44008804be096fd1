"""A gel whose shape is a mesh file: a wedge, thicker on one side, which a ball presses where it is thick and thin."""

import tempfile
from pathlib import Path

import meshio
import numpy as np

from sim_core import load_rig, rollout
from sim_core.rigs.trajectory import PoseTrajectory

LENGTH, WIDTH, THIN, THICK = 12.0, 8.0, 3.0, 5.0
"""Extents of the wedge [mm]; its height grows along x."""

RIG = """
name: wedge
solver: {dt_s: 0.05, inertia: false}
bodies:
  gel:
    type: gel
    shape: {type: mesh, file: wedge.vtu, unit: mm, face_regions: {foot: {z_m: [-1.0e-6, 1.0e-6]}}}
    material: {preset: ecoflex_00_30}
    bonded: foot
    mount: world
  ball:
    type: rigid
    shape: {type: sphere, radius_m: 0.004}
    mount: finger
end_effectors:
  finger: {start: {position_m: [0.0, 0.0, 0.0085]}}
contacts:
  - {between: [gel, ball]}
sensors:
  force: {type: wrench, on: ball}
"""


def wedge(cells: tuple[int, int, int] = (4, 3, 2)) -> meshio.Mesh:
    """Tetrahedra of the wedge [mm], six for each cell."""
    nx, ny, nz = cells
    x, y, z = np.meshgrid(*(np.linspace(0.0, 1.0, n + 1) for n in cells), indexing="ij")
    height = THIN + (THICK - THIN) * x
    points = np.stack([LENGTH * (x - 0.5), WIDTH * (y - 0.5), height * z], axis=-1).reshape(-1, 3)
    index = np.arange(len(points)).reshape(nx + 1, ny + 1, nz + 1)
    corner = [index[i : i + nx, j : j + ny, k : k + nz].ravel() for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    paths = [(0, 4, 6, 7), (0, 6, 2, 7), (0, 2, 3, 7), (0, 3, 1, 7), (0, 1, 5, 7), (0, 5, 4, 7)]
    tets = np.concatenate([np.stack([corner[c] for c in path], axis=-1) for path in paths])
    return meshio.Mesh(points, [("tetra", tets)])


def press(folder: Path, x: float) -> float:
    """Force [N] that the wedge pushes back with where the ball goes 0.5 mm deep at ``x`` [m]."""
    rig = load_rig(folder / "wedge.yaml")
    top = 1e-3 * (0.5 * (THIN + THICK) + (THICK - THIN) * x / (1e-3 * LENGTH))
    times = np.linspace(0.0, 0.5, 11)
    deep = np.linspace(top + 0.0045, top + 0.0035, 11)
    positions = np.stack([np.full(11, x), np.zeros(11), deep], axis=-1)
    poses = {"finger": PoseTrajectory(times, positions, np.tile([0.0, 0.0, 0.0, 1.0], (11, 1)))}
    return float(rollout(rig, poses).outputs["force"][-1, 2])


def main() -> float:
    """Returns the force on the thin side over that on the thick one."""
    mesh = wedge()
    corners = mesh.points[mesh.cells_dict["tetra"]]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6.0
    assert abs(volume / (LENGTH * WIDTH * 0.5 * (THIN + THICK)) - 1.0) < 1e-12
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        mesh.write(folder / "wedge.vtu")
        (folder / "wedge.yaml").write_text(RIG)
        thin, thick = press(folder, -0.003), press(folder, 0.003)
    print(f"The ball feels {thin:.3f} N on the thin side and {thick:.3f} N on the thick one.")
    assert thin > thick > 0.0, "a thinner layer is stiffer"
    return thin / thick


if __name__ == "__main__":
    main()
