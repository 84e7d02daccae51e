"""An order to stop as a promise: at rest within the ramp from the present speed and 0.3 s, by what is measured."""

from __future__ import annotations

REST_NS = 300_000_000
"""A stop has acted, and is seen to have acted, within this time and that of the ramp: 50 ms of rest, the batches that
show it, and a line on which half of the frames are lost."""
UNANSWERED_NS = 1_000_000_000
"""A stop of an axis that rests has been answered by then; one that moves takes the time of its ramp."""
GONE_NS = 250_000_000
"""What was not seen for so long is gone."""


class StopPromise:
    """One order to stop, from the moment when it is given until it has acted or is broken.

    Parameters
    ----------
    must_rest : bool
        Whether the axis was led when the order was given; a hub whose drive is off may be pushed by hand.
    is_over : bool
        Whether the controller said, before the order, that nothing moves the axis.
    """

    def __init__(self, *, must_rest: bool, is_over: bool) -> None:
        self._must_rest = must_rest
        self._is_over = is_over
        self._said_ns: int | None = None
        self._rest_by_ns = 0
        self._is_answered = False
        self._is_contradicted = False

    def say(self, now_ns: int, ramp_s: float) -> None:
        """Note that the order leaves now [ns of waking time], and what its ramp takes; repeated, it gains no time."""
        if self._said_ns is None:
            self._said_ns, self._rest_by_ns = now_ns, now_ns + round(1e9 * ramp_s) + REST_NS

    def answer(self, *, is_over: bool) -> None:
        """Note that the controller says that it has stopped; ``is_over``: and that nothing moves the axis now."""
        self._is_answered = True
        self._is_over |= is_over

    def note_status(self, now_ns: int, *, is_over: bool) -> None:
        """Note whether the controller says that nothing moves the axis any more."""
        self._is_over = is_over
        is_late = self._said_ns is not None and now_ns > self._rest_by_ns
        self._is_contradicted = is_late and self._is_answered and not is_over

    def has_acted(self, *, is_moving: bool, status_age_ns: int) -> bool:
        """Return whether the controller says that it has stopped, and nothing that is seen says otherwise.

        Parameters
        ----------
        is_moving : bool
            Whether the hub is seen to move.
        status_age_ns : int
            How long ago the controller said where it stands [ns].
        """
        if not self._is_answered or (self._must_rest and is_moving):
            return False
        return self._is_over or status_age_ns >= GONE_NS

    def broken(self, now_ns: int, *, is_moving: bool, speed: float) -> str:
        """Return what the axis did instead of stopping in time; empty while that is not certain.

        Parameters
        ----------
        now_ns : int
            Waking time [ns].
        is_moving : bool
            Whether the hub is seen to move, with ``speed`` [m/s].
        """
        if self._said_ns is None:
            return ""
        if now_ns > self._rest_by_ns and self._must_rest and is_moving:
            seen = f"it moves with {speed:.3g} m/s"
        elif self._is_contradicted:
            seen = "the controller says that it is stopped, and that it is enabled or at work"
        elif now_ns > max(self._said_ns + UNANSWERED_NS, self._rest_by_ns):
            seen = "the controller did not answer"
        else:
            return ""
        waited_s = (now_ns - self._said_ns) * 1e-9
        return f"the axis did not come to rest within {waited_s:.2f} s after it was asked to: {seen}"
