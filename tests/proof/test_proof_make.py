"""What cases consist of: nothing that names the effect, nothing that differs but the readings."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader

from sim_core.effects import all_effects, effect_by_name
from sim_core.rigs import Rig, list_parameters, load_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, Trace
from sysid.model.load import load_run
from sysid.noise.estimate import estimate_noise
from sysid.observations.observations import Measured, Run
from sysid.proof import make_cases
from sysid.proof.generator import bench, make
from sysid.proof.generator.concealed import DRAWS, draw_amplitudes
from sysid.proof.generator.noise import ColouredNoise
from sysid.proof.generator.plan import plan_cases
from sysid.proof.outcome import kind_of
from sysid.proof.seal import open_seal
from sysid.proof.truths.conceal import LIBRARY, OUTSIDE


@pytest.fixture(scope="module")
def at_rest() -> dict[str, np.ndarray]:
    """Readings of the bench at its start pose."""
    simulation = Simulation(build_scene(load_rig(bench.RIG)), settle=False)
    return {"kinds": simulation.observer.kinds, "ids": simulation.observer.ids, "read": simulation.read()}


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, at_rest: dict) -> None:
    """Readings that stand still instead of simulations, and any amplitude taken as visible."""

    def trace(rig: Rig, poses: dict[str, PoseTrajectory]) -> Trace:
        times = np.linspace(0.0, float(next(iter(poses.values())).times[-1]), 11)
        outputs = {c: np.repeat(v[None], len(times), axis=0) for c, v in at_rest["read"].items()}
        return Trace(times, outputs, at_rest["kinds"], at_rest["ids"], ())

    monkeypatch.setattr(make, "_trace", trace)
    monkeypatch.setattr(make, "Sight", lambda *_: None)
    monkeypatch.setattr(make, "_visible", lambda rng, effect, sight: (draw_amplitudes(rng, effect), 99.0))


def contents(bag: Path) -> dict:
    """Everything of a bag but the readings: topics, types, stamps, poses, file names, attachments."""
    found: dict = {"files": sorted(p.name.replace(bag.name, "") for p in bag.iterdir()), "messages": []}
    for path in sorted(bag.glob("*.mcap")):
        with path.open("rb") as stream:
            reader = make_reader(stream)
            found["attachments"] = [a.name for a in reader.iter_attachments()]
            found["metadata"] = [(m.name, m.metadata) for m in reader.iter_metadata()]
            header = reader.get_header()
            found["header"] = (header.profile, header.library)
            for schema, channel, message in reader.iter_messages():
                fixed = message.data if "pose" in channel.topic or "info" in channel.topic else len(message.data)
                found["messages"].append(
                    (channel.topic, channel.metadata, schema.name, message.log_time, message.publish_time, fixed)
                )
    return found


@pytest.mark.parametrize("effect", sorted(DRAWS))
def test_a_case_with_an_effect_differs_from_one_without_in_readings_only(
    quick: None, tmp_path: Path, effect: str
) -> None:
    for name, concealed in (("null", ()), ("effect", (effect,))):
        (tmp_path / name).mkdir()
        make.make_case(tmp_path / name / "case_01", concealed, np.random.SeedSequence(7), lambda share: None)
    null, other = (tmp_path / name / "case_01" for name in ("null", "effect"))
    assert sorted(p.name for p in null.iterdir()) == sorted(p.name for p in other.iterdir())
    for name in ("rig.yaml", "case.yaml"):
        assert (null / name).read_bytes() == (other / name).read_bytes()
    for run in bench.KINDS:
        assert contents(null / run) == contents(other / run)
        assert (null / run / "metadata.yaml").read_text() == (other / run / "metadata.yaml").read_text()


def test_cases_differ_in_readings_and_poses_only(quick: None, tmp_path: Path) -> None:
    """Across independent cases: same topics, counts, stamps and files."""
    make_cases(tmp_path / "out", cases=8, seed=2, rigs=("bench",))
    seen = set()
    for case in sorted((tmp_path / "out").glob("case_*")):
        for run, kind in bench.KINDS.items():
            found = contents(case / run)
            messages = [m[:5] for m in found.pop("messages")]
            seen.add((kind, repr(found).replace(run, ""), repr(messages)))
    assert len(seen) == len(set(bench.KINDS.values()))


def test_what_is_handed_out(quick: None, tmp_path: Path) -> None:
    out = tmp_path / "out"
    make_cases(out, cases=4, seed=11, rigs=("bench",))
    assert sorted(p.name for p in out.iterdir()) == [
        "case_01", "case_02", "case_03", "case_04", "sealed", "sealed.json.sha256",
    ]  # fmt: skip
    truth = open_seal(out)
    for case in truth["cases"]:
        folder = out / case["case"]
        assert sorted(p.name for p in folder.iterdir()) == ["case.yaml", "rig.yaml", "run_a", "run_b", "run_c", "run_d"]
        roles = yaml.safe_load((folder / "case.yaml").read_text())
        assert roles == {"training": ["run_a", "run_b"], "held_out": ["run_c", "run_d"]}
        rig = load_rig(folder / "rig.yaml")
        assert not rig.effects and rig.name == "bench"
        nominal = {p.name: p.value for p in list_parameters(rig)}
        for name, value in case["materials"].items():
            assert abs(nominal[name] / value - 1.0) <= 0.41
            assert nominal[name] != pytest.approx(value, rel=1e-4)
        text = (folder / "rig.yaml").read_text()
        assert not [e.name for e in all_effects().values() if e.name in text]
        for concealed in case["effects"]:
            effect = effect_by_name(concealed["name"])
            bounds = {p.name: (p.lower, p.upper) for p in effect.parameters}
            assert concealed["slot"] == effect.slot
            assert set(concealed["parameters"]) == set(bounds)
            assert all(bounds[k][0] <= v <= bounds[k][1] for k, v in concealed["parameters"].items())
        assert [m.channel for m in load_run(rig, folder / "run_a").measured] == ["force", "gel_markers", "side"]


def test_same_seed_same_cases(quick: None, tmp_path: Path) -> None:
    for name, seed in (("a", 4), ("b", 4), ("c", 5)):
        make_cases(tmp_path / name, cases=2, seed=seed, rigs=("bench",))
    files = [p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file()]
    assert files
    for path in files:
        assert (tmp_path / "a" / path).read_bytes() == (tmp_path / "b" / path).read_bytes(), path
    assert (tmp_path / "a" / "sealed.json.sha256").read_text() != (tmp_path / "c" / "sealed.json.sha256").read_text()


def test_a_shard_of_twenty() -> None:
    """Seven empty cases, eight with one effect, two with two, three outside the library; every rig its share."""
    for seed in range(20):
        plan = plan_cases(np.random.default_rng(seed), 20, ("bench", "strip", "gel"))
        sealed = [
            [{"in_library": name in {**DRAWS, **LIBRARY.get(case.rig, {})}} for name in case.effects] for case in plan
        ]
        assert Counter(map(kind_of, sealed)) == {"empty": 7, "one": 8, "two": 2, "outside": 3}
        rigs = Counter(case.rig for case in plan)
        assert min(rigs.values()) >= 4 and rigs["strip"] + rigs["gel"] >= 12
        for case in plan:
            assert len(set(case.effects)) == len(case.effects)
            assert all(n in {**LIBRARY.get(case.rig, DRAWS), **OUTSIDE.get(case.rig, {})} for n in case.effects)
    assert len({str(plan_cases(np.random.default_rng(s), 20, ("strip", "gel"))) for s in range(20)}) == 20


def test_every_effect_of_a_rig_comes_once_before_any_comes_twice() -> None:
    plan = plan_cases(np.random.default_rng(1), 40, ("bench",))
    assert {case.rig for case in plan} == {"bench"}
    singles = Counter(name for case in plan for name in case.effects)
    assert set(singles) == set(DRAWS)
    assert max(singles.values()) - min(singles.values()) <= 1


@pytest.mark.parametrize("rig", sorted(LIBRARY))
def test_what_the_stands_conceal_is_known_by_name_where_it_should_be(rig: str) -> None:
    assert set(LIBRARY[rig]) <= set(all_effects())
    assert not set(OUTSIDE[rig]) & set(all_effects())


def test_amplitudes_stay_within_physical_bounds() -> None:
    rng = np.random.default_rng(0)
    for name in DRAWS:
        bounds = {p.name: (p.lower, p.upper) for p in effect_by_name(name).parameters}
        for _ in range(200):
            drawn = draw_amplitudes(rng, name)
            assert set(drawn) == set(bounds)
            assert all(bounds[k][0] <= v <= bounds[k][1] for k, v in drawn.items())


def test_runs_of_a_kind_last_equally_long() -> None:
    rig = load_rig(bench.RIG)
    rng = np.random.default_rng(0)
    for kind, duration in bench.DURATION_S.items():
        ends = [float(p.times[-1]) for _ in range(200) for p in bench.draw_poses(rng, rig, kind).values()]
        assert ends == pytest.approx([duration] * len(ends))


def test_noise_has_its_level_and_colour() -> None:
    rig = load_rig(bench.RIG)
    levels = {
        "force_n": bench.Noise(0.02, 0.7),
        "torque_nm": bench.Noise(1e-4, 0.7),
        "position_px": bench.Noise(0.1, 0),
    }
    noise = ColouredNoise(rig, levels, np.random.SeedSequence(3))
    t = np.arange(20_000) / 100.0
    force = noise("force", "wrench", t, np.zeros((len(t), 6)))
    assert np.std(force[:, 1]) == pytest.approx(0.02, rel=0.05)
    assert np.std(force[:, 4]) == pytest.approx(1e-4, rel=0.05)
    assert np.corrcoef(force[1:, 0], force[:-1, 0])[0, 1] == pytest.approx(0.7, abs=0.03)
    assert abs(np.corrcoef(force[:, 0], force[:, 1])[0, 1]) < 0.05
    pixels = noise("side", "tracks", t, np.zeros((len(t), 3, 2)))
    assert np.std(pixels) == pytest.approx(0.1, rel=0.03)
    assert abs(np.corrcoef(pixels[1:, 0, 0], pixels[:-1, 0, 0])[0, 1]) < 0.03


@pytest.mark.slow
def test_one_case_simulated(tmp_path: Path) -> None:
    """A real case: it fits its rig's channels, touches, and its noise is as sealed."""
    make_cases(tmp_path / "out", cases=1, seed=1, rigs=("bench",))
    case = open_seal(tmp_path / "out")["cases"][0]
    assert all(effect["signal"] >= 12.0 for effect in case["effects"])
    rig = load_rig(tmp_path / "out" / "case_01" / "rig.yaml")
    runs = [load_run(rig, tmp_path / "out" / "case_01" / name) for name in bench.KINDS]
    assert forces(runs[0])[:, 2].min() < -0.3
    sd = float(estimate_noise(runs, "side").sigma[0])
    assert sd == pytest.approx(case["noise"]["position_px"]["sd"], rel=0.4)
    assert json.dumps(case)


def forces(run: Run) -> np.ndarray:
    measured: Measured = next(m for m in run.measured if m.kind == "wrench")
    return measured.values[:, :3]
