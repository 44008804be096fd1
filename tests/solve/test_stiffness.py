"""A kept Hessian against the system's own, when the system has gone on."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import triu

from sim_core.scene import build_scene
from sim_core.simulate import Simulation, frame_of
from sim_core.solve.stiffness import Keeper

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
    for stiffness, (matrix, product) in reversed(list(zip(kept, references, strict=True))):
        assert np.array_equal(stiffness.product(move), product)
        for right in (rhs, rhs[:, 0]):
            assert np.abs(matrix @ stiffness.solve(right) - right).max() < 1e-9
