"""What a diagnosis knows before it is finished: the fitted baseline, and the probabilities of the sets of effects that
were looked at or fitted until then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sysid.comparison.posterior import compared, judged
from sysid.diagnosis.baseline import Baseline
from sysid.diagnosis.fitted_sets import FittedSet
from sysid.diagnosis.report_notes import candidates_of, named_parameters, notes
from sysid.diagnosis.residual_analysis import locate
from sysid.diagnosis.result import UNFINISHED, Diagnosis
from sysid.diagnosis.search import ledger_with
from sysid.diagnosis.validation import misfit_of, worst_quantity
from sysid.diagnosis.verdict import Verdict, in_percent, verdict_of
from sysid.fit.marker_field import marker_fields
from sysid.fit.result import plot_series

GOES_ON = "The same command goes on from here if this one was interrupted."


def unfinished(base: Baseline, fitted: Sequence[FittedSet], provenance: Mapping[str, Any]) -> Diagnosis:
    """What is known with a fitted baseline and the sets that were ``fitted``, of which the baseline is the first; none:
    no effect has been looked at. The verdict is none of :data:`sysid.diagnosis.result.VERDICTS`."""
    before = misfit_of(base, base.fitted, base.there)
    ledger = ledger_with(list(fitted)) if fitted else None
    found = None if ledger is None else judged(compared(ledger))
    verdict = None if found is None else verdict_of(found)
    effects = candidates_of(base, fitted, found, verdict) if found is not None and verdict is not None else ((), ())
    series = plot_series(base.problem, base.fitted, base.fitted, held_out=False)
    fields = marker_fields(base.problem, base.fitted, base.fitted, held_out=False)
    if base.there is not None:
        series += plot_series(base.check, base.there, base.there, held_out=True)
        fields += marker_fields(base.check, base.there, base.there, held_out=True)
    return Diagnosis(
        verdict=UNFINISHED,
        sentence=_sentence(verdict, len(fitted) - 1),
        rig=base.fitted.rig.name,
        effects=(),
        alternatives=(*effects[0], *effects[1]),
        located=locate(base.problem, base.fitted, None),
        baseline=before,
        amended=None,
        noise_floor={c: float(np.median(n.sigma)) for c, n in base.noise.items()},
        upper_limits={},
        baseline_parameters=named_parameters(base.fitted),
        amended_parameters=(),
        not_explained=worst_quantity(before),
        next_experiment=GOES_ON,
        provenance=dict(provenance),
        seconds=0.0,
        notes=notes(base, []),
        series=series,
        marker_fields=fields,
        ledger=ledger,
        posterior=verdict,
    )


def _sentence(verdict: Verdict | None, sets: int) -> str:
    if verdict is None:
        return "This diagnosis is not finished: the rig is fitted, and no effect has been looked at yet."
    done = "no set of effects has been fitted" if not sets else f"{sets} {'set' if sets == 1 else 'sets'} of effects "
    done += "" if not sets else ("has been fitted" if sets == 1 else "have been fitted")
    best = [f"{s.words or 'nothing is missing'} ({in_percent(s.probability)})" for s in verdict.sets[:3]]
    return f"This diagnosis is not finished: {done}. Most probable until now: {'; '.join(best)}."
