"""A lifecycle node that a request for a transition which it does not have cannot end.

In rclpy 7.1 such a request raises in the callback of the service and ends the node (ros2/rclpy issue 1209).
"""

from __future__ import annotations

from typing import Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.lifecycle import LifecycleNode


class ManagedNode(LifecycleNode):
    """Refuses transitions that its present state does not have, and goes on."""

    # The callback of the service is private to the base class: its name is written as Python mangles it.
    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:
        try:
            return super()._LifecycleNodeMixin__on_change_state(request, response)  # type: ignore[misc]
        except RCLError:
            state = self._state_machine.current_state[1]
            wanted = request.transition.label or f"number {request.transition.id}"
            self.get_logger().warning(f"The transition {wanted} was refused: the state {state!r} does not have it.")
            response.success = False
            return response
