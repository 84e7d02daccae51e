"""What Ctrl-C and SIGTERM do to a process, from its first line to its last.

An exception in the middle of an import is no way to end: extension modules turn ``KeyboardInterrupt`` into errors of
their own, and half-imported packages fail in odd places afterwards. While there is nothing yet to stop, a signal
therefore ends the process at once and silently; while there is, it interrupts; and a process that is ending already
is left alone.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

Handler = Callable[[int, FrameType | None], object] | signal.Handlers

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def end_with(status: int) -> Handler:
    """Return a handler that ends the process at once with an exit status."""

    def leave(_number: int, _frame: FrameType | None) -> None:
        os._exit(status)

    return leave


def interrupt(_number: int, _frame: FrameType | None) -> None:
    """Raise ``KeyboardInterrupt``, for SIGTERM as for SIGINT."""
    raise KeyboardInterrupt


def hold_signals_back() -> None:
    """Let the signals wait until ``take_signals``, also in a program that is executed in this one's place."""
    if hasattr(signal, "pthread_sigmask"):  # not on Windows
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)


def take_signals(handler: Handler) -> None:
    """Handle SIGINT and SIGTERM from now on, and those that were held back; what is ignored stays so.

    A parent holds them back so that none meets an interpreter that only starts.
    """
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)
    if hasattr(signal, "pthread_sigmask"):  # not on Windows
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


@contextmanager
def signals_taken(handler: Handler) -> Iterator[None]:
    """Handle SIGINT and SIGTERM within this block; afterwards they are handled as before."""
    previous = {number: signal.getsignal(number) for number in SIGNALS}
    take_signals(handler)
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)


@contextmanager
def whole_or_interrupted() -> Iterator[None]:
    """End this block with ``KeyboardInterrupt`` where a signal came within it, also where that was caught.

    A fit that is interrupted returns what it has found, for a person who waits; what is kept as the result of a step
    must not be cut short.
    """
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)
        interrupt(number, frame)

    with signals_taken(note):
        yield
    if came:
        raise KeyboardInterrupt
