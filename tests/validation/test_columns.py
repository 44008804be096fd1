"""Strips that are bent by shears and couples, and columns that give way."""

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sysid.validation.buckling import EULER, GREENHILL, POST_BUCKLED, critical_load, euler, greenhill, post_buckled
from sysid.validation.elasticas import SHARES, end_moment, end_shear, heavy_strip
from sysid.validation.planar_elastica import heavy, hinged, rolled, tip_loaded
from sysid.validation.specimens import rest, strip

PATTERNS = pytest.mark.parametrize("pattern", ["regular", "irregular"])


@PATTERNS
@pytest.mark.parametrize("gamma", [1e3, 1e4])
def test_a_very_heavy_strip_bends_in_a_layer_at_its_clamp(pattern, gamma):
    """The reach is that of the layer, a hundredth of the length: cells have to be small there."""
    np.testing.assert_allclose(heavy_strip(gamma, pattern, (80, 2)), heavy(gamma), rtol=0.005)


@PATTERNS
def test_a_cantilever_under_an_end_shear(pattern):
    np.testing.assert_allclose(end_shear(pattern, (40, 4)), [tip_loaded(4.0 * share) for share in SHARES], rtol=0.005)


@PATTERNS
def test_a_couple_rolls_a_cantilever_into_a_circle(pattern):
    """Tip within 0.2 % of the length, at a quarter of a turn and at a full one, in large steps."""
    np.testing.assert_allclose(
        end_moment(pattern, (40, 4)), [rolled(2.0 * np.pi * share) for share in SHARES], atol=0.002
    )


@PATTERNS
@pytest.mark.parametrize("ends", EULER)
def test_a_column_gives_way_at_the_load_of_euler(ends, pattern):
    assert euler(ends, pattern, (40, 4)) == pytest.approx(EULER[ends], rel=0.01)


@PATTERNS
def test_a_column_gives_way_under_its_own_weight(pattern):
    assert greenhill(pattern, (40, 4)) == pytest.approx(GREENHILL, rel=0.01)


@PATTERNS
def test_a_column_beyond_its_buckling_load_is_an_elastica(pattern):
    expected = [(force, np.degrees(slope), middle) for force, slope, middle in map(hinged, POST_BUCKLED)]
    np.testing.assert_allclose(post_buckled(pattern, (40, 4)), expected, rtol=0.01)


def test_a_load_that_cannot_buckle_is_named():
    """Tension stiffens."""
    held = strip(0.2, 0.02, {"E_pa": 1e9, "nu": 0.0, "thickness_m": 2e-4}, (8, 1))

    def pull(load):
        held.system.loads[:, 0] = 1e-3 * load * held.spread(1)

    with pytest.raises(ConfigError, match="does not fall"):
        critical_load(held.system, rest(held.system), pull, 1.0)
