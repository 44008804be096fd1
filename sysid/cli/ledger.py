"""``thinshell ledger``: what a diagnosis has seen, judged again without a rollout."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sysid.cli.bounds import number
from sysid.cli.options import library

if TYPE_CHECKING:
    from sysid.comparison.ledger import Ledger


def ledger(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of a diagnosis, or its ledger.npz.")],
    without: Annotated[
        list[str] | None,
        typer.Option("--without", metavar="EFFECT", help="As of a library without this effect; may be repeated."),
    ] = None,
    nothing: Annotated[
        float, number("--nothing", "Prior probability that nothing is missing.", 1e-6, 1.0 - 1e-6)
    ] = 0.5,
    compare: Annotated[
        Path | None, typer.Option("--compare", metavar="FOLDER", help="Another diagnosis, whose answer is shown too.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Judge the recordings of a diagnosis again, with other priors or without an effect. No simulation is run.

    Probabilities are of the effects of the library and of places with unknown physics, of sets of effects that were
    fitted where they are, of all others linearised.

    Example: thinshell ledger diagnosis --without gel_relaxation
    """
    read = library("sysid.comparison.ledger", "read_ledger")
    found = [read(path).without(without or []) for path in (folder, compare) if path is not None]
    judged = [_judged(one, nothing) for one in found]
    if as_json:
        print(json.dumps(judged if compare else judged[0], indent=2, allow_nan=False))
        return
    for path, one in zip((folder, compare), judged, strict=False):
        print(f"{path}: {one['readings']} readings in {one['blocks']} blocks of {len(one['recordings'])} recordings")
        print(f"  {'probability':>11}  {'log B [nats]':>12}  {'left':>6}  effects that are missing")
        for model in one["models"]:
            names = " and ".join(model["effects"]) or "nothing is missing"
            print(f"  {model['probability']:11.3f}  {model['log_bayes_factor']:12.1f}  {model['left']:6.2f}  {names}")
            for a in model["amplitudes"]:
                low, high = a["ci95"]
                print(f"{'':37}{a['effect']}.{a['name']} = {a['value']:.4g} ({low:.4g} .. {high:.4g}) {a['unit']}")
        print()
    if compare:
        _print_change(judged[0]["inclusion"], judged[1]["inclusion"])
    print("log B: Bayes factor over nothing missing. left: mean squared misfit in units of the noise.")


def _judged(found: Ledger, nothing: float) -> dict[str, Any]:
    """The posterior of a ledger as plain data."""
    from sysid.comparison.evidence import joined
    from sysid.comparison.posterior import compared, posterior

    evidences, result = compared(found).evidences, posterior(found, nothing=nothing)
    models = []
    for m in result.credible():
        evidence, together = evidences[m.at], joined(m.directions)
        models.append(
            {
                "effects": list(m.effects),
                "probability": m.probability,
                "log_bayes_factor": m.log_bayes_factor,
                "left": evidence.left(together),
                "amplitudes": [
                    {
                        "effect": a.column.owner,
                        "name": a.column.name,
                        "value": a.value,
                        "ci95": list(a.interval),
                        "unit": a.column.unit,
                    }
                    for a in (*evidence.fitted_amplitudes(together), *evidence.amplitudes(together))
                ],
            }
        )
    return {
        "models": models,
        "nothing_missing": result.nothing,
        "unknown": result.unknown,
        "inclusion": result.inclusion,
        "readings": found.readings,
        "blocks": len(found.blocks),
        "recordings": list(dict.fromkeys(b.recording for b in found.blocks)),
        "temper": evidences[0].temper,
    }


def _print_change(first: dict[str, float], second: dict[str, float]) -> None:
    """Effects whose probability differs most between two diagnoses."""
    names = sorted({*first, *second}, key=lambda n: -abs(first.get(n, 0.0) - second.get(n, 0.0)))
    print("Probability that an effect is missing, in the first and in the second:")
    for name in names[:10]:
        print(f"  {first.get(name, 0.0):6.3f}  {second.get(name, 0.0):6.3f}  {name}")
