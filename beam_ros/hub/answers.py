"""Answers to requests: numbered in the order of asking, and kept until the next report."""

from __future__ import annotations

from beam_ros.hub.contract import Outcome


class Answers:
    """Numbers of requests, and answers that nobody has taken yet."""

    def __init__(self) -> None:
        self._newest = 0
        self._waiting: list[tuple[int, Outcome]] = []

    def begin(self) -> int:
        """Return the number of a new request."""
        self._newest += 1
        return self._newest

    def add(self, number: int, outcome: Outcome) -> None:
        """Answer a request."""
        self._waiting.append((number, outcome))

    def give(self, outcome: Outcome) -> int:
        """Answer a new request at once; return its number."""
        self.add(self.begin(), outcome)
        return self._newest

    @property
    def are_there(self) -> bool:
        """Whether ``take`` has something to return."""
        return bool(self._waiting)

    def take(self) -> list[tuple[int, Outcome]]:
        """Return what was answered since the last call."""
        taken, self._waiting = self._waiting, []
        return taken
