"""What the core takes its record from: a scene, or a system that was put together by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from sim_core.solve.system import System


class Mechanics(Protocol):
    """``system``: nodes and terms; ``start``: mounts by name; ``followers``: nodes that follow them rigidly
    (:class:`sim_core.scene.scene.Follower`); ``bodies``: those by whose density one differentiates; ``compliant``:
    names of the groups of the system that give way; ``contacts``: terms of each declared contact."""

    @property
    def system(self) -> System: ...
    @property
    def start(self) -> Mapping[str, Any]: ...
    @property
    def followers(self) -> Sequence[Any]: ...
    @property
    def bodies(self) -> Mapping[str, Any]: ...
    @property
    def compliant(self) -> Sequence[str]: ...
    @property
    def contacts(self) -> Mapping[str, Sequence[Any]]: ...

    def placed_on(self, node: int) -> tuple[str, np.ndarray]:
        """Mount of the rigid body that stands at a node, and its rotation in the mount's frame ``(3, 3)``."""
        ...
