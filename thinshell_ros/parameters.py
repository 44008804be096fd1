"""Parameters with a description and a range."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterUninitializedException,
)
from rclpy.node import Node

from sim_core.errors import ConfigError, nearest_match


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    *,
    bounds: tuple[float, float] | None = None,
    fixed: bool = True,
    any_type: bool = False,
) -> Any:
    """Declare a parameter and return its value.

    ``bounds``: of a number, both included; ``fixed``: it is read once, at the start, and cannot be set later;
    ``any_type``: its value may be of another type than its default.

    Raises:
        ConfigError: the value given on the command line or in a file does not fit.
    """
    descriptor = ParameterDescriptor(description=description, read_only=fixed, dynamic_typing=any_type)
    if bounds is not None:
        low, high = bounds
        if isinstance(default, int):
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    try:
        value = node.declare_parameter(name, default, descriptor).value
    except InvalidParameterTypeException as error:
        kind = type(default).__name__
        remedy = "Write a decimal point, as in 5.0." if kind == "float" else f"Give a value of type {kind}."
        raise ConfigError(f"The parameter {name} is of another type: {error}.", remedy) from error
    except InvalidParameterValueException as error:
        remedy = "" if bounds is None else f"Choose a value from {bounds[0]:g} to {bounds[1]:g}."
        raise ConfigError(f"The parameter {name} is out of its range: {error}.", remedy) from error
    if bounds is not None and not bounds[0] <= value <= bounds[1]:  # NaN passes the middleware's check
        raise ConfigError(f"The parameter {name} is {value}.", f"Choose from {bounds[0]:g} to {bounds[1]:g}.")
    return value


def value_of(node: Node, name: str) -> Any:
    """Value of a declared parameter now; None if it has none."""
    try:
        return node.get_parameter(name).value
    except ParameterUninitializedException:
        return None


def warn_of_unknown(node: Node) -> None:
    """Log a warning for each parameter that was given on the command line or in a file, and that a node whose
    parameters are all declared does not have. No error: a file may be for several nodes."""
    # rclpy keeps what was given, and has no public way to ask for what was not declared.
    for name in node._parameter_overrides:
        # Overrides of quality of service are declared with the topics, which come later.
        if not node.has_parameter(name) and not name.startswith("qos_overrides."):
            node.get_logger().warning(
                f"The parameter {name} was given, and is not one of {node.get_name()}: it is ignored. "
                f"{nearest_match(name, node._parameters)}"
            )
