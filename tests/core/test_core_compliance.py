"""Hands that give way, on the core: what they hold, touch and carry, and what is seen from them."""

from __future__ import annotations

import numpy as np
import pytest
from adjoint_against_columns import compare_with_columns
from against_differences import compare_derivatives
from scipy.spatial.transform import Rotation
from steps_of_rollouts import by_both_searches, check_steps
from strip_over_table import strip_rig
from test_core_gels import PRESSED, SHAKEN, STATIC, TIGHT, gel_rig
from test_core_gels import TIMES as GEL_TIMES
from test_core_materials import PRESSED_DOWN, SWING, TIMES, _against_differences

from sim_core.core.rollout import CoreRollout
from sim_core.rigs import parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times


def yielding(rig, hand="", more=None):
    """The rig with a compliance of all hands, or of one."""
    effects = {f"end_effector_compliance{'@' if hand else ''}{hand}": {"compliance_m_per_n": 2e-3}}
    return rig.model_copy(update={"effects": {**effects, **(more or {})}})


def swung():
    """A rod on a hinge and a ball, which a hand that gives way swings."""
    rig = strip_rig().model_dump(mode="json", by_alias=True, exclude_none=True)
    box = {"type": "box", "size_m": [0.01, 0.01, 0.04]}
    rod = {
        "type": "affine",
        "shape": box,
        "pose": {"position_m": [0.0, 0.0, -0.02]},
        "material": {"density_kg_m3": 1e3},
    }
    bob = {**rod, "pose": {"position_m": [0.0, 0.0, -0.06]}}
    end = [0.0, 0.0, 0.02]
    rig |= {
        "bodies": {"rod": rod, "bob": bob},
        "clamps": [],
        "contacts": [],
        "joints": [
            {"type": "hinge", "body": "rod", "to": "gripper", "at_m": end, "axis": [0.0, 1.0, 0.0]},
            {"type": "ball", "body": "bob", "to": "rod", "at_m": end},
        ],
    }
    seen = {"body": "bob", "points": {"positions_m": [[0.004, 0.0, 0.0], [0.0, 0.004, 0.002]]}}
    pose = {"position_m": [0.0, -0.3, 0.0], "quaternion_xyzw": [-0.7071, 0.0, 0.0, 0.7071]}
    rig["cameras"]["side"] |= {"sees": [seen], "pose": pose}
    del rig["sensors"]["under"]
    return parse_rig(rig, "swung")


CASES = {
    "gel in the air": (lambda: yielding(gel_rig()), SHAKEN, GEL_TIMES, ["gel.E_pa", "gel.density_kg_m3"]),
    "gel on a table": (lambda: yielding(gel_rig()), PRESSED, GEL_TIMES, ["gel.E_pa", "contacts.gel-table.friction"]),
    "gel in balance": (lambda: yielding(gel_rig(solver=STATIC)), PRESSED, GEL_TIMES, ["gel.E_pa"]),
    "strip in a hand": (lambda: yielding(strip_rig(), "gripper"), PRESSED_DOWN, TIMES, ["strip.E_pa"]),
    "strip on a tray": (lambda: yielding(strip_rig(), "tray"), PRESSED_DOWN, TIMES, ["strip.E_pa"]),
    "jointed": (lambda: yielding(swung(), "gripper"), PRESSED_DOWN, step_times(0.0, 0.2, 0.01), ["bob.density_kg_m3"]),
}


@pytest.mark.parametrize("case", CASES)
def test_steps_end_in_balance_and_derivatives_of_potentials_are_those_of_differences(case):
    make, poses, times, _ = CASES[case]
    check_steps(build_scene(make()), poses, times)


@pytest.mark.parametrize("case", [case for case in CASES if case != "jointed"])
def test_both_searches_find_the_same(case):
    """But for jointed bodies, of which the guarded one halves steps."""
    make, poses, times, _ = CASES[case]
    fast, guarded = by_both_searches(build_scene(make()), poses, times)
    assert np.abs(fast.path.positions - guarded.path.positions).max() < 1e-12


@pytest.mark.parametrize("case", CASES)
def test_a_hand_gives_way_by_its_compliance_times_the_load_in_every_step(case):
    """In the world, of the force that its sensor reads in its own frame."""
    make, poses, times, _ = CASES[case]
    scene, stiff = build_scene(make()), build_scene(make().model_copy(update={"effects": {}}))
    found, rigid = (simulate(s, poses, times, settings=TIGHT, keep_states=True) for s in (scene, stiff))
    most = 0.0
    for mount in scene.compliant:
        given = found.states.origins[mount] - rigid.states.origins[mount]
        forces = found.outputs["wrist" if mount == "gripper" else "under"][:, :3]
        turned = Rotation.from_quat(found.states.quaternions[mount]).apply(forces)
        most = max(most, np.abs(given).max())
        np.testing.assert_allclose(given[1:], 2e-3 * turned[1:], rtol=0.0, atol=1e-10)  # not all that begins is at rest
    assert most > 1e-5


@pytest.mark.parametrize("case", [case for case in CASES if case != "gel in the air"])
def test_derivatives_between_impacts_against_differences_of_rollouts(case):
    make, poses, times, more = CASES[case]
    rig = make()
    own = [f"effects.{key}.compliance_m_per_n" for key in rig.effects]
    round_off = 2e-9 if case == "jointed" else 4e-11  # rigid bodies stretch as little as those of 1 GPa do
    compare_derivatives(rig, poses, times, [*own, "gripper.offset_z_m", *more], TIGHT, round_off=round_off)


@pytest.mark.parametrize("case", CASES)
def test_gradients_on_the_way_back_are_those_of_the_columns(case):
    make, poses, times, more = CASES[case]
    rig = make()
    own = [f"effects.{key}.compliance_m_per_n" for key in rig.effects]
    # Free bodies that keep their shape are stiffer than a strip by far, and leave as much more of a shift to round-off.
    loose = 1e-8 if case == "jointed" else 1e-9
    compare_with_columns(rig, poses, times, [*own, "gripper.offset_z_m", *more], loose)


@pytest.mark.parametrize("case", ["gel in the air", "strip in a hand"])
def test_derivatives_against_differences_of_rollouts(case):
    make, _, times, _ = CASES[case]
    rig = make()
    own = [f"effects.{key}.compliance_m_per_n" for key in rig.effects]
    _against_differences(rig, SHAKEN if "gel" in case else SWING, times, own)


def test_a_hand_gives_way_by_its_compliance_times_the_load():
    """c m g, of a gel at rest, in the world and as far as the wrench says."""
    rig = yielding(gel_rig(), "gripper")
    core = CoreRollout(build_scene(rig), {}, np.arange(2) * 0.005, TIGHT)
    core.settle()
    weight = 9.81 * core.scene.system.mass.sum()
    np.testing.assert_allclose(core.deflections, [[0.0, 0.0, -2e-3 * weight]], atol=1e-9 * weight)
