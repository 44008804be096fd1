"""Laws where there is no C++ compiler: the core calls them back in numpy, and rollouts are the same."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from no_compiler import without_compiler
from strip_over_table import motion, strip_rig
from test_core_gels import PRESSED, TIGHT, gel_rig

from sim_core.core.material import MaterialFormula
from sim_core.core.pointwise import Law
from sim_core.effects.registry import all_effects
from sim_core.gradients import directions, simulate_tangent
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times

TIMES = step_times(0.0, 0.1, 0.01)
PLACES = [[0, 0, 0], [0, 0, -0.058], [0.01, 0, -0.058]]
DRAWN = {"gripper": motion([0.0, 0.05, 0.1], PLACES, [[0, 0, 0], [0, 50, 0], [0, 50, 0]])}
LAWS = ["contact_adhesion", "pressure_friction", "bending_plasticity", "sheet_stiffening", "viscoelastic_sheet",
        "gel_warming"]  # fmt: skip

TOUCHING = ("contact_adhesion", "pressure_friction")
"""Laws that act where something touches; others show in the first steps, and cost a second each in numpy."""


def _forget():
    """Let all laws look for a compiler again."""
    for law in gc.get_objects():
        if type(law) is Law:
            law.__dict__.pop("_evaluate", None)
        elif type(law) is MaterialFormula:
            law._at.cache_clear()


@pytest.fixture
def no_compiler(monkeypatch):
    without_compiler(monkeypatch)
    _forget()
    yield
    _forget()


@pytest.mark.filterwarnings("ignore:No C")
@pytest.mark.parametrize("name", LAWS)
def test_laws_that_are_called_back_make_the_rollouts_and_derivatives_of_compiled_ones(name, request):
    effect, gel = all_effects()[name], name.startswith("gel")
    example = {"pressure_pa": 100.0, **dict(effect.example)} if name == "pressure_friction" else dict(effect.example)
    rig = (gel_rig if gel else strip_rig)(effects={name: example})
    poses = PRESSED if gel else DRAWN
    names = [f"effects.{name}.{p.name}" for p in effect.parameters][:2] + ["gripper.offset_z_m"]
    along, found = directions(rig, names), []
    times = TIMES if name in TOUCHING else TIMES[:5]
    for compiler in (True, False):
        if not compiler:
            request.getfixturevalue("no_compiler")
        trace, slopes = simulate_tangent(build_scene(rig), poses, times, along, settings=TIGHT, keep_path=True)
        found.append((trace, slopes))
    (one, by_one), (other, by_other) = found
    assert name not in TOUCHING or max(report.contacts for report in one.reports) > 0
    assert np.abs(one.path.positions - other.path.positions).max() < 1e-12
    for channel, slopes in by_one.items():
        for k, parameter in enumerate(names):
            size = np.nanmax(np.abs(slopes[..., k]))
            assert size > 0.0 or (channel == "under" and name not in TOUCHING), (channel, parameter)
            np.testing.assert_allclose(by_other[channel][..., k], slopes[..., k], rtol=0.0, atol=1e-7 * size)


def test_a_warning_says_once_that_laws_are_slower(no_compiler):
    with pytest.warns(UserWarning, match="No C") as said:
        for name in ("sheet_stiffening", "contact_adhesion"):
            rig = strip_rig(effects={name: dict(all_effects()[name].example)})
            simulate(build_scene(rig), DRAWN, TIMES[:2])
    assert len([w for w in said if "No C++ compiler" in str(w.message)]) == 1
