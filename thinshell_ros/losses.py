"""Messages that were published and did not arrive, by the numbers that publishers give them. No ROS."""

from __future__ import annotations


class Losses:
    """Counts of lost messages by topic. With several publishers on a topic, messages do not say whose they are: there
    losses are not known, and the topic is left out."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self._last: dict[str, int] = {}
        self._several: set[str] = set()

    def publishers(self, topic: str, count: int) -> None:
        """Say how many publishers a topic has."""
        if count > 1:
            self._several.add(topic)
            self.counts.pop(topic, None)

    def take(self, topic: str, number: int | None) -> None:
        """A message has come; ``number``: how many its publisher had published with it, None if not known."""
        if number is None or topic in self._several:
            return
        last = self._last.get(topic, number - 1)
        self._last[topic] = number
        gap = number - last - 1 if number > last else 0  # a publisher that was started again begins with 1
        self.counts[topic] = self.counts.get(topic, 0) + gap
