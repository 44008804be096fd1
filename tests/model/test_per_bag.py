"""Parameters that each recording has a value of its own of, in addition to those that all share."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from strip import START, TRUTH, pulled, strip_rig

from sim_core.errors import ConfigError
from sim_core.rigs import with_parameters
from sysid.fit import FitOptions, fit_runs
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import acting_in, fit_parameters, rig_at, rig_in, start_of, with_bags
from sysid.workflow import fit_bags

RIG = strip_rig()
NAMES = list(TRUTH)
STIFF = {**TRUTH, "strip.E_pa": 5.4e9}
BAGS = ("soft", "stiff")


def test_a_parameter_is_there_once_for_each_bag() -> None:
    parameters = with_bags(fit_parameters(RIG, NAMES), ["strip.E"], BAGS, RIG)
    assert [p.name for p in parameters] == ["strip.E_pa[soft]", "strip.E_pa[stiff]", "strip.nu"]
    assert [p.target for p in parameters] == ["strip.E_pa", "strip.E_pa", "strip.nu"]
    assert acting_in(parameters, "stiff") == [1, 2]
    scaled = start_of(RIG, parameters) + [0.0, np.log(1.44), 0.01]
    e, nu = RIG.bodies["strip"].material.E_pa, RIG.bodies["strip"].material.nu
    for rig, factor in (
        (rig_in(RIG, parameters, scaled, "soft"), 1.0),
        (rig_in(RIG, parameters, scaled, "stiff"), 1.44),
        (rig_at(RIG, parameters, scaled), 1.2),
    ):
        assert rig.bodies["strip"].material.E_pa == pytest.approx(factor * e)
        assert rig.bodies["strip"].material.nu == pytest.approx(nu + 0.01)


def test_what_cannot_be_per_bag_is_named() -> None:
    parameters = fit_parameters(RIG, NAMES)
    with pytest.raises(ConfigError, match=r"strip.thickness_m is to have a value for each bag, but is not fitted"):
        with_bags(parameters, ["strip.thickness"], BAGS, RIG)
    with pytest.raises(ConfigError, match="there is only one"):
        with_bags(parameters, ["strip.E"], BAGS[:1], RIG)
    with pytest.raises(ConfigError, match="no parameter"):
        with_bags(parameters, ["strip.Y"], BAGS, RIG)


def test_two_strips_of_one_film_that_aged(workers: ParallelPredictor, tmp_path: Path) -> None:
    """Each has its modulus, both have one Poisson's ratio, which is then known better than from one."""
    runs = [
        replace(pulled(RIG, values, tmp_path / name, seed=k), name=name)
        for k, (name, values) in enumerate(zip(BAGS, (TRUTH, STIFF), strict=True))
    ]
    start = with_parameters(RIG, START)
    result, rig = fit_runs(
        start, runs, NAMES, FitOptions(per_bag=["strip.E"], nuisance=("none",), intervals="quadratic"), engine=workers
    )
    soft, stiff, nu = result.estimates
    assert (soft.name, soft.bag, nu.bag) == ("strip.E_pa[soft]", "soft", "")
    for e, true in ((soft, TRUTH["strip.E_pa"]), (stiff, STIFF["strip.E_pa"]), (nu, TRUTH["strip.nu"])):
        assert e.ci95[0] <= true <= e.ci95[1], e
    assert soft.ci95[1] < stiff.ci95[0] and result.reduced_chi2 < 1.1
    assert rig.bodies["strip"].material.E_pa == pytest.approx(np.sqrt(soft.value * stiff.value))
    alone, _ = fit_runs(start, runs[:1], NAMES, FitOptions(nuisance=("none",), intervals="quadratic"), engine=workers)
    assert nu.sd < alone.estimates[1].sd
    assert soft.sd == pytest.approx(alone.estimates[0].sd, rel=0.3)


def test_the_result_of_a_fit_of_bags_has_a_value_for_each(tmp_path: Path) -> None:
    bags = [tmp_path / name for name in BAGS]
    for k, (bag, values) in enumerate(zip(bags, (TRUTH, STIFF), strict=True)):
        pulled(RIG, values, bag, seed=k)
    warnings: list[str] = []
    table = fit_bags(
        RIG,
        bags,
        NAMES,
        FitOptions(per_bag=["strip.E"], nuisance=("none",), intervals="quadratic", bounds={"strip.E": (1e8, 1e20)}),
        out=tmp_path / "out",
        on_warning=warnings.append,
    ).table()
    result = json.loads((tmp_path / "out" / "fit.json").read_text())
    (cut,) = warnings
    assert "strip.E_pa, 1e+20, is beyond its own limit, 1e+13" in cut and cut in result["notes"]
    values = {e["name"]: e["value"] for e in result["estimates"]}
    assert list(values) == ["strip.E_pa[soft]", "strip.E_pa[stiff]", "strip.nu"]
    assert values["strip.E_pa[stiff]"] > 1.1 * values["strip.E_pa[soft]"]
    assert all(name in table for name in values)
