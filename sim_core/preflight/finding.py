"""One thing that looks wrong in a rig or a motion, in words."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """``kind``: what it is about, in two words; ``problem``: names things and values; ``remedy``: what to do."""

    kind: str
    problem: str
    remedy: str

    @property
    def text(self) -> str:
        """Problem and remedy."""
        return f"{self.problem} {self.remedy}"
