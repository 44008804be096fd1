"""Sentences of a diagnosis, bound to its numbers."""

from __future__ import annotations

from sysid.diagnosis.model_selection import MIN_EXPLAINED, Verdict
from sysid.diagnosis.result import Located

_SEPARATE = {
    frozenset({"gel_relaxation", "wrench_offset"}): "hold at two depths: relaxation grows with depth, drift does not",
    frozenset({"gel_relaxation", "stream_delay"}): "press at two speeds: a delay shows in both, relaxation in the hold",
    frozenset({"static_friction", "end_effector_compliance"}): "press without sliding: only compliance shows then",
    frozenset({"bending_plasticity", "gel_relaxation"}): "wait unloaded: a bend stays, relaxation recovers",
    frozenset({"sheet_orthotropy", "bending_plasticity"}): "press gently first: only the grain shows then",
}


def sentence(verdict: Verdict, located: Located, fates: dict[str, str], hidden: bool) -> str:
    """The answer in one or two sentences. ``hidden``: the discretisation error may hide something."""
    where = _where(located, "misfit" if verdict.kind in ("nothing_missing", "unknown") else "difference")
    if verdict.kind == "nothing_missing" and hidden:
        return (
            "Nothing can be said to be missing: the misfit is beyond the noise, but no larger than the "
            f"simulator's discretisation error could leave; it shows {where}. Refine the mesh or the time step."
        )
    if verdict.kind == "nothing_missing":
        return (
            "Nothing is missing: the rig explains the recordings down to their noise and the "
            f"simulator's discretisation error. {len(fates)} effects were looked for and not found."
        )
    if verdict.kind == "unknown":
        tried = (
            f" The best known effect, '{verdict.named[0].effect.title}', explains too little." if verdict.named else ""
        )
        return f"Something is missing that no known effect explains; it shows {where}.{tried}"
    if verdict.kind == "named":
        return f"The rig leaves out that {verdict.named[0].effect.title}; it shows {where}."
    titles = " or that ".join(t.effect.title for t in verdict.named)
    return f"The rig leaves out that {titles}; these recordings do not tell which. It shows {where}."


def _where(located: Located, what: str) -> str:
    if not located.channels:
        return "nowhere in particular"
    first = located.channels[0]
    return f"most in the {first.quantity} of {first.channel} ({100 * first.share:.0f} % of the {what}), {located.phase}"


def not_explained(verdict: Verdict, baseline_excess: float) -> str:
    """What remains after the answer."""
    if verdict.kind == "nothing_missing":
        return "Nothing beyond noise and the discretisation error."
    if not verdict.named:
        return f"All of the structured misfit ({baseline_excess:.4g} in squared noise units)."
    best = verdict.named[0]
    left = max(0.0, 1.0 - best.explained)
    text = f"{100 * left:.0f} % of the structured misfit remains after '{best.effect.title}'."
    if best.explained < MIN_EXPLAINED:
        text += " Another effect acts as well, or a law that is not in the library."
    return text


def next_experiment(verdict: Verdict, hidden: bool) -> str:
    """What to record or to do next."""
    if verdict.kind == "nothing_missing" and hidden:
        return "No new recording: repeat the diagnosis with finer cells or a shorter solver.dt_s in the rig."
    if verdict.kind == "nothing_missing":
        return "None needed; faster, deeper or longer motions would lower the limits."
    if verdict.kind == "unknown":
        return (
            "Repeat the run in which the misfit is largest at half the speed, at half the depth and with "
            "another object: what changes with speed, depth or object tells rate, strength and place."
        )
    if verdict.kind == "named":
        return "A run of another kind, held out, to confirm it."
    names = [t.effect.name for t in verdict.named]
    for pair, words in _SEPARATE.items():
        if pair <= set(names):
            return words[0].upper() + words[1:] + "."
    return "Vary speed, depth and holding time one at a time; the candidates differ in what they follow."
