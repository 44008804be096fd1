"""Outcome of one case in a word or two.

- Nothing concealed: ``clear``, ``false alarm``.
- One effect of the library: ``named`` (it alone), ``right set`` (one of several said to be indistinguishable, the true
  one among them).
- Two effects: ``named`` (both and no other), ``right set`` (both among those said), ``one of two`` (one of them and
  nothing false).
- Outside the library: ``right slot``, ``other slot`` (noticed, not named, and placed there or elsewhere).
- Anything concealed: ``wrong`` (something false is named), ``unknown`` (noticed, not named), ``missed`` (not noticed).
- Always: ``refine`` (the answer is to refine the discretisation first), ``error`` (no answer).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sysid.proof.answer import Answer

KINDS = ("empty", "one", "two", "outside")

ALSO = {"air": ("sheet",), "clock": ("robot",), "robot": ("clock",)}
"""Slots in which a misfit may be placed as well: drag acts on the sheet, and a lag of the arm looks like a clock."""


def kind_of(effects: Sequence[dict[str, Any]]) -> str:
    """What a case conceals: one of :data:`KINDS`."""
    if not effects:
        return "empty"
    if not all(e["in_library"] for e in effects):
        return "outside"
    return "one" if len(effects) == 1 else "two"


def outcome(effects: Sequence[dict[str, Any]], answer: Answer) -> str:
    """Outcome for sealed effects (``name``, ``slot``, ``in_library``)."""
    kind, verdict = kind_of(effects), answer.verdict
    if verdict == "refine_discretisation":
        return "refine"
    if kind == "empty":
        return "clear" if verdict == "nothing_missing" else "false alarm"
    if verdict == "nothing_missing":
        return "missed"
    true, said = {e["name"] for e in effects if e["in_library"]}, set(answer.named)
    if verdict == "unknown" or not said:
        if kind != "outside":
            return "unknown"
        return "right slot" if _placed(effects, answer) else "other slot"
    if verdict == "one_of":
        return "right set" if true and true <= said else "wrong"
    if said == true:
        return "named"
    return "one of two" if kind == "two" and said < true else "wrong"


def _placed(effects: Sequence[dict[str, Any]], answer: Answer) -> bool:
    """Whether the first slot that the answer holds for unreliable is that of a concealed effect."""
    slots = {s for e in effects for s in (e["slot"], *ALSO.get(e["slot"], ()))}
    return bool(answer.places) and answer.places[0] in {s.removesuffix(" sensor") for s in slots}


def among_first(effects: Sequence[dict[str, Any]], answer: Answer, count: int = 3) -> bool:
    """Whether all concealed effects are among the likeliest explanations."""
    return {e["name"] for e in effects} <= {name for name, _ in answer.ranked[:count]}


def sure_and_wrong(effects: Sequence[dict[str, Any]], answer: Answer, sure: float = 0.9) -> bool:
    """Whether an effect that is not concealed is named with a probability above ``sure``."""
    true, likely = {e["name"] for e in effects}, dict(answer.ranked)
    if answer.verdict not in ("named", "partly"):
        return False
    return any(likely.get(name, 0.0) > sure for name in answer.named if name not in true)
