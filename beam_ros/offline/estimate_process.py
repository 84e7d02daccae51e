"""The estimate that grows in a process of its own, which lets everything else on the computer go first.

A fit takes the processor for seconds. In a process of its own, and a nice one, it delays no callback of the node and
takes no time that a recorder or a tracker wants. What is heard goes there through a queue that never blocks who puts.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.queues import Queue

from beam_ros.interfaces.rig_parameters import LiveSettings
from beam_ros.messages.live_identification import LiveIdentification
from beam_ros.offline.live_estimate import START, LiveEstimate, aims_asked

_SHORT_LIVED = {"MALLOC_MMAP_THRESHOLD_": "1000000"}
"""Arrays of more than a megabyte go back to the system when they are given up: fits of growing records make
larger ones every time, which would fit into no gap that an earlier one has left."""

Heard = tuple[str, bytes, int]


class EstimateProcess:
    """A ``LiveEstimate`` in a process of its own.

    Parameters
    ----------
    settings : LiveSettings

    Raises
    ------
    EstimationError
        The aims are no aims.
    """

    def __init__(self, settings: LiveSettings) -> None:
        aims_asked(settings)
        context = multiprocessing.get_context("spawn")
        self._heard: Queue[list[Heard] | None] = context.Queue()
        self._said: Queue[str] = context.Queue()
        self._newest = START
        self._process = context.Process(
            target=_estimate, args=(settings, self._heard, self._said), name="estimate", daemon=True
        )
        with _environment(_SHORT_LIVED):
            self._process.start()

    def hear(self, messages: list[Heard]) -> None:
        """Hand messages over: topic of the table, CDR bytes, and when each came [ns, UNIX]."""
        self._heard.put(messages)

    def newest(self) -> LiveIdentification:
        """Return what is known by now."""
        with contextlib.suppress(queue.Empty):
            while True:
                self._newest = LiveIdentification.from_json(self._said.get_nowait())
        if not self._process.is_alive() and self._newest.state != "failed":
            self._newest = replace(
                self._newest,
                state="failed",
                sentence=f"The process of the estimate ended with status {self._process.exitcode}: expected it to "
                "run as long as the node. Look at the node's log, and start the node again.",
            )
        return self._newest

    def close(self, patience_s: float = 2.0) -> None:
        """End the process; a fit that goes on for longer is broken off."""
        self._heard.put(None)
        self._process.join(patience_s)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        for own in (self._heard, self._said):
            own.cancel_join_thread()
            own.close()


@contextlib.contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Let processes that begin inside have further variables."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value


def _estimate(
    settings: LiveSettings, heard: Queue[list[Heard] | None], said: Queue[str], wait_s: float = 0.2
) -> None:
    """Hear, estimate and say, until nothing more comes or, as is seen after each wait, the node is gone."""
    for number in (signal.SIGINT, signal.SIGTERM):  # the node says when it is over
        signal.signal(number, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(settings.niceness)
    estimate, newest = LiveEstimate(settings), None
    parent = multiprocessing.parent_process()
    while parent is None or parent.is_alive():
        try:
            messages = heard.get(timeout=wait_s)
            while messages is not None:
                for message in messages:
                    estimate.hear(*message)
                messages = heard.get_nowait()
            return
        except queue.Empty:
            pass
        if (found := estimate.step()) != newest:
            newest = found
            said.put(found.to_json())
