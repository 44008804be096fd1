"""What a rollout is asked to respond to besides parameters: laws that it lacks, and parameters that change in time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from sim_core.energies.term import Internals
from sim_core.permanent_state import lasting
from sim_core.rigs import Rig
from sim_core.scene.scene import Scene


@dataclass
class Amendment:
    """A rig with laws that the baseline lacks. ``scene``: built with these laws, of the same nodes; several amendments
    of different size may share it. ``kept``: internal variables that last, by term, with which a rollout begins."""

    name: str
    rig: Rig
    scene: Scene
    kept: Mapping[str, Internals] = field(init=False, default_factory=dict)

    @property
    def lasting(self) -> Mapping[str, tuple[str, ...]]:
        """Names of internal variables that last, of terms that differ from the baseline's or not."""
        return lasting(self.scene)

    def differences(self, baseline: Scene) -> tuple[bool, dict[str, np.ndarray]]:
        """Whether any terms differ from the baseline's, and the compliance [m/N] ``(3,)`` of mounts that give way here
        alone. The scene has the numbers of the rig from then on."""
        self.scene.use(self.rig)
        values, own = self.scene.values(self.rig), baseline.values(baseline.rig)
        names = [term.name for term in self.scene.system.terms]
        differ = any(n not in own.terms or values.terms.get(n) != own.terms[n] for n in names)
        return differ, {m: c for m, c in values.compliance.items() if m not in own.compliance}


@dataclass(frozen=True)
class Modulation:
    """Parameters that change together in time: by number of those that a rollout is differentiated along, each by a
    course of times [s], ``(n,)`` or one."""

    courses: Mapping[int, Callable[[np.ndarray], np.ndarray]]
