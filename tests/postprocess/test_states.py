"""What a trace keeps of a press: positions, frames, contact forces that balance the wrench; and the file of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.postprocess import lay_out
from sim_core.rigs import load_rig
from sim_core.rigs.motion import Experiment, compile_experiment
from sim_core.scene import build_scene
from sim_core.simulate import Trace, simulate, step_times
from sim_core.trace_file import load_trace, save_trace

MOTION = Experiment.model_validate(
    {"name": "press", "motions": {"finger": [{"type": "press", "depth_m": 0.0016, "speed_m_s": 0.02}]}}
)


@pytest.fixture(scope="module")
def trace() -> Trace:
    rig = load_rig("gel_sensor")
    poses = compile_experiment(MOTION, rig)
    end = float(poses["finger"].times[-1])
    return simulate(build_scene(rig), poses, step_times(0.0, end, 0.02), keep_states=True)


def test_states_are_kept_only_where_they_are_asked_for(trace: Trace) -> None:
    rig = load_rig("gel_sensor")
    plain = simulate(build_scene(rig), compile_experiment(MOTION, rig), trace.times[:3])
    assert plain.states is None
    assert np.array_equal(plain.outputs["wrench"], trace.outputs["wrench"][:3])


def test_contact_forces_balance_the_wrench_of_a_slow_press(trace: Trace) -> None:
    assert trace.states is not None
    layout = lay_out(load_rig("gel_sensor"))
    gel, block = (layout.bodies[b].nodes for b in ("gel", "block"))
    force = trace.states.pair_forces["gel-block"]
    assert force[:, gel].sum(axis=1) == pytest.approx(-force[:, block].sum(axis=1), abs=1e-9)
    k = int(np.argmax(force[:, gel, 2].sum(axis=1)))
    assert force[k, gel, 2].sum() > 1.0
    # The sensor's z points along that of the gel, down; in addition to the contact it bears the weight, 6 mN.
    assert force[k, gel, 2].sum() == pytest.approx(-trace.outputs["wrench"][k, 2], rel=0.01)
    assert (trace.states.pressures[0] == 0.0).all() and trace.states.pressures[k].max() > 1e4


def test_frames_of_the_states_are_those_of_the_hand(trace: Trace) -> None:
    assert trace.states is not None
    layout = lay_out(load_rig("gel_sensor"))
    along = layout.frames_along(compile_experiment(MOTION, layout.rig), trace.times)
    assert trace.states.origins["finger"] == pytest.approx(np.stack([f["finger"][0] for f in along]))


def test_a_trace_comes_back_from_its_file_as_it_was(trace: Trace, tmp_path: Path) -> None:
    path = tmp_path / "press.npz"
    save_trace(path, trace)
    back = load_trace(path)
    assert trace.states is not None and back.states is not None
    assert back.kinds == trace.kinds
    for name, values in trace.outputs.items():
        assert np.array_equal(back.outputs[name], values, equal_nan=True)
    assert np.array_equal(back.ids["inside"], trace.ids["inside"])
    assert np.array_equal(back.states.positions, trace.states.positions)
    assert np.array_equal(back.states.pair_forces["gel-block"], trace.states.pair_forces["gel-block"])
    assert np.array_equal(back.states.quaternions["finger"], trace.states.quaternions["finger"])
    with pytest.raises(ConfigError, match="already exists"):
        save_trace(path, trace)


def test_what_is_no_trace_is_refused(tmp_path: Path) -> None:
    (tmp_path / "note.npz").write_text("no")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for name in ("note.npz", "other.npz"):
        with pytest.raises(ConfigError, match="is not a trace"):
            load_trace(tmp_path / name)
    with pytest.raises(ConfigError, match="does not exist"):
        load_trace(tmp_path / "none.npz")
