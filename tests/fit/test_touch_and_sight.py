"""A small bending stiffness cannot be determined by touch, whatever is known of the gel; weight, seen from outside,
tells it.

ThinShellLab (Wang et al., ICLR 2024) identified sheets by touch and could not retrieve small bending stiffnesses, for
which it blamed the gel's Poisson ratio. A sheet of bending stiffness D and width w that is pressed by d at a distance L
from where it is held responds with about 3 D w d / L^3. The tissue of the rig (D = 2.7e-5 N m) gives 2e-4 N, a tenth of
the noise of the wrench; its weight, 0.2 N/m^2, bends it by centimetres.
"""

from pathlib import Path

import numpy as np
import pytest

from sim_core.rigs import Rig, load_rig, parse_rig, with_parameters
from sim_core.rigs.motion import Experiment
from sysid.cli.app import main
from sysid.design.experiment_design import Expected, plan_experiments
from sysid.fit import FitOptions, fit_runs
from sysid.model.load import load_run
from sysid.model.nuisance_parameters import KINDS
from sysid.observations.rig_topics import without
from sysid.simulate import simulate_to_bag

GEL = ["gel.E_pa", "gel.nu", "contacts.gel-card.friction"]
TRUTH = 2.0e8


PRESS = Experiment.model_validate(
    {
        "name": "press",
        "motions": {
            "finger": [
                {"type": "wait", "duration_s": 0.1},
                {"type": "press", "depth_m": 0.05, "speed_m_s": 0.25, "hold_s": 0.4},
            ]
        },
    }
)
"""As press_far, quicker."""


def tissue() -> Rig:
    """The rig with fewer cells and longer steps."""
    data = load_rig("tissue_press").model_dump(exclude_none=True)
    data["bodies"]["card"]["shape"]["cells"] = (10, 1)
    data["bodies"]["gel"]["shape"]["cells"] = (1, 1, 1)
    data["solver"]["dt_s"] = 0.04
    return parse_rig(data, "test")


def plan(rig: Rig, names: list[str], kinds: tuple[str, ...]) -> dict[str, Expected]:
    outlook = plan_experiments(rig, [PRESS], names, nuisance=kinds).outlooks[0]
    return {p.name: p for p in outlook.parameters}


@pytest.mark.slow
def test_a_plan_says_that_touch_does_not_determine_bending_and_sight_does() -> None:
    rig = tissue()
    touch = plan(without(rig, ["outside"]), ["card.E_pa"], ("none",))["card.E_pa"]
    assert touch.ci95[1] > 2.0 * touch.value, "although all of the gel is known, and clocks and zeros"
    both = plan(rig, ["card.E_pa", *GEL], KINDS)
    assert not both["gel.nu"].determined
    assert both["card.E_pa"].sd < 0.02, "although nothing of the gel is known"
    assert max(both["card.E_pa"].from_channels, key=both["card.E_pa"].from_channels.__getitem__) == "outside"


@pytest.mark.slow
def test_a_fit_by_sight_finds_what_a_fit_by_touch_does_not(tmp_path: Path) -> None:
    rig = tissue()
    simulate_to_bag(with_parameters(rig, {"card.E_pa": TRUTH}), PRESS, tmp_path / "bag", seed=2)
    blind = without(rig, ["outside"])
    felt, _ = fit_runs(blind, [load_run(blind, tmp_path / "bag")], ["card.E_pa"], FitOptions(nuisance=("none",)))
    seen, _ = fit_runs(rig, [load_run(rig, tmp_path / "bag")], ["card.E_pa"])
    (touch,), (sight,) = felt.estimates, seen.estimates
    assert touch.ci95[1] > 3.0 * touch.ci95[0]
    assert sight.ci95[0] < TRUTH < sight.ci95[1]
    assert sight.sd < 0.02
    assert np.log(sight.ci95[1] / sight.ci95[0]) < 0.05 * np.log(touch.ci95[1] / touch.ci95[0])


def test_what_is_left_out_is_checked(capsys: pytest.CaptureFixture[str]) -> None:
    rig = load_rig("tissue_press")
    assert list(without(rig, ["outside", "gel_markers"]).sensors) == ["wrench_gel"]
    for words, message in (
        (["outsid"], "Did you mean"),
        ([*rig.sensors, *rig.cameras], "is left. Leave out less"),
    ):
        options = [part for word in words for part in ("--without", word)]
        assert main(["plan", "tissue_press", "press_far", "--params", "card.E", *options]) == 2
        assert message in capsys.readouterr().err
