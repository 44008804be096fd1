"""Sealing the truth, scoring the diagnoses, rates and their intervals."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from sim_core.errors import ConfigError
from sysid.proof import keep_shard, score_cases
from sysid.proof.answer import read_answer
from sysid.proof.outcome import outcome, sure_and_wrong
from sysid.proof.run import ANSWERS_FILE
from sysid.proof.score import wilson, within
from sysid.proof.seal import digest_of, file_digest, open_seal, write_seal

SHARE = {"name": "share", "value": 0.2, "ci95": [0.1, 0.3], "unit": "-", "words": ""}


def sealed(name: str, slot: str = "air", *, in_library: bool = True) -> dict:
    return {"name": name, "slot": slot, "in_library": in_library, "parameters": {"share": 0.25}, "signal": 40.0}


def truth_of(*effects: str | None) -> dict:
    return {
        "seed": 3,
        "cases": [
            {
                "case": f"case_{k + 1:02d}",
                "rig": "gel" if k == 1 else "bench",
                "truth": "layer" if k == 1 else "simulator",
                "effects": [sealed(effect)] if effect else [],
                "materials": {"gel.E_pa": 1e5},
            }
            for k, effect in enumerate(effects)
        ],
    }


def diagnosis(verdict: str, names: list[str]) -> dict:
    return {
        "verdict": verdict,
        "effects": [{"name": n, "parameters": [SHARE]} for n in names],
        "posterior": {
            "effects": {"stream_delay": 0.02, **{n: 0.95 - 0.1 * k for k, n in enumerate(names)}},
            "places": {"robot": 0.6, "sheet": 0.3},
        },
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
        entries[name] = {
            "seconds": 60.0, "error": "", "sha256": file_digest(path), "answer": asdict(read_answer(path)),
        }  # fmt: skip
    diagnoses = tmp_path / ANSWERS_FILE
    diagnoses.write_text(json.dumps({"seal": "", "cases": entries}))
    (tmp_path / f"{ANSWERS_FILE}.sha256").write_text(file_digest(diagnoses) + "\n")
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
    other["cases"][0]["effects"][0]["parameters"]["share"] = 0.25000001
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
    assert [c["kind"] for c in score["cases"]] == ["empty", "one", "one", "one"]
    summary = score["summary"]["all"]
    assert summary["false_alarm"]["count"] == 0 and summary["false_alarm"]["of"] == 1
    assert (summary["named"]["count"], summary["named_or_right_set"]["count"]) == (1, 2)
    assert (summary["first_three"]["count"], summary["first_three"]["of"]) == (2, 3)
    assert (summary["held_out_worse"]["count"], summary["held_out_worse"]["of"]) == (0, 2)
    assert summary["held_out_excess_halved"] == {"count": 2, "of": 2, "ci95": [0.3424, 1.0]}
    assert summary["parameters_recovered"]["count"] == 2
    assert summary["errors"] == 1
    apart = score["summary"]["independent"]
    assert (apart["named"]["count"], apart["named"]["of"], apart["false_alarm"]["of"]) == (1, 1, 0)
    assert "right set" in text and "False alarms in cases that conceal nothing: 0 of 1" in text
    assert "Truth by another formulation (1 cases)" in text


def test_unknown_physics_is_placed_where_something_is_missing_most_probably(tmp_path: Path) -> None:
    path = tmp_path / "diagnosis.json"
    found = diagnosis("unknown", [])
    found["posterior"] = {"effects": {}, "places": {"robot": 0.95, "sheet": 0.04}}
    path.write_text(json.dumps(found))
    answer = read_answer(path)
    assert (answer.verdict, answer.named) == ("unknown", ())
    assert outcome([sealed("backlash", "robot", in_library=False)], answer) == "right slot"
    assert outcome([sealed("jump", "sheet", in_library=False)], answer) == "other slot"


def test_a_kept_shard_scores_alike_and_stays_sealed(folder: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    with pytest.raises(ConfigError, match="Run and score"):
        keep_shard(folder, kept)
    text = score_cases(folder)
    keep_shard(folder, kept)
    assert not list(kept.rglob("diagnosis.json"))
    assert score_cases(kept).splitlines()[:-1] == text.splitlines()[:-1]
    diagnoses = kept / "answers.json"
    diagnoses.write_text(diagnoses.read_text().replace("one_of", "named"))
    with pytest.raises(ConfigError, match="has changed"):
        score_cases(kept)


DRAG, LATE = sealed("air_drag"), sealed("stream_delay", "clock")
PLAY = sealed("backlash", "robot", in_library=False)


@pytest.mark.parametrize(
    ("effects", "verdict", "names", "expected"),
    [
        ([], "nothing_missing", [], "clear"),
        ([], "named", ["air_drag"], "false alarm"),
        ([], "unknown", [], "false alarm"),
        ([], "refine_discretisation", [], "refine"),
        ([DRAG], "nothing_missing", [], "missed"),
        ([DRAG], "unknown", [], "unknown"),
        ([DRAG], "named", ["air_drag"], "named"),
        ([DRAG], "partly", ["air_drag"], "named"),
        ([DRAG], "named", ["air_drag", "stream_delay"], "wrong"),
        ([DRAG], "named", ["stream_delay"], "wrong"),
        ([DRAG], "one_of", ["stream_delay", "air_drag"], "right set"),
        ([DRAG], "one_of", ["stream_delay", "wrench_offset"], "wrong"),
        ([DRAG, LATE], "named", ["stream_delay", "air_drag"], "named"),
        ([DRAG, LATE], "named", ["stream_delay"], "one of two"),
        ([DRAG, LATE], "named", ["stream_delay", "wrench_offset"], "wrong"),
        ([PLAY], "unknown", [], "right slot"),
        ([sealed("jump", "sheet", in_library=False)], "unknown", [], "other slot"),
        ([PLAY], "named", ["air_drag"], "wrong"),
        ([PLAY], "one_of", ["air_drag", "stream_delay"], "wrong"),
    ],
)
def test_outcomes(tmp_path: Path, effects: list[dict], verdict: str, names: list[str], expected: str) -> None:
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps(diagnosis(verdict, names)))
    assert outcome(effects, read_answer(path)) == expected
    wrong = verdict in ("named", "partly") and bool(names) and names[0] not in [e["name"] for e in effects]
    assert sure_and_wrong(effects, read_answer(path)) == wrong


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
