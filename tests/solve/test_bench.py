import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.rigs.load import names_in
from sysid.bench import measure, measure_gradients
from sysid.bench.gradients import SCENES as GRADIENT_SCENES
from sysid.bench.gradients import gradient_lines
from sysid.bench.machine import peak_memory_mb
from sysid.bench.report import run_benchmarks, scaling_lines
from sysid.bench.scale import DIFFCLOTH, MESHES, Mesh, Published, Scaling, Size, growth, measure_size
from sysid.bench.scenes import SCENES, measure_scene, scene_lines


@pytest.mark.slow
def test_benchmark_is_the_workload_that_it_says():
    """About 1,700 unknowns, contact of both pairs with friction, every step converged."""
    found = measure()
    assert 1650 <= found.unknowns <= 1750
    assert found.steps == 120
    assert found.contact_steps > 60
    assert found.most_contacts > 20
    assert found.path == "compiled core"
    assert found.factorisations_per_step < 2.5
    assert json.loads(json.dumps(asdict(found)))["rig"] == "forming"


def size(unknowns, published=None):
    return Size(unknowns, 0.5, 1e-6 * unknowns**1.5, 4.0, 2.0, 7, 300.0, published)


def test_a_size_is_timed_in_contact_with_every_step_converged():
    found = measure_size(Mesh((13, 11), "regular"))
    assert found.unknowns == 3 * 12 * 12
    assert found.contacts > 0
    assert found.factorisations_per_step >= 1.0
    assert 0.0 < found.cpu_step_s
    assert found.peak_memory_mb > 50.0


def test_sizes_are_those_that_were_promised():
    """1.7k, 5k, 20k and 60k unknowns, and about as many as in the published scenes."""
    unknowns = {}
    for mesh in MESHES:
        (nx, ny), crossed = mesh.cells, mesh.pattern == "crossed"
        free = (nx - 1) * (ny + 1) + (nx - 1) * ny * crossed
        unknowns[3 * free] = mesh.published and mesh.published.name
    assert [n for n, name in unknowns.items() if name is None] == [1728, 5043, 20172, 59643]
    published = {name: n for n, name in unknowns.items() if name is not None}
    assert published["DiffCloth"] == pytest.approx(2469, rel=0.005)
    assert published["C-IPC"] == pytest.approx(18300, rel=0.005)


def test_the_exponent_is_that_of_the_times():
    assert growth([size(1728), size(5043), size(59643)]) == pytest.approx(1.5)


def test_published_figures_stand_next_to_ours_with_the_ratio():
    found = Scaling((size(1728), size(2475, DIFFCLOTH)), 1.5)
    lines = scaling_lines(found)
    assert "unknowns^1.50" in lines[0]
    assert lines[3].endswith(f"DiffCloth: 7.14 steps/s, here {2.0 / 7.14:.2g} times as many")
    assert np.isfinite(json.loads(json.dumps(asdict(found)))["exponent"])


def peaks_about_400_mb() -> tuple[float, float]:
    before = peak_memory_mb()
    np.ones(50_000_000)
    return before, peak_memory_mb()


def test_peak_memory_of_a_process_is_its_own():
    """In a new process, which has held nothing larger before."""
    _, here = peaks_about_400_mb()
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        before, after = pool.submit(peaks_about_400_mb).result()
    assert before < here - 200.0
    assert after > before + 300.0


def test_scenes_of_the_benchmark_come_with_the_package():
    """Ten tasks and the separating one twice, every rig and experiment by its name."""
    assert len(SCENES) == 11
    for rig, experiment, _ in SCENES:
        assert rig in names_in("rigs") and experiment in names_in("experiments")


def test_a_scene_is_measured_and_takes_a_line():
    found = measure_scene("bouncing", "fall", Published("Other", "source", 10.0), most_steps=30)
    assert found.steps == 30
    assert found.unknowns == 789
    assert 0.0 < found.smallest_gap_m < 0.01
    assert found.halvings == 0
    assert found.most_iterations >= found.iterations_per_step >= 1.0
    title, line = scene_lines([found])
    assert line.startswith("bouncing fall")
    assert line.endswith(f"Other: 10 steps/s, here {found.steps_per_s / 10.0:.2g} times as many")
    assert len(title.split()) <= len(line.split())
    assert json.loads(json.dumps(asdict(found)))["published"]["name"] == "Other"


def test_quick_and_scenes_exclude_each_other():
    with pytest.raises(ConfigError, match="one of the two"):
        run_benchmarks(quick=True, scenes=True)


@pytest.mark.parametrize("name", GRADIENT_SCENES)
def test_the_adjoint_is_timed(name):
    found = measure_gradients(name, steps=3)
    spent = {key: value for key, value in asdict(found).items() if isinstance(value, float)}
    assert len(spent) == 6
    assert min(spent.values()) > 0.0
    text = "\n".join(gradient_lines(found))
    for value in (found.backward, found.backward_fields):
        assert f"{value:9.3f}{value / found.forward:10.2f}" in text
    assert found.backward_to_forward == found.backward_parameters / found.forward
    assert json.loads(json.dumps(asdict(found)))["steps"] == 3
