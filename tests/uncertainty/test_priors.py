"""What is known of parameters beforehand, and bounds of them: from the command line to the interval."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from strip import START, TRUTH, pulled, strip_rig

from sim_core.errors import ConfigError
from sim_core.rigs import with_parameters
from sysid.cli.options import parse_pairs
from sysid.fit import FitOptions, fit_runs
from sysid.model.parameters import fit_parameters, known_before


@pytest.mark.slow
def test_a_known_thickness_determines_the_modulus_as_well_as_it_is_known(tmp_path: Path) -> None:
    """A pull tells E h alone: what h is thought to be, E makes up for, and what h is unsure of, E is too."""
    rig = strip_rig()
    thickness = rig.bodies["strip"].material.thickness_m  # type: ignore[union-attr]
    run = pulled(rig, TRUTH, tmp_path / "bag")
    options = FitOptions(
        nuisance=("bias",), priors={"strip.thickness": (1.02 * thickness, 0.03 * thickness)}, intervals="quadratic"
    )
    names = ["strip.E_pa", "strip.nu", "strip.thickness_m"]
    result, _ = fit_runs(with_parameters(rig, START), [run], names, options)
    modulus, _, found = result.estimates
    assert found.value == pytest.approx(1.02 * thickness, rel=2e-3)
    assert found.sd == pytest.approx(0.03 / 1.02, rel=0.02)
    fixed = with_parameters(rig, {**START, "strip.thickness_m": 1.02 * thickness})
    alone, _ = fit_runs(fixed, [run], names[:2], FitOptions(nuisance=("bias",), intervals="quadratic"))
    assert modulus.value == pytest.approx(alone.estimates[0].value, rel=2e-3)
    assert modulus.value == pytest.approx(TRUTH["strip.E_pa"] / 1.02, rel=3.0 * alone.estimates[0].sd)
    assert modulus.sd == pytest.approx(np.hypot(0.03 / 1.02, alone.estimates[0].sd), rel=0.05)
    assert any("strip.thickness_m before" in note for note in result.notes)

    wide = FitOptions(nuisance=("bias",), bounds={"strip.E": (4.8e9, 6e9)}, intervals="quadratic")
    at_bound, _ = fit_runs(with_parameters(rig, {"strip.E_pa": 5e9}), [run], ["strip.E_pa"], wide)
    assert at_bound.estimates[0].value == pytest.approx(4.8e9, rel=1e-3)
    assert at_bound.estimates[0].at_bound


@pytest.mark.slow
def test_what_was_known_wrongly_is_reported_and_not_taken_for_what_the_data_do_not_determine(tmp_path: Path) -> None:
    """A pull tells E to a few percent. With a prior at twice of that, known to 0.5 %, the fit stays there."""
    run = pulled(strip_rig(), TRUTH, tmp_path / "bag")
    for share, reported in ((2.0, True), (1.0, False)):
        known = share * TRUTH["strip.E_pa"]
        options = FitOptions(nuisance=("bias",), priors={"strip.E": (known, 5e-3 * known)}, intervals="quadratic")
        result, _ = fit_runs(with_parameters(strip_rig(), START), [run], ["strip.E_pa", "strip.nu"], options)
        assert ("they ask for a smaller value" in "".join(result.contradicted)) == reported
        assert result.contradicted == [s for s in result.contradicted if s in result.table()]
        if reported:
            assert "strip.E_pa" not in result.undetermined


def test_pairs_of_numbers_are_read() -> None:
    assert parse_pairs(["card.E=2e9+-1e8", "nu = 0.3+-0.02"], "--prior", "+-") == {
        "card.E": (2e9, 1e8),
        "nu": (0.3, 0.02),
    }
    assert parse_pairs(["card.E=1e-3..5e9"], "--bounds", "..") == {"card.E": (1e-3, 5e9)}
    for word, said in (
        ("card.E", "not of the form"),
        ("card.E=2e9", "not of the form"),
        ("card.E=a+-b", "two numbers"),
    ):
        with pytest.raises(ConfigError, match=said):
            parse_pairs([word], "--prior", "+-")
    with pytest.raises(ConfigError, match="twice"):
        parse_pairs(["a=1+-1", "a=2+-1"], "--prior", "+-")


def test_what_is_known_is_checked() -> None:
    rig = strip_rig()
    parameters = fit_parameters(rig, ["strip.E"])
    with pytest.raises(ConfigError, match="which is not fitted"):
        known_before(parameters, rig, {"strip.nu": (0.3, 0.1)})
    with pytest.raises(ConfigError, match="Two different things"):
        known_before(parameters, rig, {"strip.E": (2e9, 1e8), "strip.E_pa": (3e9, 1e8)})
    with pytest.raises(ConfigError, match="no value with a standard deviation"):
        FitOptions(priors={"strip.E": (2e9, 0.0)})
    with pytest.raises(ConfigError):
        known_before(parameters, rig, {"strip.E": (-1.0, 1.0)})
