"""What a diagnosis says, as the score reads it from ``diagnosis.json``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Answer:
    """``named``: effects of the answer; ``ranked``: all explanations with their probability, the likeliest first;
    ``places``: slots that are said to be unreliable, the most unreliable first; ``parameters``: of the effects named,
    ``materials``: of the rig, each with name and ``ci95``; ``before``, ``after``: mean squared whitened residual on
    held-out data with the baseline and with the answer."""

    verdict: str
    named: tuple[str, ...]
    ranked: tuple[tuple[str, float], ...]
    places: tuple[str, ...]
    parameters: dict[str, list[dict[str, Any]]]
    materials: list[dict[str, Any]]
    before: float | None
    after: float | None


def read_answer(path: Path) -> Answer:
    """The answer in a ``diagnosis.json``."""
    data = json.loads(path.read_text())
    effects, found, fit = data["effects"], data["posterior"], data["fit"]
    amended = fit["amended"]
    parameters: dict[str, list[dict[str, Any]]] = {}
    for effect in effects:
        parameters.setdefault(effect["name"], []).extend(effect["parameters"])
    return Answer(
        data["verdict"],
        tuple(dict.fromkeys(effect["name"] for effect in effects)),
        tuple(found["effects"].items()),
        tuple(found["places"]),
        parameters,
        data["amended_parameters"] or data["baseline_parameters"],
        fit["baseline"]["held_out"],
        amended["held_out"] if amended else None,
    )
