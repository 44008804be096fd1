"""What rigs of real recordings need: markers put on anew, a crop that differs, gauges along one axis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.rigs import load_rig, parse_rig, rig_to_yaml, track_ids
from sim_core.rigs.yamlfile import parse_mapping


def raw(name: str) -> dict[str, Any]:
    return parse_mapping(rig_to_yaml(load_rig(name)), name)


def video(data: dict[str, Any]) -> dict[str, Any]:
    return data["cameras"]["video"]


FAULTS: dict[str, tuple[str, Callable[[dict[str, Any]], object], str]] = {
    "origin is a pin": (
        "knit_acrylic_garter_x",
        lambda d: video(d).update(origin_id=2),
        r"origin_id is 2, which is also a point of a body",
    ),
    "origin among points without numbers": (
        "knit_acrylic_garter_x",
        lambda d: video(d)["sees"][0].update(points={"grid": [2, 2]}),
        r"origin_id is 6, but the points of the bodies have no ids",
    ),
    "origin of a lens": (
        "card_press",
        lambda d: d["cameras"]["outside"].update(origin_id=6),
        r"origin_id is not a key",
    ),
    "places from recordings without numbers": (
        "knit_acrylic_garter_x",
        lambda d: video(d)["sees"][0]["points"].pop("ids"),
        r"does not say which markers.*Give ids",
    ),
    "places from recordings for a 3-D sensor": (
        "card_press",
        lambda d: d["sensors"]["gel_markers"].update(
            points={"positions_m": [[0.0, 0.0, 0.0]], "ids": [1], "placed": "first_frame"}
        ),
        r"for points of a sheet that a camera sees",
    ),
    "a sensor of nothing": (
        "knit_acrylic_garter_x",
        lambda d: d["sensors"]["gauge"].update(measures=[]),
        r"measures",
    ),
    "a component that is none": (
        "knit_acrylic_garter_x",
        lambda d: d["sensors"]["gauge"].update(measures=["fy"]),
        r"measures",
    ),
    "a gap of no length": (
        "knit_acrylic_garter_x",
        lambda d: d["end_effectors"]["puller"]["topics"].update(max_gap_s=0.0),
        r"max_gap_s",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_named(fault: str) -> None:
    name, edit, message = FAULTS[fault]
    data = raw(name)
    edit(data)
    with pytest.raises(ConfigError, match=message):
        parse_rig(data, "test")


def test_the_origin_is_the_last_track() -> None:
    rig = load_rig("knit_acrylic_garter_x")
    np.testing.assert_array_equal(track_ids(rig.cameras["video"], dict(rig.bodies)), [0, 1, 2, 3, 4, 6])  # type: ignore[arg-type]
