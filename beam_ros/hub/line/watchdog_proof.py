"""The proof of a device's watchdog: a silence on purpose, at rest, that the device must notice in time."""

from __future__ import annotations

from beam_ros.hub.line import protocol
from beam_ros.hub.parameters import AxisParameters

PROOF_TRIALS = 3
"""A busy host may miss when the silence began; a device that has no watchdog misses every time."""
PROOF_SLACK_NS = 100_000_000
"""What the way of the last frame and of the status may add to the watchdog's time."""


class WatchdogProof:
    """What is known of the device's watchdog.

    Parameters
    ----------
    parameters : AxisParameters
        The watchdog's time, the tick, and how often telemetry comes.

    Attributes
    ----------
    is_at_rest : bool
        Whether the device says that it rests, so that a silence harms nobody.
    """

    def __init__(self, parameters: AxisParameters) -> None:
        self.is_at_rest = False
        self._watchdog_ns = protocol.DeviceLimits.of(parameters).watchdog_ns
        self._period_ns, self._batch_ns = parameters.period_ns, parameters.batch_ns
        self._newest = (0, 0)
        self._began_with = (0, 0)
        self._began_ns: int | None = None
        self._n_trials = 0

    def restart(self) -> None:
        """Begin with another session: nothing is proved."""
        self.is_at_rest = False
        self._n_trials = 0
        self.give_up()

    def give_up(self) -> None:
        """Speak again, whatever the device notices."""
        self._began_ns = None

    @property
    def is_silent(self) -> bool:
        """Whether the host says nothing now, to see whether the device notices."""
        return self._began_ns is not None

    def patience_ns(self, round_trip_ns: int) -> int:
        """Return how long a device is given that does not notice the silence, on a line of this round trip [ns]."""
        return 2 * self._watchdog_ns + PROOF_SLACK_NS + round_trip_ns

    def longest_ns(self, round_trip_ns: int) -> int:
        """Return how long all trials take at the most [ns]."""
        return PROOF_TRIALS * self.patience_ns(round_trip_ns)

    def begin(self, now_ns: int) -> bool:
        """Be silent from now on [ns]; return whether a last word is to be said before."""
        if self.is_silent or not self.is_at_rest:
            return False
        self._began_ns, self._began_with = now_ns, self._newest
        return True

    def note_status(self, status: protocol.Status) -> int | None:
        """Take a status; return the silence after which the device noticed it [ns], where it has."""
        self._newest = status.tick, status.silences
        self.is_at_rest = status.activity == "idle" and status.state != "enabled"
        tick, silences = self._began_with
        if self.is_silent and status.silences != silences:
            return (status.silence_tick - tick) * self._period_ns
        return None

    def overdue_ns(self, now_ns: int, round_trip_ns: int) -> int | None:
        """Return how long the host has been silent [ns], where a device with a watchdog would have noticed."""
        if self._began_ns is None or now_ns - self._began_ns <= self.patience_ns(round_trip_ns):
            return None
        return now_ns - self._began_ns

    def judge(self, elapsed_ns: int, round_trip_ns: int) -> bool | None:
        """End the silence; return whether the watchdog is proved, or None where it is tried once more.

        Parameters
        ----------
        elapsed_ns : int
            The silence that was noticed, or in which nothing was [ns].
        round_trip_ns : int
            Of the line, which lies between the newest tick that the host knew and the last word's arrival [ns].
        """
        self.give_up()
        if 0 <= elapsed_ns <= self._watchdog_ns + 2 * self._batch_ns + PROOF_SLACK_NS + round_trip_ns:
            return True
        self._n_trials += 1
        return False if self._n_trials >= PROOF_TRIALS else None
