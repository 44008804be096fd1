import json
from dataclasses import asdict

import pytest

from sim_core.bench import measure


@pytest.mark.slow
def test_benchmark_is_the_workload_that_it_says():
    """About 1,700 unknowns, contact of both pairs with friction, every step converged, every second counted."""
    found = measure()
    assert 1650 <= found.unknowns <= 1750
    assert found.steps == 120
    assert found.contact_steps > 60
    assert found.most_contacts > 20
    assert sum(found.parts_s.values()) == pytest.approx(found.wall_s)
    assert all(seconds > 0.0 for part, seconds in found.parts_s.items() if part.startswith("assembly"))
    assert json.loads(json.dumps(asdict(found)))["rig"] == "forming"
