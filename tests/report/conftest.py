"""Pages that several files of tests read."""

from __future__ import annotations

from pathlib import Path

import pytest
from report_examples import make_diagnosis

from sysid.diagnosis.result import VERDICTS
from sysid.report import write_diagnosis_report


@pytest.fixture(scope="session")
def diagnosis_pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The page of a diagnosis of each verdict."""
    folder = tmp_path_factory.mktemp("verdicts")
    return {
        verdict: write_diagnosis_report(make_diagnosis(verdict), folder / f"{verdict}.html") for verdict in VERDICTS
    }
