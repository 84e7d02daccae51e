"""One sequence on its way to the hub: what is still to be sent, and whether there is still a hub that runs it.

A hub can die under a sequence, and then no state of it ever comes. It is missed when nobody publishes the state
of sequences any more, when the samples of the hub stay away, when another hub takes its place, or when the
sequence should long be over.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Any

SILENCE_S = 3.0
"""A hub whose state has stayed away for so long is not there any more."""
RESTART_S = 0.7
"""After a silence of this length, another hub on the graph is the old one started anew."""
ANSWER_S = 10.0
"""Patience with a hub that says nothing of a sequence, from the start stamp on."""
OVERDUE_S = 10.0
"""... and with one that does not say that the sequence has ended."""

_UNDER_WAY = ("handed over", "loading", "ready", "running")
_TAKEN = ("ready", "running", "done")


class HandingOver:
    """A sequence from its first chunk to its end.

    Parameters
    ----------
    sequence_id : str
        Its name.
    chunks : iterator of bytes
        Its messages.
    start_ns, end_ns : int
        When its first sample is to be applied, and its last one [ns, by the node's clock].
    now_s : float
        Steady time [s].
    n_hubs : int
        How many nodes publish the state of sequences now.

    Attributes
    ----------
    state : str
        What the hub said last, "handed over" before that, "lost" when the hub is missed.
    reason : str
        Why it was refused, ended early or is lost.
    is_late : bool
        It was refused for its time alone, before anything moved.
    """

    def __init__(
        self,
        sequence_id: str,
        chunks: Iterator[bytes],
        start_ns: int,
        end_ns: int,
        *,
        now_s: float,
        n_hubs: int,
    ) -> None:
        self.sequence_id = sequence_id
        self.state = "handed over"
        self.reason = ""
        self.is_late = False
        self._chunks = chunks
        self._start_ns, self._end_ns = start_ns, end_ns
        self._n_hubs = n_hubs
        self._heard_s: float | None = None
        self._checked_s = now_s
        self._longest_silence_s = 0.0

    @property
    def is_under_way(self) -> bool:
        """Whether it has not ended yet, as far as is known."""
        return self.state in _UNDER_WAY

    @property
    def verdict(self) -> tuple[bool, str] | None:
        """Whether the hub took it, and a sentence; None while that is not known."""
        if self.state in _TAKEN:
            return True, f"{self.sequence_id} starts"
        if self.state == "refused":
            return False, f"the hub refused {self.sequence_id}: {self.reason}"
        if not self.is_under_way:
            return False, f"{self.sequence_id} {self.state}: {self.reason}"
        return None

    def take_chunks(self, count: int) -> list[bytes]:
        """Return the next messages to be sent."""
        return list(islice(self._chunks, count)) if self.is_under_way else []

    def note(self, report: dict[str, Any]) -> None:
        """Take a message of the hub's about a sequence; one about another sequence is not for us."""
        if report.get("id") == self.sequence_id:
            self.state, self.reason = str(report.get("state")), str(report.get("reason", ""))
            self.is_late = self.state == "refused" and report.get("late") is True

    def hear(self, now_s: float) -> None:
        """Take note of a sign of life of the hub at a steady time [s]."""
        if self._heard_s is not None:
            self._longest_silence_s = max(self._longest_silence_s, now_s - self._heard_s)
        self._heard_s = now_s

    def give_up(self, reason: str) -> None:
        """Note that it came to nothing for a reason on this side."""
        self.state, self.reason = "aborted", reason

    def check(self, now_s: float, now_ns: int, n_hubs: int) -> bool:
        """Look for the hub; return whether it is missed from now on.

        Parameters
        ----------
        now_s : float
            Steady time [s]; looked at several times a second.
        now_ns : int
            The node's clock [ns].
        n_hubs : int
            How many nodes publish the state of sequences now.
        """
        was_away_s, self._checked_s = now_s - self._checked_s, now_s
        if was_away_s > RESTART_S and self._heard_s is not None:
            # This process did not come round: what the hub said meanwhile has not been taken yet.
            self._heard_s = now_s
        if not self.is_under_way:
            return False
        # Discovery may bring the hub a moment later.
        self._n_hubs = self._n_hubs or n_hubs
        self.reason = self._missed(now_s, now_ns, n_hubs)
        if self.reason:
            self.state = "lost"
        return bool(self.reason)

    def _missed(self, now_s: float, now_ns: int, n_hubs: int) -> str:
        remedy = "start it again when there is a hub, which must be homed and enabled anew"
        if n_hubs < min(self._n_hubs, 1):
            return f"the hub has left the graph; {remedy}"
        silence_s = 0.0 if self._heard_s is None else now_s - self._heard_s
        if silence_s > SILENCE_S:
            return f"the hub has been silent for {silence_s:.1f} s; {remedy}"
        if n_hubs > self._n_hubs and max(silence_s, self._longest_silence_s) > RESTART_S:
            return f"the hub was started anew; {remedy}"
        if self.state == "handed over" and now_ns > self._start_ns + ANSWER_S * 1e9:
            return f"the hub said nothing of it: is a hub on this graph? {remedy}"
        if now_ns > self._end_ns + OVERDUE_S * 1e9:
            return f"it should have ended {(now_ns - self._end_ns) * 1e-9:.0f} s ago; {remedy}"
        return ""
