"""Rollouts of thread blocks against the compiled core: of one thread each, compiled for the CPU, and on a GPU."""

from __future__ import annotations

import numpy as np
import pytest
from strip_over_table import LAND, SWING, strip_rig

from sim_core.errors import ConfigError
from sim_core.gpu.engine import Gpu, Host, Run, device_source
from sim_core.gpu.rollouts import rollouts
from sim_core.gpu.variants import problem_of
from sim_core.rigs import with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sysid.bench import run_gpu_benchmark

TIMES = {"swing": step_times(0.0, 0.3, 0.01), "land": step_times(0.0, 0.4, 0.01)}
VARIANTS = [
    {},
    {
        "strip.E_pa": 3e9,
        "strip.thickness_m": 1.7e-4,
        "strip.density_kg_m3": 1300.0,
        "strip.nu": 0.25,
        "strip.stiffness_damping_s": 2e-3,
        "contacts.strip-table.friction": 0.6,
    },
    {"gravity.x_m_s2": 0.4, "strip.mass_damping_per_s": 2.0, "gripper.offset_z_m": 1e-3},
]


@pytest.fixture(scope="module", params=["one thread", pytest.param("gpu", marks=pytest.mark.gpu)])
def device(request):
    """Where rollouts run: this processor, by the same source, or a GPU."""
    if request.param == "one thread":
        return Host()
    try:
        return Gpu()
    except ConfigError as error:
        pytest.skip(str(error))


def on_the_core(rig, variant, poses, times):
    return simulate(build_scene(with_parameters(rig, variant)), poses, times, keep_path=True)


@pytest.mark.parametrize(
    ("poses", "times", "changes"),
    [
        (SWING, TIMES["swing"], {}),
        (LAND, TIMES["land"], {}),
        (LAND, TIMES["land"], {"solver": {"dt_s": 0.01, "inertia": True, "integrator": "implicit_euler"}}),
        (SWING, TIMES["swing"], {"contacts": []}),
        (SWING, TIMES["swing"], {"solver": {"dt_s": 0.01, "inertia": False, "integrator": "bdf2"}}),
    ],
    ids=["swing", "land", "first order", "nothing to touch", "static"],
)
def test_each_rollout_is_that_of_the_core(device, poses, times, changes):
    rig, variants = strip_rig(**changes), VARIANTS if not changes else VARIANTS[:1]
    found = rollouts(rig, variants, poses, times, device=device, readings=True)
    assert found.converged.all() and (found.made == len(times) - 1).all()
    for k, variant in enumerate(variants):
        expected = on_the_core(rig, variant, poses, times)
        assert np.abs(found.positions[k] - expected.path.positions[-1]).max() < 1e-9
        for channel, values in expected.outputs.items():
            scale = float(np.nanmax(np.abs(values)))
            np.testing.assert_allclose(found.outputs[channel][k], values, rtol=0.0, atol=1e-6 * scale, err_msg=channel)
    if len(variants) > 1:
        apart = np.abs(found.positions[1:] - found.positions[0]).max(axis=(1, 2))
        assert (apart > 1e-5).all()


def test_bits_do_not_depend_on_the_batch_or_the_run(device):
    rig = strip_rig()
    problem = problem_of(rig, VARIANTS, LAND, TIMES["land"])
    whole, again = (Run(problem, device).steps(0, 40).last for _ in range(2))
    alone = Run(problem.part(1), device).steps(0, 40).last
    assert np.array_equal(whole, again) and np.array_equal(whole[:1], alone)


def test_steps_go_on_where_the_last_call_left_off(device):
    problem = problem_of(strip_rig(), VARIANTS[:2], LAND, TIMES["land"])
    at_once, run = Run(problem, device).steps(0, 40), Run(problem, device)
    run.steps(0, 25)
    in_parts = run.steps(25, 15)
    assert (in_parts.made == 40).all()
    assert np.array_equal(at_once.last, in_parts.last)


def test_one_that_fails_does_not_stop_the_others(device):
    """A hand that is pushed through the table: from there on there is no way."""
    through = PoseTrajectory.from_samples(
        np.array([0.0, 0.1, 0.3]), np.array([[0, 0, 0.1], [0, 0, 0.03], [0, 0, -0.05]]), np.tile([0.0, 0, 0, 1], (3, 1))
    )
    rig, times = strip_rig(), TIMES["swing"]
    found = rollouts(rig, [{}, {}], [{"gripper": through}, SWING], times, device=device, readings=True)
    assert found.converged.tolist() == [False, True]
    assert 0 < found.made[0] < 30 and found.made[1] == 30
    for values in found.outputs.values():
        assert np.isnan(values[0, found.made[0] + 1 :]).all()
    expected = on_the_core(rig, {}, SWING, times)
    assert np.abs(found.positions[1] - expected.path.positions[-1]).max() < 1e-9
    np.testing.assert_allclose(found.outputs["wrist"][1], expected.outputs["wrist"], atol=1e-8)


def test_what_is_not_for_a_device_is_refused():
    plastic = strip_rig(effects={"bending_plasticity": {"yield_curvature_per_m": 5.0, "hardening_ratio": 0.1}})
    with pytest.raises(ConfigError, match="plastic flow"):
        problem_of(plastic, [{}], SWING, TIMES["swing"])
    with pytest.raises(ConfigError, match="no variants"):
        problem_of(strip_rig(), [], SWING, TIMES["swing"])
    with pytest.raises(ConfigError, match="3 variants and poses for 2"):
        problem_of(strip_rig(), VARIANTS, [SWING, LAND], TIMES["swing"])


def test_the_source_for_a_gpu_is_whole():
    """One text without includes of the project, each header once."""
    text = device_source()
    assert '#include "' not in text
    for once in ("class FastNewton", "class GuardedNewton", "struct Record {", "class BlockSystem", "green_strain("):
        assert once in text
    assert text.count("class FastNewton") == 1 and text.count("struct Plan {") == 1


def test_a_window_beyond_shared_memory_gives_the_same_and_a_band_beyond_it_is_refused():
    problem, narrow = problem_of(strip_rig(), VARIANTS[:1], LAND, TIMES["land"]), Host()
    expected = Run(problem, narrow).steps(0, 40).last
    narrow.shared_bytes = 8 * (64 * 6 + 2 + 2 * 8 + 16 * 8 + 4 * 64 * 3)
    run = Run(problem, narrow)
    assert not run.window_is_shared
    assert np.array_equal(run.steps(0, 40).last, expected)
    narrow.shared_bytes -= 8
    with pytest.raises(ConfigError, match="of 63 unknowns"):
        Run(problem, narrow)


def test_without_a_gpu_the_benchmark_says_so_in_one_sentence():
    try:
        Gpu()
    except ConfigError:
        with pytest.raises(ConfigError, match=r"Rollouts on a GPU need .*thinshell_ros\[gpu\]"):
            run_gpu_benchmark()
    else:
        pytest.skip("there is a GPU")
