"""Task files: those of the package load, and mistakes in others are reported with key and remedy."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_task import TASK, small_task

from sim_core.errors import ConfigError
from sim_core.tasks import ActionSpace, load_task, read_task, task_names
from sim_core.tasks.rollout import reward_of


@pytest.mark.parametrize("name", task_names())
def test_tasks_of_the_package_load(name: str) -> None:
    task = read_task(name)
    assert task.name == name
    reward_of(task.reward)
    for variant in task.variants:
        made = load_task(f"{name}:{variant}")
        space = ActionSpace(made)
        assert space.size == len(set(space.names)) and made.variant.words.endswith(".")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fingers: [finger]", "fingers: [fingr]", r"fingers names 'fingr', which is no end effector.*Did you mean"),
        ("body: card, grid: [4, 2]", "body: gel, grid: [4, 2]", r"points.sheet.body names 'gel'.*no sheet"),
        ("grid: [4, 2]", "grid: [4, 2, 2]", r"points.sheet.grid is \[4, 2, 2\], but card is a rectangle"),
        ("body: card, grid: [4, 2]", "body: card", r"points.sheet has no grid"),
        ("knots: 2", "knots: 20", r"actions.knots is 20, more than the 8 steps"),
        ("step_m: [0.0006, 0.0006, 0.0012], step_deg: [1.0, 1.0, 1.0]", "step_m: [0.0, 0.0, 0.0]", "nothing moves"),
        ("step_m: [0.0006, 0.0006, 0.0012]", "step_mm: [0.6, 0.6, 1.2]", r"step_mm is not a key.*step_m"),
        ("success: 0.05", "succes: 0.05", r"succes is not a key"),
        ("variants:", "best: 0.05\nvariants:", r"best is 0.05, but a success of the variant 'real' has 0.05 and more"),
        ("words: The strip is bent.", "parameters: {card.Epa: 1.0}\n    words: X.", r"variant real: .*card.E_pa"),
        ("variants:\n", "family: {card.Epa: [1.0, 2.0]}\nvariants:\n", r"variant real: .*card.Epa.*card.E_pa"),
        ("approach:\n  finger", "approach:\n  thumb", r"approach names 'thumb'"),
    ],
)
def test_mistakes_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TASK
    with pytest.raises(ConfigError, match=message):
        small_task(tmp_path, text=TASK.replace(old, new))


def test_folds_need_something_that_yields(tmp_path: Path) -> None:
    made = small_task(tmp_path)
    rig = tmp_path / "rig.yaml"
    text = (tmp_path / "small.yaml").read_text()
    (tmp_path / "stiff.yaml").write_text(rig.read_text().partition("effects:")[0])
    path = tmp_path / "other.yaml"
    path.write_text(text.replace(str(rig), str(tmp_path / "stiff.yaml")))
    assert made.task.folds
    with pytest.raises(ConfigError, match=r"nothing of the rig 'small_strip' yields.*bending_plasticity"):
        load_task(str(path))


def test_a_variant_that_there_is_not_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"'lifting' has no variant 'papr'.*'paper'"):
        load_task("lifting:papr")
