"""Whether the other side answers, for how long it has said nothing, and if it does not answer, why."""

from __future__ import annotations

from beam_ros.hub.contract import HubStatus
from beam_ros.hub.faults import NO_FAULT, Fault, fault
from beam_ros.hub.host.waking_time import WakingTime
from beam_ros.hub.journal import Journal


class Contact:
    """The other side of a link, as far as it can be reached.

    Parameters
    ----------
    journal : Journal
        Hears when the other side is lost, once for each kind of loss.
    patience_ns : int, optional
        After so long a silence the other side is lost, where a link looks for that here [ns].

    Attributes
    ----------
    is_made : bool
        Whether the other side answers.
    fault : Fault
        Why it cannot be reached; ``NO_FAULT`` while it answers, and before anything was tried.
    reason : str
        The same in words.
    """

    def __init__(self, journal: Journal, patience_ns: int = 0) -> None:
        self.is_made = False
        self.fault: Fault = NO_FAULT
        self.reason = "not connected yet"
        self._journal = journal
        self._told: Fault = NO_FAULT
        self._patience_ns = patience_ns
        self._waking = WakingTime()
        self._heard_ns = 0

    def await_answer(self) -> None:
        """Note that it can be reached and has yet to answer; nothing of it goes into the log."""
        self.is_made, self.fault, self.reason = (
            False,
            fault("no_answer"),
            "the controller has not answered yet",
        )

    def make(self, what: str, *, is_lasting: bool = True) -> None:
        """Note that it answers; ``what`` it is goes into the log.

        Where that is known not to last (``is_lasting``), the same loss is not reported once more.
        """
        self.is_made, self.fault, self.reason = True, NO_FAULT, ""
        if is_lasting:
            self._told = NO_FAULT
        self._journal.counters["connections"] += 1
        self._journal.tell("info", f"connected: {what}")
        self.hear()

    def lose(self, cause: Fault, reason: str, *, is_news: bool = False) -> None:
        """Note that it does not answer, and what was seen; ``is_news``: it is reported even if it was the last."""
        if cause is not self._told or is_news:
            self._journal.tell("error", reason)
        self.is_made, self._told, self.fault = False, cause, cause
        self.reason = reason

    def hear(self) -> None:
        """Note a word."""
        self._heard_ns = self._waking.ns

    def is_silent(self, now_ns: int) -> bool:
        """Look, at steady time ``now_ns``, whether the other side has said nothing for too long.

        Who looks often enough sees the silence grow with the clock; who was put aside heard nothing meanwhile.
        """
        silent_ns = self._waking.look(now_ns) - self._heard_ns
        return self.is_made and silent_ns > self._patience_ns

    @property
    def status(self) -> HubStatus:
        """What is known of a hub that cannot be reached."""
        return HubStatus(fault=self.fault, reason=self.reason, counters=dict(self._journal.counters))
