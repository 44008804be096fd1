"""The table: what a row says, what is printed, and that every row holds."""

import json
import time

import numpy as np
import pytest

from sysid import validation
from sysid.cli import app
from sysid.validation import GROUPS, Case, NotCovered, run_validation
from sysid.validation.case import compare


def test_a_case_passes_within_its_tolerance_only():
    case = Case("c", "q", "1", 2.0, 2.03, 0.02, "m", "s")
    assert case.error == pytest.approx(0.015)
    assert case.passed
    assert not Case("c", "q", "1", 2.0, 2.1, 0.02, "m", "s").passed
    assert not Case("c", "q", "1", 2.0, float("nan"), 0.02, "m", "s").passed


def test_an_answer_of_zero_has_a_scale():
    case = Case("c", "q", "1", 0.0, -0.03, 0.02, "m", "s", scale=2.0, coarser=(0.12,))
    assert case.error == pytest.approx(0.015)
    assert case.order == pytest.approx(2.0)


def test_the_observed_order_is_that_of_halved_cells():
    assert Case("c", "q", "1", 2.0, 2.02, 0.02, "m", "s", coarser=(2.08,)).order == pytest.approx(2.0)
    assert Case("c", "q", "1", 2.0, 2.02, 0.02, "m", "s", coarser=(2.2, 2.0), ratio=3.0).order == pytest.approx(
        0.5 * np.log(10.0) / np.log(3.0)
    )
    assert Case("c", "q", "1", 2.0, 2.02, 0.02, "m", "s").order is None


def test_a_case_that_does_not_converge_is_missed():
    assert not Case("c", "q", "1", 2.0, 2.02, 0.02, "m", "s", coarser=(2.03,)).passed


def test_quantities_of_one_run_converge_together():
    """The second is right on the coarse mesh by accident."""
    cases = list(compare("c", ("a", "b"), (1.0, 2.0), [(1.04, 2.0), (1.01, 2.004)], 0.02, "m", "s"))
    assert [case.found for case in cases] == [1.01, 2.004]
    expected = np.log2(0.04 / np.hypot(0.01, 0.002))
    assert [case.order for case in cases] == pytest.approx([expected, expected])


def two_rows():
    yield Case("droop", "drop", "1", np.float64(2.0), np.float64(2.1), 0.01, "10 x 1", "a book", remark="on purpose")
    yield NotCovered("creep", "the law has none", "another book")


def test_a_missed_row_fails_the_table_and_gaps_are_named(monkeypatch):
    monkeypatch.setattr(validation, "GROUPS", {"two": (two_rows, 1.0)})
    shares = []
    passed, text = run_validation(on_progress=lambda share, _: shares.append(share))
    assert not passed
    assert shares == [0.0, 1.0]
    assert "MISSED" in text and "0 of 1 within" in text
    assert "droop: on purpose" in text and "creep: the law has none [another book]" in text
    passed, text = run_validation(as_json=True)
    found = json.loads(text)
    assert not found["passed"] and found["cases"][0]["error"] == pytest.approx(0.05)
    assert found["not_covered"][0]["name"] == "creep"


def test_groups_may_be_chosen_and_each_row_has_its_processor_time(monkeypatch, capsys):
    def slower():
        end = time.process_time() + 0.05
        while time.process_time() < end:
            pass
        yield from two_rows()

    monkeypatch.setattr(validation, "GROUPS", {"two": (two_rows, 1.0), "slower": (slower, 1.0)})
    assert app.main(["validate", "slower", "--json"]) == 1
    (row,) = json.loads(capsys.readouterr().out)["cases"]
    assert 0.05 <= row["cpu_s"] < 0.1
    assert app.main(["validate", "slowest"]) == 2
    assert "'slower'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
def test_every_row_of_the_table_holds(group):
    cases, _ = GROUPS[group]
    missed = [row for row in cases() if isinstance(row, Case) and not row.passed]
    assert not missed


def test_the_command_ends_with_1_when_a_row_is_missed_and_prints_json(monkeypatch, capsys):
    monkeypatch.setattr(validation, "GROUPS", {"two": (two_rows, 1.0)})
    assert app.main(["validate", "--json"]) == 1
    shown = capsys.readouterr()
    assert not json.loads(shown.out)["passed"]
    assert "100 %" in shown.err
