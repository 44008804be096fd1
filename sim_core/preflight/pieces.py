"""Bodies that are in pieces which nothing joins."""

from __future__ import annotations

from sim_core.postprocess import Layout
from sim_core.preflight.finding import Finding
from sim_core.rigs.pieces import pieces_held

LISTED = 4
"""Pieces that a finding lists."""


def piece_findings(layout: Layout) -> list[Finding]:
    """A finding for each sheet or gel of several pieces, with what holds each."""
    found = []
    for name, body in layout.rig.bodies.items():
        if body.type not in ("sheet", "gel") or body.shape.type != "mesh":
            continue
        pieces = pieces_held(layout.rig, name)
        if len(pieces) < 2:
            continue
        words = [f"{p.words}, held by {' and '.join(p.holders) or 'nothing'}" for p in pieces[:LISTED]]
        more = f"; and {len(pieces) - LISTED} more" if len(pieces) > LISTED else ""
        found.append(
            Finding(
                "pieces",
                f"{name} is in {len(pieces)} pieces that share no vertex: {'; '.join(words)}{more}.",
                "Join them in the program that made the mesh, or give each piece a body of its own.",
            )
        )
    return found
