"""How far ahead of its handing over a sequence starts, and what follows where that was not far enough.

On a busy computer the chunks of a sequence may reach the hub when its start stamp is over already. The hub refuses
them then, because nothing acts on an old stamp, and nothing has moved. So it is handed over anew, with a fresh
stamp twice as far ahead: the person who asked for the start still waits for the answer. This has an end: the rule
about old stamps is there against an axis that moves long after somebody wanted it.
"""

from __future__ import annotations

from beam_ros.hub.contract import MAX_CHUNK_POINTS

GROWTH = 2.0
"""Each start is so many times as far ahead of its handing over as the one before."""
MAX_TRIES = 3
PATIENCE = 4.0
"""No handing over begins later after the first than so many of the first leads; with ``GROWTH`` two, the third
begins after three of them and a moment."""

CHUNKS_PER_TICK = 4
TICK_S = 0.02
"""So many chunks are sent every so often [s]."""
_SLOWNESS = 1.5
"""A busy computer hands over so much more slowly."""
_MARGIN_S = 1.0
_CHECK_S_PER_TICK = 1e-5
"""Between the last chunk and the start, for the hub to check the whole: 5e-7 s a tick on an idle computer."""


def first_lead(n_ticks: int, start_delay_s: float) -> float:
    """Return how far ahead the first start is [s]: as far as wanted, or as handing over and check take.

    Parameters
    ----------
    n_ticks : int
        Samples of the sequence, one for each tick of the device.
    start_delay_s : float
        Wanted [s].
    """
    handing_over_s = n_ticks / MAX_CHUNK_POINTS / CHUNKS_PER_TICK * TICK_S * _SLOWNESS
    return max(start_delay_s, handing_over_s + _MARGIN_S + n_ticks * _CHECK_S_PER_TICK)


def longest_wait(first_s: float) -> float:
    """Return how long it may take from the first handing over to the start, after every lead was too short [s]."""
    return sum(first_s * GROWTH**k for k in range(MAX_TRIES))


class StartLead:
    """The start leads of one request, one after another.

    Parameters
    ----------
    first_s : float
        From the first handing over to its start [s].
    begun_s : float
        Steady time of the first handing over [s].

    Attributes
    ----------
    lead_s : float
        From the present handing over to its start [s].
    tried : list of float
        Leads that were too short [s].
    """

    def __init__(self, first_s: float, begun_s: float) -> None:
        self.lead_s = first_s
        self.tried: list[float] = []
        self._until_s = begun_s + PATIENCE * first_s

    def lengthen(self, now_s: float) -> bool:
        """Take the next lead, because this one was too short; return False where it is too late for another.

        Parameters
        ----------
        now_s : float
            Steady time [s].
        """
        self.tried.append(self.lead_s)
        if len(self.tried) >= MAX_TRIES or now_s > self._until_s:
            return False
        self.lead_s *= GROWTH
        return True

    def history(self) -> str:
        """Say which leads were too short; empty where none was."""
        if not self.tried:
            return ""
        leads = " and ".join(f"{lead_s:.3g} s" for lead_s in self.tried)
        return f"a start {leads} after handing over came too soon for this computer"
