"""Questions and answers over an open port, one at a time, each with the times at which it left and came."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from beam_ros.hub.errors import HubProtocolError

ANSWER_S = 0.1
"""An answer that has not come by then does not come."""
MAX_ANSWER = 256
"""More bytes without an answer in them are noise."""

TakeAnswer = Callable[[bytes], "tuple[bytes, bytes] | None"]
"""From what has come to the first whole answer and the rest; None while there is none."""


class Line(Protocol):
    """An open port."""

    def write(self, data: bytes) -> None:
        """Send bytes."""

    def read(self, timeout_s: float) -> tuple[bytes, int]:
        """Wait for bytes; return them, and the steady time at which they came [ns]."""


class SteadyTime:
    """The steady clock, and waits by it, which end at once when the link is closed."""

    def __init__(self) -> None:
        self._ending = threading.Event()

    @property
    def is_over(self) -> bool:
        """Whether the link is closed."""
        return self._ending.is_set()

    def end(self) -> None:
        """Wait no more."""
        self._ending.set()

    def now_ns(self) -> int:
        """Return the steady time [ns]."""
        return time.monotonic_ns()

    def wait(self, seconds: float) -> None:
        """Wait [s]."""
        self._ending.wait(seconds)


class UnreadableAnswerError(HubProtocolError):
    """An answer that came whole and is not what was asked for: the device is not silent."""


@dataclass(frozen=True)
class Answer:
    """An answer as it came.

    Parameters
    ----------
    data : bytes
        The answer.
    sent_ns, came_ns : int
        Steady times of question and answer [ns].
    """

    data: bytes
    sent_ns: int
    came_ns: int


class QueryLine:
    """One controller on a line.

    Parameters
    ----------
    line : Line
        The port.
    steady : SteadyTime, optional
        The clock.

    Attributes
    ----------
    steady : SteadyTime
        The clock.
    """

    def __init__(self, line: Line, steady: SteadyTime | None = None) -> None:
        self._line = line
        self.steady = steady or SteadyTime()

    def tell(self, data: bytes) -> None:
        """Send what has no answer."""
        self._line.write(data)

    def ask(self, question: bytes, name: str, take: TakeAnswer) -> Answer:
        """Send a question and wait for its answer.

        Parameters
        ----------
        question : bytes
            As it goes over the line.
        name : str
            For messages.
        take : callable
            Finds the answer in the bytes that come.

        Raises
        ------
        HubProtocolError
            No answer, or a spoilt one.
        HubConnectionError
            The port vanished.
        """
        sent_ns = self.steady.now_ns()
        self._line.write(question)
        end_ns = sent_ns + round(ANSWER_S * 1e9)
        heard, taken, came_ns, is_over = b"", None, sent_ns, False
        while taken is None:
            if is_over or len(heard) > MAX_ANSWER:
                self.drain()
                raise HubProtocolError(
                    f"no answer to {name!r} within {ANSWER_S:g} s: expected one; check the cable and serial.baud"
                )
            # An answer that came while this process was frozen is there, although the time is over.
            left_s = (end_ns - self.steady.now_ns()) * 1e-9
            is_over = left_s <= 0.0
            data, came_ns = self._line.read(max(0.0, left_s))
            heard += data
            taken = take(heard)
        if taken[1]:
            self.drain()
        return Answer(taken[0], sent_ns, came_ns)

    def drain(self) -> None:
        """Throw away what still comes of earlier answers."""
        end_ns = self.steady.now_ns() + round(ANSWER_S * 1e9)
        while self.steady.now_ns() < end_ns:
            if not self._line.read(0.01)[0]:
                return
