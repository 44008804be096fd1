"""A kept Hessian against the system's own, when the system has gone on."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import triu

from sim_core.scene import build_scene
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation
from sim_core.solve import hessian_store as stiffness
from sim_core.solve.hessian_store import Keeper, _Prepared

COMPLIANT = {"end_effector_compliance": {"compliance_m_per_n": 2e-4}}


@pytest.mark.parametrize("factors", [False, True])
def test_products_and_solutions(small_rig, visit, factors):
    """Before contact and in contact, where the pattern has changed, on a mount that gives way."""
    scene = build_scene(small_rig(effects=COMPLIANT))
    system, keeper, rng = scene.system, Keeper(scene.system, factors), np.random.default_rng(0)
    simulation = Simulation(scene)
    poses = visit([0.0, 0.3, 0.5], [[0, 0, 0], [0, 0, -0.008], [0.03, 0, 0.004]])["finger"]
    positions, quaternions = poses.sample(np.arange(0.0, 0.5, 0.02))
    kept, references = [], []
    move, rhs = rng.standard_normal(system.x.shape), rng.standard_normal((system.n_unknowns, 2))
    for position, quaternion in zip(positions[1:], quaternions[1:], strict=True):
        simulation.step({"finger": frame_of(position, quaternion)}, 0.02)
        kept.append(keeper.keep())
        upper = system.hessian(exact=True)
        references.append(((upper + triu(upper, 1).T).toarray(), system.nodal_product(move)))
    assert len({id(k.layout) for k in kept}) > 1
    assert kept[0].size_bytes > kept[1].size_bytes  # which shares its layout
    for one, (matrix, product) in reversed(list(zip(kept, references, strict=True))):
        assert np.array_equal(one.product(move), product)
        for right in (rhs, rhs[:, 0]):
            assert np.abs(matrix @ one.solve(right) - right).max() < 1e-9
    # As many foreseen as one likes, in any order, with others solved with between.
    solved = []
    for k in (len(kept) - 1, 3, 2, 5, 4):
        kept[k].foresee()
    for k in (4, 7, 3, 3, len(kept) - 1, 2, 6, 5):
        matrix, product = references[k]
        assert np.array_equal(kept[k].product(move), product)
        solved.append(np.abs(matrix @ kept[k].solve(rhs) - rhs).max())
    assert max(solved) < 1e-9


def test_an_interruption_while_something_is_foreseen_leaves_nothing_half_done(small_rig, visit, monkeypatch):
    scene = build_scene(small_rig())
    system, keeper, simulation = scene.system, Keeper(scene.system), Simulation(scene)
    first = keeper.keep()
    poses = visit([0.0, 0.1], [[0, 0, 0], [0, 0, -0.008]])["finger"]
    positions, quaternions = poses.sample(np.array([0.1]))
    simulation.step({"finger": frame_of(positions[0], quaternions[0])}, 0.1)
    second, upper = keeper.keep(), system.hessian(exact=True)
    rhs = np.random.default_rng(0).standard_normal(system.n_unknowns)
    first.foresee()
    first.solve(rhs)
    plain = _Prepared.data

    def pressed(self, *given):
        raise KeyboardInterrupt

    monkeypatch.setattr(_Prepared, "data", pressed)
    with pytest.raises(KeyboardInterrupt):
        second.foresee()
    monkeypatch.setattr(_Prepared, "data", plain)
    matrix = (upper + triu(upper, 1).T).toarray()
    assert np.abs(matrix @ second.solve(rhs) - rhs).max() < 1e-9


def test_what_is_foreseen_and_never_asked_for_leaves_room(small_rig, visit):
    scene = build_scene(small_rig())
    keeper = Keeper(scene.system)
    Simulation(scene)
    kept = keeper.keep()
    for _ in range(20):
        again = keeper.keep()
        again.foresee()
        del again
    assert len(keeper.prepared(kept.layout)._analyses) == 1
    assert kept.solve(np.ones(scene.system.n_unknowns)).shape == (scene.system.n_unknowns,)


def test_steps_of_different_layouts_are_prepared_once_while_two_are_foreseen(small_rig, monkeypatch):
    """Backwards, as many ahead as a rollout is gone through with."""
    scene = build_scene(small_rig())
    keeper, move = Keeper(scene.system), np.ones_like(scene.system.x)
    Simulation(scene)
    monkeypatch.setattr(stiffness, "SHARING", 0.0)
    kept = []
    for _ in range(6):
        keeper._layout = None  # as if contact had changed
        kept.append(keeper.keep())
    made, plain = [], _Prepared.__init__

    def counted(self, *given):
        made.append(self)
        plain(self, *given)

    monkeypatch.setattr(_Prepared, "__init__", counted)
    backwards = kept[::-1]
    for k, one in enumerate(backwards):
        for ahead in backwards[k : k + stiffness.AHEAD + 1]:
            ahead.foresee()
        one.product(move)
        one.solve(np.ones(scene.system.n_unknowns))
        one.product(move)
    assert len(made) == len(kept)
