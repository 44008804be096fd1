"""Sentences of a diagnosis, bound to its numbers."""

from __future__ import annotations

from collections.abc import Sequence

from sim_core.effects import effect_by_name
from sysid.diagnosis.result import Located
from sysid.diagnosis.verdict import WHERE, Verdict, in_percent, words_of

NOWHERE = "nowhere in particular"


def sentence(
    verdict: Verdict, located: Located, explained: float, looked_for: int, missed: str = "", faults: Sequence[str] = ()
) -> str:
    """The answer in a few sentences, with its probability and its size. ``explained``: share of the misfit beyond noise
    that is gone with the effects named; ``looked_for``: number of effects; ``missed``: how recordings held out are
    missed by far; ``faults``: of the recordings."""
    first = verdict.sets[0]
    if verdict.kind == "recording_fault":
        return f"The recordings themselves are at fault, so nothing can be said of the rig. {' '.join(faults)}"
    if verdict.kind == "nothing_missing":
        return (
            f"Nothing is missing (probability {in_percent(verdict.nothing)}): {looked_for} effects were looked for, "
            "and the rig explains the recordings as well as careful simulations do."
        )
    if verdict.kind == "refine_discretisation":
        return (
            f"Nothing can be said to be missing or not. Most probable is that {first.words} "
            f"({in_percent(first.probability)}), but not if the error of mesh and time step is twice as uncertain as "
            "refinement says. Refine the mesh or the time step."
        )
    shows = f" The difference shows {_where(located)}."
    where = next(iter(verdict.places), "")
    rest = f" Most probably it is missing {WHERE.get(where, where)} ({in_percent(verdict.places.get(where, 0.0))})."
    if verdict.kind == "unknown" and not first.causes:
        return (
            f"Something is missing that the recordings given do not show, in which nothing is (probability "
            f"{in_percent(verdict.nothing)}): in recordings held out it shows. {missed}"
        )
    if verdict.kind == "unknown":
        return (
            "Something is missing that no known effect describes "
            f"(probability {in_percent(verdict.unknown)}).{rest}{shows}"
        )
    gone = f" With it {in_percent(explained)} of the misfit beyond noise is gone."
    if verdict.kind == "partly":
        named = words_of(first.effects)
        chance = f" (probability {in_percent(verdict.unknown)})" if first.unknown else ""
        return (
            f"It is a part of the answer that {named}. Something else is missing that no known effect describes"
            f"{chance}.{gone}{shows}"
        )
    if verdict.kind == "named":
        return f"The rig leaves out that {first.words} (probability {in_percent(first.probability)}).{gone}{shows}"
    titles = ", or that ".join(f"{s.words} ({in_percent(s.probability)})" for s in verdict.sets)
    return f"The rig leaves out that {titles}; these recordings do not tell which.{gone}{shows}"


def _where(located: Located) -> str:
    if not located.channels or located.channels[0].share <= 0.0:
        return NOWHERE
    first = located.channels[0]
    when = f", mostly while {located.phase}" if located.phase not in ("", NOWHERE) else ""
    return f"most in the {first.quantity} of {first.channel} ({in_percent(first.share)} of it){when}"


def not_explained(verdict: Verdict, worst: str) -> str:
    """What remains after the answer. ``worst``: the quantity that is missed most, in words with units."""
    rest = f" Most is left in {worst}." if worst else ""
    if verdict.kind == "nothing_missing":
        return f"Something is missing with a probability of {in_percent(1.0 - verdict.nothing)}.{rest}"
    if verdict.kind == "refine_discretisation":
        return f"The error of mesh and time step hides what there may be.{rest}"
    return f"Something that no known effect describes: {in_percent(verdict.unknown)}.{rest}"


def next_experiment(verdict: Verdict) -> str:
    """What to record or to do next."""
    if verdict.kind == "nothing_missing":
        return "None needed; faster, deeper or longer motions would lower the limits."
    if verdict.kind == "refine_discretisation":
        return "No new recording: repeat the diagnosis with finer cells or a shorter solver.dt_s in the rig."
    if verdict.kind == "recording_fault":
        return "Mend what is wrong with the recordings and record again."
    effects = [effect_by_name(n) for n in verdict.answer]
    if not effects or verdict.kind == "unknown":
        return (
            "Record the same motion at half and at twice the speed, to another depth and with another object: what "
            "changes with speed, depth or object tells rate, strength and place."
        )
    names = {e.name for e in effects}
    for effect in effects:
        if effect.separated_by and (verdict.kind == "named" or names & set(effect.twins)):
            return f"To tell it from its twins: {effect.separated_by}"
    text = next((e.separated_by for e in effects if e.separated_by), "")
    return text or "Vary speed, depth and holding time one at a time; the candidates differ in what they follow."
