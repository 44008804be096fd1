"""How recordings that no fit has seen are predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.fit.marker_field import MarkerField, marker_fields
from sysid.fit.result import ChannelError, Series, out_of_sight, plot_series, rms_errors
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.model.windows import not_from_rest
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Run
from sysid.solve.interruption import reason_of
from sysid.solve.residuals import Problem


@dataclass(frozen=True)
class Score:
    """How a held-out recording is predicted by the fit; ``prediction``: None where it could not be simulated."""

    run: Run
    prediction: Prediction | None
    errors: list[ChannelError]
    notes: list[str]
    series: list[Series]
    marker_fields: list[MarkerField] = field(default_factory=list)


def scored(
    engine: AnyEngine,
    before: Rig,
    after: Rig,
    run: Run,
    noise: dict[str, ChannelNoise],
    bias: bool,
    own: Mapping[tuple[str, str], float],
) -> Score:
    """Scores of ``run`` by the rig ``before`` and ``after`` a fit. ``bias``: either has the best bias of each wrench;
    ``own``: error of mesh and time step by channel and quantity
    (:func:`sysid.discretisation.refinement.error_sizes`)."""
    check = Problem([run], noise, engine, bias=bias)
    try:
        there = check.evaluate(before, [], np.zeros(0))
        then = check.evaluate(after, [], np.zeros(0))
    except ThinshellError as error:
        return Score(run, None, [], [f"{run.name}: could not be simulated: {error}"], [])
    return Score(
        run, then.predictions[0], rms_errors(check, there, then, held_out=True, own=own),
        out_of_sight(check, there, then), plot_series(check, there, then, held_out=True, raw=[run]),
        marker_fields(check, there, then, held_out=True),
    )  # fmt: skip


def all_scored(
    engine: AnyEngine,
    fitted: Rig,
    before: Rig,
    after: Rig,
    runs: Sequence[Run],
    noise: dict[str, ChannelNoise],
    bias: bool,
    own: Mapping[tuple[str, str], float],
) -> tuple[list[Score], list[str]]:
    """Scores of ``runs`` (:func:`scored`), and notes on them: on windows that do not begin at rest by the rig
    ``fitted``, and on what was not predicted, since Ctrl-C was pressed or something failed."""
    scores: list[Score] = []
    notes: list[str] = []
    missed: dict[str, list[str]] = {}
    for k, run in enumerate(runs):
        try:
            notes += [f"{run.name}: {note}" for note in not_from_rest(fitted, run)]
            scores.append(scored(engine, before, after, run, noise, bias, own))
        except KeyboardInterrupt as error:
            missed[reason_of(error)] = [other.name for other in runs[k:]]
            break
        except Exception as error:  # the fit that is finished is worth more
            missed.setdefault(reason_of(error), []).append(run.name)
    notes += [note for score in scores for note in score.notes]
    notes += [f"Held-out recordings {', '.join(names)} were not predicted: {text}" for text, names in missed.items()]
    return scores, notes
