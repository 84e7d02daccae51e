"""Requests that the host itself answers: numbered, and their answers kept for the next report."""

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

    def add(self, number: int, success: bool, message: str) -> None:
        """Answer a request."""
        self._waiting.append((number, Outcome(success, message)))

    def take(self) -> list[tuple[int, Outcome]]:
        """Return what was answered since the last call."""
        taken, self._waiting = self._waiting, []
        return taken
