"""Whether the other side answers, and if not, why."""

from __future__ import annotations

from beam_ros.hub.contract import HubStatus
from beam_ros.hub.faults import NO_FAULT, Fault, fault
from beam_ros.hub.journal import Journal


class Contact:
    """The other side of a link, as far as it can be reached.

    Parameters
    ----------
    journal : Journal
        Is told when the other side is lost, once for each kind of loss.
    reason : str
        Why it cannot be reached yet.

    Attributes
    ----------
    fault : Fault
        Why it cannot be reached; ``NO_FAULT`` while it answers.
    reason : str
        The same in words.
    """

    def __init__(self, journal: Journal, reason: str) -> None:
        self.fault: Fault = fault("no_answer")
        self.reason = reason
        self._journal = journal
        self._told = ""

    @property
    def is_made(self) -> bool:
        """Whether the other side answers."""
        return self.fault is NO_FAULT

    def make(self, what: str) -> None:
        """Note that it answers; ``what`` it is goes into the log."""
        self.fault, self.reason, self._told = NO_FAULT, "", ""
        self._journal.counters["connections"] += 1
        self._journal.tell("info", f"connected: {what}")

    def lose(self, name: str, reason: str) -> None:
        """Note that it does not: a name in the table of faults, and what was seen."""
        if name != self._told:
            self._journal.tell("error", reason)
        self._told = name
        self.fault, self.reason = fault(name), reason

    @property
    def status(self) -> HubStatus:
        """What is known of a hub that cannot be reached."""
        return HubStatus(fault=self.fault, reason=self.reason, counters=dict(self._journal.counters))
