"""A client of nodes: calls their services, sets their parameters and waits for what they publish."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import monotonic
from typing import Any

from sim_core.errors import ConfigError, WorkerError

SERVICE_S = 120.0
"""Longest time [s] for a service to be there, and for its response."""


class NodeClient:
    """A node of its own. A context manager.

    Relative names are below ``namespace``. ROS is started where it does not run yet, and ended again.
    """

    def __init__(self, name: str, namespace: str = "") -> None:
        import rclpy

        self._began = not rclpy.ok()
        if self._began:
            rclpy.init()
        self.node = rclpy.create_node(name, namespace=namespace or "/")

    def __enter__(self) -> NodeClient:
        return self

    def __exit__(self, *_: object) -> None:
        import rclpy

        self.node.destroy_node()
        if self._began:
            rclpy.try_shutdown()

    def ask(self, kind: Any, name: str, request: Any, alive: Callable[[], object] = lambda: None) -> Any:
        """Response of a service. ``alive``: raises where who offers it has ended.

        Raises:
            WorkerError: there is no such service, or no response.
        """
        client = self.node.create_client(kind, name)
        try:
            self.until(client.service_is_ready, f"service {client.srv_name}", SERVICE_S, alive)
            future = client.call_async(request)
            self.until(future.done, f"response of {client.srv_name}", SERVICE_S, alive)
            return future.result()
        finally:
            self.node.destroy_client(client)

    def trigger(self, name: str, alive: Callable[[], object] = lambda: None) -> Any:
        """Response of a service without arguments; as :meth:`ask`."""
        from std_srvs.srv import Trigger

        return self.ask(Trigger, name, Trigger.Request(), alive)

    def set_parameters(self, node: str, values: Mapping[str, str]) -> None:
        """Set parameters of a node, whose values are written as in YAML.

        Raises:
            ConfigError: it refuses one.
            WorkerError: it does not respond.
        """
        from rcl_interfaces.msg import Parameter
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import get_parameter_value

        if not values:
            return
        given = [Parameter(name=name, value=get_parameter_value(text)) for name, text in values.items()]
        response = self.ask(SetParameters, f"{node}/set_parameters", SetParameters.Request(parameters=given))
        for name, result in zip(values, response.results, strict=True):
            if not result.successful:
                raise ConfigError(
                    f"{node} does not take {name} = {values[name]}: {result.reason or 'it gives no reason'}.",
                    "Its parameter file in config/nodes names its parameters and their types.",
                )

    def until(
        self,
        condition: Callable[[], object],
        what: str,
        most_s: float,
        alive: Callable[[], object] = lambda: None,
    ) -> None:
        """Take messages until a condition holds.

        Raises:
            WorkerError: it does not hold after ``most_s`` [s].
        """
        import rclpy

        end = monotonic() + most_s
        while not condition():
            rclpy.spin_once(self.node, timeout_sec=0.1)
            alive()
            if monotonic() > end:
                raise WorkerError(f"There is no {what} after {most_s:g} s.", "See what the nodes say.")
