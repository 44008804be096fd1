"""Pictures of experiments, and the page on what they determine."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from sim_core.errors import ConvergenceError
from sim_core.rigs import load_rig, with_parameters
from sim_core.rigs.motion import Experiment, compile_experiment
from sysid.cli.app import main
from sysid.design.experiment_design import Expected, Outlook, Plan, plan_experiments
from sysid.model.parameters import fit_parameters
from sysid.report import experiments_page
from sysid.report.experiments_page import HEAD, _section, by_rig, identifying, parameters_of
from sysid.report.motion_picture import draw_experiment, telling_instants

DOCS = Path(__file__).resolve().parents[2] / "docs"


def pull(**changes: Any) -> Experiment:
    motions = [
        {"type": "wait", "duration_s": 0.2},
        {"type": "pull", "distance_m": 0.0006, "speed_m_s": 0.001, "hold_s": 0.5},
    ]
    return Experiment.model_validate({"name": "pull", "motions": {"gripper": motions}, **changes})


def test_instants_are_in_the_middle_of_holds() -> None:
    """Of a wait, a pull of 0.7 s (0.1 s to full speed), a hold of 0.5 s and the way back."""
    poses = compile_experiment(pull(), load_rig("strip_pull"))
    instants = telling_instants(poses)
    assert instants[0] == 0.0
    assert instants[1] == pytest.approx(0.2 + 0.7 + 0.25, abs=0.011)
    assert len(instants) == 2, "where it has come back is where it started"


def test_instants_of_a_motion_without_holds_are_far_from_each_other() -> None:
    wander = {"type": "random", "duration_s": 5.0, "bounds_m": [0.004, 0.004, 0.002], "seed": 1}
    experiment = Experiment.model_validate({"name": "wander", "motions": {"gripper": [wander]}})
    poses = compile_experiment(experiment, load_rig("strip_pull"))
    instants = telling_instants(poses)
    assert len(instants) == 4
    there, anywhere = poses["gripper"].sample(instants)[0], poses["gripper"].positions
    apart = np.linalg.norm(there[:, None] - there[None], axis=2)[np.triu_indices(4, 1)]
    left = np.linalg.norm(anywhere[:, None] - there[None], axis=2).min(axis=1)
    assert left.max() <= apart.min(), "each is as far from the others as any pose could be"


def test_a_picture_shows_the_instants_and_only_what_moves() -> None:
    svg = draw_experiment(load_rig("strip_pull"), pull())
    texts = re.findall(r">([^<>]+)</text>", svg)
    assert {"pull on strip_pull", "0.00 s", "1.15 s", "gripper [mm]", "x", "time [s]"} <= set(texts)
    assert not {"y", "z", "about y", "deg"} & set(texts)
    assert svg == draw_experiment(load_rig("strip_pull"), pull())


def test_every_experiment_that_identifies_names_a_rig_and_parameters_that_exist() -> None:
    for experiment in identifying():
        assert experiment.rig is not None
        rig = load_rig(experiment.rig)
        compile_experiment(experiment, rig)
        assert fit_parameters(rig, parameters_of(rig, [experiment]))


def test_every_experiment_that_identifies_is_in_the_documentation() -> None:
    page = (DOCS / "experiments.md").read_text()
    for experiment in identifying():
        assert f"experiments/{experiment.name}.svg" in page
        assert (DOCS / "experiments" / f"{experiment.name}.svg").read_text().startswith("<?xml")


def test_the_documentation_says_what_the_command_says_of_its_tables() -> None:
    command = "thinshell experiments --out docs/experiments --page"
    assert (DOCS / "experiments.md").read_text().startswith(HEAD.format(command=command))


def test_a_table_has_the_relative_standard_deviations_of_plan() -> None:
    rig = load_rig("strip_pull")
    experiment = pull(rig="strip_pull", identifies=["strip.E", "strip.thickness", "strip.nu"])
    names = parameters_of(rig, [experiment])
    assert names == ["strip.E_pa", "strip.thickness_m", "strip.nu"]
    parameters = (
        Expected(names[0], "Pa", 4.9e9, (0.0, 1.0), 0.02, True, True, {"load_cell": 0.97, "above": 0.03}),
        Expected(names[1], "m", 1e-4, (0.0, 1.0), 0.01, True, True, {"above": 1.0}),
        Expected(names[2], "", 0.38, (0.0, 1.0), 0.5, False, False, {"above": 1.0}),
    )
    correlation = [[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    outlook = Outlook(("pull",), parameters, correlation, ())
    text = _section(rig, [experiment], names, [outlook], "pictures")
    assert "| `strip.E_pa` | 4.9e+09 Pa | 2 % | load_cell 97 % |" in text
    assert "| `strip.nu` | 0.38 | \u2013 | |" in text
    rows = [line.split() for line in Plan(rig.name, (outlook,)).table().splitlines()[2:]]
    assert [row[0] for row in rows] == names
    for row, name in zip(rows, names, strict=True):
        (cell,) = re.findall(rf"\| `{name}` \| [^|]* \| ([^|]*) \|", text)
        said = "not determined" if cell == "\u2013" else cell
        assert f" {said} " in f"{' '.join(row)} ", "what the table says, 'thinshell plan' says"
    assert [Expected("a", "s", 0.0, (0.0, 1.0), 0.012, log, True, {}).spread() for log in (0, 1)] == [
        "0.012 s",
        "1.2 %",
    ]
    # Fully opposed: E t is known to 2 - 1 %, E t^3 to |2 - 3| %.
    assert "E t of the strip: 1 %, its bending stiffness E t\u00b3/12: 1 %" in text


def test_an_experiment_without_a_rig_cannot_be_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["experiments", "drop", "--out", str(tmp_path / "pictures")]) == 2
    assert "names no rig" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValidationError, match="stands without identifies"):
        Experiment.model_validate({"name": "a", "duration_s": 1.0, "rig": "strip_pull"})


SHORT = """name: {name}
rig: strip_pull
identifies: [strip.E]
motions: {{gripper: [{{type: pull, distance_m: 0.0002, speed_m_s: 0.002}}]}}
"""


@pytest.fixture
def drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with two experiments, whose pictures and plans are stand-ins."""
    for name in ("one", "two"):
        (tmp_path / f"{name}.yaml").write_text(SHORT.format(name=name))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(experiments_page, "draw_experiment", lambda rig, experiment: f"picture of {experiment.name}")
    expected = Expected("strip.E_pa", "Pa", 4.9e9, (0.0, 1.0), 0.02, True, True, {"load_cell": 1.0})
    plan = SimpleNamespace(outlooks=[Outlook(("one", "two"), (expected,), [[1.0]], ())])
    monkeypatch.setattr(experiments_page, "plan_experiments", lambda *given: plan)
    return tmp_path


def test_pictures_and_page_are_named_after_the_folder(drawn: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["experiments", "one.yaml", "two.yaml", "--out", "deep/pics.v2", "--page"]) == 0
    assert sorted(str(p.relative_to(drawn / "deep")) for p in (drawn / "deep").rglob("*")) == [
        "pics.v2", "pics.v2.md", "pics.v2/one.svg", "pics.v2/two.svg",
    ]  # fmt: skip
    assert f"Page: {drawn}/deep/pics.v2.md" in capsys.readouterr().out
    assert experiments_page.page_path(Path(".")) == drawn.with_name(f"{drawn.name}.md")
    page = (drawn / "deep" / "pics.v2.md").read_text()
    assert "(pics.v2/one.svg)" in page and "`thinshell experiments one.yaml two.yaml --out deep/pics.v2 --page`" in page


def test_the_page_says_where_offsets_are_known_better_than_usual(drawn: Path) -> None:
    (drawn / "one.yaml").write_text(SHORT.format(name="one").replace("strip_pull", "material_bench"))
    assert main(["experiments", "one.yaml", "two.yaml", "--out", "pics", "--page"]) == 0
    (said,) = [line for line in (drawn / "pics.md").read_text().splitlines() if "is known to" in line]
    known = "0.5, 0.5, 0.1 mm and 0.5, 0.5, 0.5 deg along and about its axes before."
    assert said == f"The offset of the finger is known to {known}"


def test_pictures_without_a_page(drawn: Path) -> None:
    assert main(["experiments", "one.yaml", "--out", "pics"]) == 0
    assert sorted(p.name for p in drawn.iterdir()) == ["one.yaml", "pics", "two.yaml"]


def test_a_plan_that_fails_leaves_nothing_so_that_the_same_can_be_asked_again(
    drawn: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["experiments", "one.yaml", "--out", "deep/pics", "--page"]

    def fails(*given: Any) -> None:
        raise ConvergenceError("The step does not converge.")

    with monkeypatch.context() as broken:
        broken.setattr(experiments_page, "plan_experiments", fails)
        assert main(words) == 2
    assert "does not converge" in capsys.readouterr().err
    assert sorted(p.name for p in drawn.iterdir()) == ["one.yaml", "two.yaml"]
    assert main(words) == 0


def test_two_experiments_of_one_name_are_refused(drawn: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (drawn / "again.yaml").write_text(SHORT.format(name="one"))
    assert main(["experiments", "one.yaml", "again.yaml", "--out", "pics"]) == 2
    assert "Two experiments are named 'one'" in capsys.readouterr().err
    assert not (drawn / "pics").exists()


def test_pictures_may_go_into_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which has no name but its dot, and with pictures that are drawn."""
    (tmp_path / "one.yaml").write_text(SHORT.format(name="one"))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert main(["experiments", "../one.yaml", "--out", "."]) == 0
    assert [p.name for p in (tmp_path / "here").iterdir()] == ["one.svg"]
    assert (tmp_path / "here" / "one.svg").read_text().startswith("<?xml")


@pytest.mark.slow
@pytest.mark.parametrize("height_m", [0.0, 2e-4, -2e-4])
def test_the_bench_determines_sheet_gel_and_friction(height_m: float) -> None:
    """Gel modulus and Poisson's ratio, stretching and bending stiffness (E, t, nu), density, two frictions: below 3 %,
    with unknown time offsets, biases, intrinsics and offsets; also where the finger is two standard deviations
    higher or lower than it says."""
    rig = with_parameters(load_rig("material_bench"), {"finger.offset_z_m": height_m})
    experiments = by_rig(identifying())["material_bench"]
    names = parameters_of(rig, experiments)
    assert set(names) == {
        "strip.E_pa", "strip.nu", "strip.thickness_m", "strip.density_kg_m3", "gel.E_pa", "gel.nu",
        "contacts.gel-strip.friction", "contacts.gel-post.friction",
    }  # fmt: skip
    together = plan_experiments(rig, experiments, names).outlooks[-1]
    for p in together.parameters:
        assert p.determined and (p.sd if p.log else p.sd / p.value) < 0.03, p
