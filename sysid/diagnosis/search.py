"""Which sets of effects are fitted: best first, until those that are hold nearly all of the probability.

The posterior is that of the rig and of all sets of effects (:mod:`sysid.comparison.posterior`), each in the ledger
where most of its effects are fitted. The most probable sets that are not fitted yet are fitted next. Where none leaves
noise alone, single effects are simulated where they would begin as well: far from where a model is linearised, its
evidence says little of which is best. Mistakes of trackers and sensors are looked for again in the residuals of each
set that leaves less than all before, and recordings that could not tell which time steps they follow are asked again by
the first one; where these are others, all begins anew. Errors of mesh and time step are measured where the most
probable sets stand before one of them is an answer. Of the best set of several effects all parts are fitted before
it is an answer, and sets that are a part of it and nearly as probable are fitted again from where it stands: searches
of models with kinks do not end at the same depth, and what has fewer effects must not lose by that.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from sysid.comparison.explanations import UNKNOWN
from sysid.comparison.ledger import Ledger
from sysid.comparison.posterior import FITTED, Candidate, Compared, Posterior, compared, judged, temper_of
from sysid.comparison.priors import PRIORS
from sysid.diagnosis.fitted_sets import FittedSet, SetFits, Shapes
from sysid.observations.observations import Run
from sysid.settings.diagnosis import DIAGNOSIS


def searched(fits: SetFits, say: Callable[[str], None]) -> tuple[list[FittedSet], Posterior | None, list[Run]]:
    """The baseline and all sets that were fitted, and the posterior. Where recordings follow other time steps, all that
    are given with these, and no posterior; else no recordings."""
    fitted = [fits.baseline]
    tried: set[tuple[str, ...]] = {()}
    simulated, clearest, asked = False, fitted[0].names, not fits.base.undecided
    measured: set[tuple[str, ...]] = {()}
    compared_from: set[tuple[tuple[str, ...], tuple[str, ...]]] = set()
    while True:
        best = min(fitted, key=lambda one: one.misfit)
        if best.names != clearest:
            clearest = best.names
            say("mistakes of trackers and sensors")
            fitted = fits.without_mistakes_of(best, fitted) or fitted
            if not asked and (others := fits.with_steps_that_it_follows(_same(fitted, best))):
                return fitted, None, others
            asked = True
        found = compared(ledger_with(fitted))
        posterior = judged(found)
        room = DIAGNOSIS.fitted_sets + 1 - len(fitted)
        parts = _parts(posterior, fitted, tried)
        if parts and room > 0:
            say("whether all of its effects are needed")
            tried |= {part for part, _, _ in parts}
            with ThreadPoolExecutor(len(parts)) as threads:
                more = threads.map(lambda part: fits.fit_without(part[1], part[2]), parts)
                fitted += [one for one in more if one is not None]
            continue
        whole, rivals = _rivals(posterior, fitted)
        rivals = [one for one in rivals if (one.names, whole.names) not in compared_from]
        if rivals:
            say("whether fewer effects do as well")
            compared_from |= {(one.names, whole.names) for one in rivals}
            fitted = [fits.fitted_from(one, whole) if one in rivals else one for one in fitted]
            continue
        wanted = _wanted(posterior, tried)[: DIAGNOSIS.fitted_together]
        if not simulated and leaves_misfit(ledger_with(fitted)):
            simulated, wanted = True, [*wanted, *(s for s in _simulated_best(fits, found) if s not in wanted)]
        wanted = [names for names in wanted if names not in tried][:room]
        stale = [] if wanted else [n for n in _notable(posterior) if n not in measured and n in tried]
        if stale:
            say("error of mesh and time step where effects stand")
            measured |= set(stale)
            fitted = [fits.with_error_where_it_stands(one) if one.names in stale else one for one in fitted]
            continue
        if not wanted:
            others = [] if asked or not leaves_misfit(ledger_with(fitted)) else fits.with_steps_that_it_follows(best)
            return fitted, None if others else posterior, others
        say(" or ".join(" and ".join(names) for names in wanted))
        tried |= set(wanted)
        begun = [fitted[_at(found, names)] for names in wanted]
        shapes = [_shapes(found, names) for names in wanted]
        tempers = [found.evidences[0].temper] * len(wanted)
        with ThreadPoolExecutor(len(wanted)) as threads:
            more = threads.map(fits.fit, begun, shapes, tempers)
            fitted += [one for one in more if one is not None]


def _same(fitted: list[FittedSet], one: FittedSet) -> FittedSet:
    """The set with the same effects among those that were fitted."""
    return next((other for other in fitted if other.names == one.names), one)


def ledger_with(fitted: list[FittedSet]) -> Ledger:
    """The ledger of the baseline with those where sets of effects are fitted."""
    return replace(fitted[0].ledger, amended=tuple(one.ledger.merged for one in fitted[1:]))


def _notable(posterior: Posterior) -> list[tuple[str, ...]]:
    """Sets of effects that are known with a notable share of the probability of such sets, best first."""
    known = [m for m in posterior.models if not any(e.startswith(UNKNOWN) for e in m.effects)]
    whole = sum(m.probability for m in known)
    return [m.effects for m in known if m.probability > DIAGNOSIS.fitted_share * max(whole, 1e-300)]


def _wanted(posterior: Posterior, tried: set[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Notable sets that were not tried. None where nothing missing is the best of them: what is weak is linear."""
    notable = _notable(posterior)
    best = next(m.effects for m in posterior.models if not any(e.startswith(UNKNOWN) for e in m.effects))
    return [names for names in notable if names not in tried] if best else []


def _parts(
    posterior: Posterior, fitted: list[FittedSet], tried: set[tuple[str, ...]]
) -> list[tuple[tuple[str, ...], FittedSet, str]]:
    """Parts of the most probable set of several effects that were not tried, with the set and the effect that each is
    without: a set is no answer before it is known whether all of it is needed."""
    best = next((m.effects for m in posterior.models if not any(e.startswith(UNKNOWN) for e in m.effects)), ())
    whole = next((one for one in fitted if one.names == best), None)
    if whole is None or len(best) < 2:
        return []
    parts = [(tuple(n for n in best if n != effect), whole, effect) for effect in best]
    return [part for part in parts if part[0] not in tried]


def _rivals(posterior: Posterior, fitted: list[FittedSet]) -> tuple[FittedSet, list[FittedSet]]:
    """The most probable set of effects that are known, if it is fitted, and those that are a part of it, not far less
    probable, and fitted too."""
    known = [m for m in posterior.models if not any(e.startswith(UNKNOWN) for e in m.effects)]
    whole = next((one for one in fitted if one.names == known[0].effects), fitted[0])
    near = {m.effects for m in known if m.log_bayes_factor > known[0].log_bayes_factor - DIAGNOSIS.rival_nats}
    return whole, [one for one in fitted if set(one.names) < set(whole.names) and one.names in near]


def leaves_misfit(ledger: Ledger) -> bool:
    """Whether all columns together, where that is least, leave more than noise does."""
    chance = np.sqrt(2.0 / max(ledger.readings, 1))
    least = min(temper_of(one) for one in (ledger, *ledger.amended))
    return least > 1.0 + DIAGNOSIS.misfit_deviations * float(chance)


def _simulated_best(fits: SetFits, found: Compared) -> list[tuple[str, ...]]:
    """Single effects that simulations explain best where their fits would begin."""
    names = {c.names for c in found.candidates if len(c.names) == 1 and not c.names[0].startswith(UNKNOWN)}
    best = sorted(names, key=lambda n: -max(c.factor for c in found.candidates if c.names == n))
    here = [n for n in best if _at(found, n) == 0][: DIAGNOSIS.simulated_effects]
    shapes = {_shapes(found, n)[0]: n for n in here}
    first = fits.promising(fits.baseline, list(shapes), found.evidences[0].temper, DIAGNOSIS.fitted_together)
    return [shapes[s] for s in first]


def _at(found: Compared, names: tuple[str, ...]) -> int:
    return _best(found, names)[0].at


def _best(found: Compared, names: tuple[str, ...]) -> list[Candidate]:
    """Candidates of a set, most probable first."""
    logs = found.logs(PRIORS.weights)
    mine = [k for k, c in enumerate(found.candidates) if c.names == names]
    return [found.candidates[k] for k in sorted(mine, key=lambda k: -float(logs[k]))]


def _shapes(found: Compared, names: tuple[str, ...]) -> list[Shapes]:
    """The most probable shapes of the effects of a set besides those that are fitted where it was compared."""
    best = _best(found, names)
    inside = _fitted_names(best[0])
    shapes = [
        tuple((n, e.label) for n, e in zip(c.names, c.explanations, strict=True) if n not in inside) for c in best
    ]
    return list(dict.fromkeys(shapes))[: DIAGNOSIS.starts_of_a_set]


def _fitted_names(candidate: Candidate) -> set[str]:
    """Effects of a candidate that are fitted where it was compared, whose explanations have no directions."""
    return {n for n, e in zip(candidate.names, candidate.explanations, strict=True) if e.label == FITTED}
