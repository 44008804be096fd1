"""Runs of scenes, each made once in a session."""

import pytest
from scene_runs import run


@pytest.fixture(scope="session")
def ran():
    """Runs by rig and experiment."""
    made = {}

    def get(rig, experiment):
        if (rig, experiment) not in made:
            made[rig, experiment] = run(rig, experiment)
        return made[rig, experiment]

    return get
