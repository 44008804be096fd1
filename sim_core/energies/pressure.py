"""Pressure that follows a surface: force p n da on the area and along the normal as they are at the end of the step.

Over a face with shape functions N_a of the coordinates xi, eta, sides g = dx/dxi and h = dx/deta,

    f_a = p int N_a g x h dxi deta

The work of these forces depends on the way only through the rim of the loaded surface (Bufler, Acta Mechanica 49, 1983:
uniform pressure has a potential, p times the volume swept, where the rim is held or the surface closed). A step
minimises the negative of the work along the straight way from its start, x_s + t u with 0 <= t <= 1,

    E = -p int u . [(g_s x h_s + g x h) / 3 + (g_s x h + g x h_s) / 6] dxi deta,    u = sum_a N_a (x_a - x_s,a)

which is a polynomial of the nodes and has a symmetric Hessian. Away from a free rim its forces are f_a exactly. At
the nodes of a free rim the part that has no potential is taken where the step starts, as friction takes its pressure;
the forces there miss f_a by the order of p L |u|, L the length of the edges: first order in the step, and nothing once
the body rests.
"""

from collections.abc import Mapping

import numpy as np

from sim_core.core import language as lang
from sim_core.energies.dead_load import Schedule
from sim_core.energies.term import Memoryless, counted


@lang.func
def swept(u, g, h, g_s, h_s):
    """u . [...], the volume swept per area of the coordinates at a point of a face."""
    return u.dot((g_s.cross(h_s) + g.cross(h)) / 3.0 + (g_s.cross(h) + g.cross(h_s)) / 6.0)


class Pressure(Memoryless):
    """Term of one pressure. ``faces``: int ``(m, 3)``, triangles, or ``(m, 6)``, quadratic faces; ``sign``: 1 along
    their normals, -1 against. Parameter: ``pressure_pa``."""

    def __init__(self, name: str, faces: np.ndarray, sign: float, schedule: Schedule) -> None:
        self.name = name
        self._faces, self._sign, self.schedule = np.asarray(faces), sign, schedule
        self._pressure = 0.0

    @property
    def faces(self) -> np.ndarray:
        """Nodes of the faces."""
        return self._faces

    @property
    def load(self) -> np.ndarray:
        """The pressure along the normals, at the value 1 of the time table [Pa] ``(1,)``."""
        return np.array([self._pressure])

    def load_by(self, quantity: str) -> np.ndarray:
        """Its derivative by a parameter ``(1,)``."""
        del quantity
        return np.array([self._sign])

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        self._pressure = self._sign * parameters["pressure_pa"]
