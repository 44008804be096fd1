"""Sentences of a diagnosis, bound to its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sysid.diagnosis.refits import Trial
from sysid.diagnosis.result import Located, UnreliablePlace
from sysid.diagnosis.verdict import Case, Verdict, rejected, size_of
from sysid.settings.diagnosis import DIAGNOSIS

NOWHERE = "nowhere in particular"


def sentence(
    verdict: Verdict,
    located: Located,
    fates: Mapping[str, str],
    case: Case,
    places: Sequence[UnreliablePlace] = (),
) -> str:
    """The answer in a few sentences, size beside significance. ``places``: where what is unknown may be."""
    where = _where(located, "difference" if verdict.named and verdict.kind != "unknown" else "misfit")
    if verdict.kind == "nothing_missing":
        looked = f"{len(fates)} effects were looked for and not found."
        down_to = "down to their noise, the simulator's discretisation error and what careful models differ in"
        far = [c for c in case.contradictions if c.deviations > DIAGNOSIS.certainly_far_sd]
        if far:
            values = " and ".join(
                f"{c.name} is {c.fitted}, where the rig says {c.told:.4g}, {c.deviations:.1f} times as far off as is "
                "known of it"
                for c in far
            )
            return f"Nothing is missing if {values}: with that the rig explains the recordings {down_to}. {looked}"
        return f"Nothing is missing: the rig explains the recordings {down_to}. {looked}"
    if verdict.kind == "refine_discretisation":
        if case.missed and not case.coarse:
            return f"Nothing can be said to be missing or not. {case.missed[0]} Refine the mesh or the time step."
        why = f" {case.coarse[0]}" if case.coarse else ""
        return (
            "Nothing can be said to be missing or not: the misfit is no larger than the simulator's discretisation "
            f"error could leave; it shows {where}. Refine the mesh or the time step.{why}"
        )
    if verdict.kind == "recording_fault":
        return f"The recordings themselves are at fault, so nothing can be said of the rig. {' '.join(case.faults)}"
    if verdict.kind == "unknown":
        tried = ""
        if verdict.named:
            best = verdict.named[0]
            tried = f" The best known effect, that {best.title}, explains only {_percent(size_of(best))} of it."
        return f"Something is missing that no known effect explains; it shows {where}.{tried}{_place(places)}"
    best = verdict.named[0]
    if verdict.kind == "partly":
        return (
            f"It is a part of the answer that {best.title}: that explains {_percent(size_of(best))} of the misfit. "
            f"Something else is missing that no known effect explains. The difference shows {where}." + _place(places)
        )
    if verdict.kind == "named":
        return f"The rig leaves out that {best.title}. {_size(best, case)} It shows {where}."
    titles = ", or that ".join(t.title for t in verdict.named)
    return (
        f"The rig leaves out that {titles}; these recordings do not tell which. {_size(best, case)} It shows {where}."
    )


def _place(places: Sequence[UnreliablePlace]) -> str:
    if not places:
        return ""
    first = places[0]
    return (
        f" Without any law, it is told best where {first.words}: a change there in time takes away "
        f"{_percent(first.explained)} of what is beyond noise, inside these recordings only."
    )


def _size(trial: Trial, case: Case) -> str:
    if not case.missing:
        there = "" if trial.predicts is None else f", and recordings held out speak for it by {trial.predicts:.0f} nats"
        return (
            f"Without it no misfit stands out by itself, but with it the fit gains {trial.gain:.0f} nats, where "
            f"{case.needed:.0f} are needed{there}."
        )
    held = (
        f", and {_percent(trial.explained_there)} on recordings held out" if trial.explained_there is not None else ""
    )
    return f"With it {_percent(trial.explained)} of the misfit beyond noise is gone{held}."


def _percent(share: float | None) -> str:
    return f"{100.0 * max(share or 0.0, 0.0):.0f} %"


def _where(located: Located, what: str) -> str:
    if not located.channels or located.channels[0].share <= 0.0:
        return NOWHERE
    first = located.channels[0]
    when = f", mostly while {located.phase}" if located.phase not in ("", NOWHERE) else ""
    return f"most in the {first.quantity} of {first.channel} ({_percent(first.share)} of the {what}){when}"


def reason(trial: Trial, case: Case) -> str:
    """Why a set of effects is no answer, in words of everyday use; empty when it may be one."""
    why = rejected(trial, case)
    if not why or trial.failure or trial.gain >= case.needed:
        return why
    return "Chance alone improves a fit as much."


def not_explained(verdict: Verdict, case: Case) -> str:
    """What remains after the answer."""
    if verdict.kind == "nothing_missing":
        return "Nothing beyond noise, the discretisation error and what careful models differ in."
    if verdict.kind == "refine_discretisation":
        return "The discretisation error hides what there may be."
    if not verdict.named:
        return "All of the misfit beyond noise and the discretisation error."
    best = verdict.named[0]
    left = max(0.0, 1.0 - size_of(best))
    if left < DIAGNOSIS.negligible_misfit_share:
        return f"With the knowledge that {best.title}, no misfit beyond noise and the discretisation error is left."
    text = f"{_percent(left)} of the misfit beyond noise is left with the knowledge that {best.title}."
    if size_of(best) < DIAGNOSIS.least_explained_share:
        text += " Another effect acts as well, or a law that is not in the library."
    return text


def next_experiment(verdict: Verdict, case: Case) -> str:
    """What to record or to do next."""
    far = [c.name for c in case.contradictions if c.deviations > DIAGNOSIS.certainly_far_sd]
    if verdict.kind == "nothing_missing" and far:
        return (
            f"No new recording: see whether {' and '.join(far)} can be what the recordings ask for, and mend the rig."
        )
    if verdict.kind == "refine_discretisation":
        return "No new recording: repeat the diagnosis with finer cells or a shorter solver.dt_s in the rig."
    if verdict.kind == "nothing_missing":
        return "None needed; faster, deeper or longer motions would lower the limits."
    if verdict.kind == "recording_fault":
        return "Mend what is wrong with the recordings and record again."
    if verdict.kind in ("unknown", "partly"):
        return (
            "Repeat the run in which the misfit is largest at half the speed, at half the depth and with "
            "another object: what changes with speed, depth or object tells rate, strength and place."
        )
    if verdict.kind == "named":
        told = verdict.named[0].hypotheses[0].effect.separated_by
        return f"To confirm it against its twins: {told}" if told else "A run of another kind, held out, to confirm it."
    effects = [h.effect for t in verdict.named for h in t.hypotheses]
    names = {e.name for e in effects}
    for effect in effects:
        if effect.separated_by and names & set(effect.twins):
            return f"To tell them apart: {effect.separated_by}"
    told = next((e.separated_by for e in effects if e.separated_by), "")
    return told or "Vary speed, depth and holding time one at a time; the candidates differ in what they follow."
