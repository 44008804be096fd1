"""Who else publishes on the topics of a node, and who listens."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.node import Node


def other_publishers(node: Node, topics: Sequence[str]) -> dict[str, list[str]]:
    """Names of the nodes that publish on the topics of ``node`` too, by the topics that there are any for. Of two nodes
    of one name, that name."""
    mine, found = node.get_fully_qualified_name(), {}
    for topic in topics:
        full = node.resolve_topic_name(topic)
        if node.count_publishers(full) < 2:
            continue
        offers = node.get_publishers_info_by_topic(full)
        names = [f"{offer.node_namespace.rstrip('/')}/{offer.node_name}" for offer in offers]
        if mine in names:
            names.remove(mine)
        found[full] = sorted(set(names))
    return found


def most_publishers(node: Node, topics: Sequence[str]) -> int:
    """Publishers of that of the topics which has most."""
    return max((node.count_publishers(node.resolve_topic_name(topic)) for topic in topics), default=0)


def subscribers(node: Node, topic: str) -> list[str]:
    """Names, without namespaces, of the nodes that subscribe to a topic."""
    return [offer.node_name for offer in node.get_subscriptions_info_by_topic(node.resolve_topic_name(topic))]
