"""The code in the page on gradients runs as it stands, from top to bottom."""

import re
from pathlib import Path

import numpy as np

PAGE = Path(__file__).parents[2] / "docs" / "design" / "gradients.md"


def test_the_code_of_the_page_runs():
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(blocks) == 3
    names = {}
    exec(blocks[0], names)
    share = names["scene"].fields["gel.E_pa"] == 1e5
    assert 0.2 < share.mean() < 0.8
    by_element = names["found"].fields
    assert by_element["gel.E_pa"].shape == share.shape and np.any(by_element["gel.E_pa"] != 0.0)
    assert np.abs(by_element["card.rest_angle_rad"]).max() > 1e-6
    exec(blocks[1], names)
    assert np.ptp(names["scene"].fields["card.rest_m"][:, 2]) > 5e-4
    by_node = names["found"].fields["card.rest_m"]
    assert by_node.shape == names["shape"].shape and np.abs(by_node).max() > 1e-4
    exec(blocks[2], names)
    zeroth = names["found"].zeroth
    assert zeroth.gradient.shape == (2,) and names["found"].failures == ()
    assert np.all(np.abs(zeroth.gradient) > 3.0 * zeroth.error)
