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


def read_answers(path: Path) -> tuple[Answer, Answer | None]:
    """The answer in a ``diagnosis.json``, and that of the posterior of its ledger, None without one."""
    data = json.loads(path.read_text())
    return _of_verdict(data), _of_one_model(data["one_model"]) if data.get("one_model") else None


def _of_one_model(found: dict[str, Any]) -> Answer:
    """What the posterior says; it refits nothing."""
    sets = found["sets"] if found["kind"] == "one_of" else found["sets"][:1]
    named = dict.fromkeys(c for s in sets for c in s["causes"] if not c.startswith("unknown: "))
    return Answer(
        found["kind"], tuple(named), tuple(found["effects"].items()), tuple(found["places"]), {}, [], None, None
    )  # fmt: skip


def _of_verdict(data: dict[str, Any]) -> Answer:
    effects = data["effects"]
    ranked: dict[str, float] = {}
    for candidate in (*effects, *data.get("alternatives", [])):
        name = candidate["name"]
        ranked[name] = max(ranked.get(name, 0.0), float(candidate["probability"]))
    fit = data["fit"]
    amended = fit["amended"]
    parameters: dict[str, list[dict[str, Any]]] = {}
    for effect in effects:
        parameters.setdefault(effect["name"], []).extend(effect["parameters"])
    return Answer(
        data["verdict"],
        tuple(dict.fromkeys(effect["name"] for effect in effects)),
        tuple(sorted(ranked.items(), key=lambda item: -item[1])),
        tuple(dict.fromkeys(place["place"] for place in data.get("places", []))),
        parameters,
        data["amended_parameters"] or data["baseline_parameters"],
        fit["baseline"]["held_out"],
        amended["held_out"] if amended else None,
    )
