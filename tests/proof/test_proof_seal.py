"""Sealing the truth, scoring the answers, rates and their intervals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sim_core.errors import ConfigError
from sysid.proof import score_cases
from sysid.proof.run import ANSWERS_FILE
from sysid.proof.score import outcome, wilson, within
from sysid.proof.seal import digest_of, file_digest, open_seal, write_seal

SHARE = {"name": "share", "value": 0.2, "ci95": [0.1, 0.3], "unit": "-", "words": ""}


def truth_of(*effects: str | None) -> dict:
    return {
        "seed": 3,
        "cases": [
            {
                "case": f"case_{k + 1:02d}",
                "effect": effect,
                "parameters": {"share": 0.25} if effect else {},
                "signal": 40.0 if effect else 0.0,
                "materials": {"gel.E_pa": 1e5},
            }
            for k, effect in enumerate(effects)
        ],
    }


def diagnosis(verdict: str, names: list[str]) -> dict:
    return {
        "verdict": verdict,
        "effects": [{"name": n, "parameters": [SHARE]} for n in names],
        "fit": {"baseline": {"held_out": 9.0}, "amended": {"held_out": 1.1} if names else None},
        "baseline_parameters": [{"name": "gel.E_pa", "ci95": [0.9e5, 1.1e5]}],
        "amended_parameters": [],
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_seal(tmp_path, truth_of(None, "gel_relaxation", "air_drag", "air_drag"), salt="00ff")
    said = {
        "case_01": diagnosis("nothing_missing", []),
        "case_02": diagnosis("named", ["gel_relaxation"]),
        "case_03": diagnosis("one_of", ["air_drag", "bending_plasticity"]),
    }
    entries: dict = {"case_04": {"seconds": 2.0, "error": "it failed"}}
    for name, data in said.items():
        path = tmp_path / "answers" / name / "diagnosis.json"
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps(data))
        names = [e["name"] for e in data["effects"]]
        entries[name] = {
            "seconds": 60.0, "error": "", "sha256": file_digest(path), "verdict": data["verdict"], "effects": names,
        }  # fmt: skip
    answers = tmp_path / ANSWERS_FILE
    answers.write_text(json.dumps({"seal": "", "cases": entries}))
    (tmp_path / f"{ANSWERS_FILE}.sha256").write_text(file_digest(answers) + "\n")
    return tmp_path


def test_seal_opens_to_the_same_truth(folder: Path) -> None:
    assert open_seal(folder) == truth_of(None, "gel_relaxation", "air_drag", "air_drag")


def test_changed_truth_is_detected(folder: Path) -> None:
    path = folder / "sealed" / "truth.json"
    path.write_text(path.read_text().replace("gel_relaxation", "static_friction"))
    with pytest.raises(ConfigError, match="not what was sealed"):
        score_cases(folder)


def test_changed_number_and_salt_change_the_digest() -> None:
    truth = truth_of("air_drag")
    other = truth_of("air_drag")
    other["cases"][0]["parameters"]["share"] = 0.25000001
    assert digest_of(truth, "a") == digest_of(truth_of("air_drag"), "a")
    assert len({digest_of(truth, "a"), digest_of(other, "a"), digest_of(truth, "b")}) == 3


@pytest.mark.parametrize("name", ["answers.json", "answers/case_02/diagnosis.json"])
def test_changed_answer_is_detected(folder: Path, name: str) -> None:
    path = folder / name
    path.write_text(path.read_text().replace("named", "unknown"))
    with pytest.raises(ConfigError, match="has changed"):
        score_cases(folder)


def test_score_counts(folder: Path) -> None:
    text = score_cases(folder)
    score = json.loads((folder / "score.json").read_text())
    assert [c["outcome"] for c in score["cases"]] == ["clear", "named", "right set", "error"]
    summary = score["summary"]
    assert summary["false_alarm"]["count"] == 0 and summary["false_alarm"]["of"] == 1
    assert (summary["named"]["count"], summary["named_or_right_set"]["count"]) == (1, 2)
    assert summary["held_out_lower"] == {"count": 2, "of": 2, "ci95": [0.3424, 1.0]}
    assert summary["parameters_recovered"]["count"] == 2
    assert summary["errors"] == 1
    assert "right set" in text and "False alarms: 0 of 1" in text


@pytest.mark.parametrize(
    ("effect", "verdict", "answer", "expected"),
    [
        (None, "nothing_missing", [], "clear"),
        (None, "named", ["air_drag"], "false alarm"),
        (None, "unknown", [], "false alarm"),
        ("air_drag", "nothing_missing", [], "missed"),
        ("air_drag", "unknown", [], "unknown"),
        ("air_drag", "named", ["air_drag"], "named"),
        ("air_drag", "named", ["air_drag", "stream_delay"], "wrong"),
        ("air_drag", "named", ["stream_delay"], "wrong"),
        ("air_drag", "one_of", ["stream_delay", "air_drag"], "right set"),
        ("air_drag", "one_of", ["stream_delay", "wrench_offset"], "wrong"),
    ],
)
def test_outcomes(effect: str | None, verdict: str, answer: list[str], expected: str) -> None:
    assert outcome(effect, verdict, answer) == expected


def test_within_matches_full_names_and_misses() -> None:
    said = [
        {"name": "effects.gel_relaxation.share", "ci95": [0.1, 0.3]},
        {"name": "effects.gel_relaxation.tau_s", "ci95": [1.0, 2.0]},
    ]
    assert within({"share": 0.2, "tau_s": 0.5, "other": 1.0}, said) == (1, 2)


def test_wilson_against_published_values() -> None:
    """Newcombe, Statist. Med. 17 (1998) 857, table I, method 3."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(15, 148) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert wilson(1, 29) == pytest.approx((0.0061, 0.1718), abs=5e-5)
    assert wilson(0, 0) == (0.0, 1.0)
