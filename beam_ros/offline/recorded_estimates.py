"""What the growing estimate would have said while a bag was recorded, for the page over this bag.

The bag's messages go to the same ``LiveEstimate`` that hears a rig, in their order, and it is asked as often as the
rig's is. That takes longer than to play the bag, so a process of its own does it and lets everything else go first.
"""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.queues import Queue

from beam_ros.bags.reading import Bag
from beam_ros.errors import faults_of_the_user
from beam_ros.interfaces.graph import LIVE_NEEDS
from beam_ros.interfaces.rig_parameters import LiveSettings
from beam_ros.messages import SECOND_NS, LiveIdentification
from beam_ros.offline.live_estimate import START, LiveEstimate
from beam_ros.process.remote_paths import AnyPath

_Said = tuple[float, str]


def estimates_of_bag(
    path: AnyPath | str, settings: LiveSettings, *, namespace: str | None = None, step_s: float = 0.5
) -> Iterator[tuple[float, LiveIdentification]]:
    """Yield what the growing estimate says of a bag, with the time in the bag when it says it [s].

    Parameters
    ----------
    path : Path, RemotePath or str -- as ``Bag`` takes it
    settings : LiveSettings
    namespace : str, optional -- of the rig
    step_s : float -- how often the estimate is asked [s]
    """
    estimate = LiveEstimate(settings)
    try:
        with Bag(path, namespace=namespace) as bag:
            missing = [topic for topic in ("hub/measured", "beam/displacement") if not bag.count(topic)]
            if missing:
                sentence = (
                    f"This bag has nothing on {' and '.join(missing)}: nothing can be identified from it."
                )
                yield 0.0, replace(START, state="failed", sentence=sentence)
                return
            topics = {bag.full_name(topic): topic for topic in LIVE_NEEDS if bag.count(topic)}
            said, asked_s = START, 0.0
            for message in bag.raw_messages(*topics.values()):
                at_s = (message.receive_ns - bag.start_ns) / SECOND_NS
                estimate.hear(topics[message.topic], message.data, message.receive_ns)
                if at_s >= asked_s + step_s:
                    asked_s, before, said = at_s, said, estimate.step()
                    if said is not before:
                        yield at_s, said
            yield bag.duration_ns / SECOND_NS, estimate.step()
    finally:
        estimate.close()


class RecordedEstimates:
    """The estimates of a bag, as far as they are made.

    Parameters
    ----------
    path : Path, RemotePath or str -- as ``Bag`` takes it
    settings : LiveSettings
    namespace : str, optional -- of the rig
    """

    def __init__(self, path: AnyPath | str, settings: LiveSettings, namespace: str | None = None) -> None:
        self._times_s: list[float] = []
        self._estimates: list[LiveIdentification] = []
        context = multiprocessing.get_context("spawn")
        self._said: Queue[_Said] = context.Queue()
        self._process = context.Process(
            target=_estimate, args=(path, settings, namespace, self._said), name="estimates", daemon=True
        )
        self._process.start()

    def at(self, position_s: float) -> LiveIdentification | None:
        """Return what is known at a time of the bag; None before the first word."""
        while True:
            try:
                at_s, text = self._said.get_nowait()
            except queue.Empty:
                break
            self._times_s.append(at_s)
            self._estimates.append(LiveIdentification.from_json(text))
        k = bisect_right(self._times_s, position_s)
        return self._estimates[k - 1] if k else None

    def close(self) -> None:
        """End the process, whatever it does."""
        self._process.terminate()
        self._process.join()


def _estimate(path: AnyPath | str, settings: LiveSettings, namespace: str | None, said: Queue[_Said]) -> None:
    """Work through the bag; what is amiss with it is said as the estimate's last word."""
    # A Ctrl-C is the command's, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(10)
    at_s = 0.0
    try:
        for at_s, live in estimates_of_bag(path, settings, namespace=namespace):
            said.put((at_s, live.to_json()))
    except faults_of_the_user() as err:
        said.put((at_s, replace(START, state="failed", sentence=str(err)).to_json()))
