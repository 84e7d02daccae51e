"""Work on other processes that may die: on this machine's cores, or on a Dask cluster.

A worker that is killed, or that a damaged file takes down, costs the item that it had in hand and nothing else:
what was under way when a pool broke is tried again alone, and given up after some deaths.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from beam_ident.data.batches import cluster

Work = TypeVar("Work")
Result = TypeVar("Result")

MOST_DEATHS = 3
"""How often a worker may die over an item until that is given up."""


def on_cores(
    function: Callable[[Work], Result], items: Sequence[Work], n_workers: int
) -> Iterator[tuple[Work, Result | None]]:
    """Yield every item with its result, as they come; None where its worker died again and again.

    Parameters
    ----------
    function : callable -- of a module, so that another process can import it
    items : sequence
    n_workers : int -- processes

    Notes
    -----
    Of several items under way when a worker dies nobody knows which one it was. All of them are tried again, one by
    one: a death then has one cause.
    """
    fresh, suspects = deque(range(len(items))), deque[int]()
    deaths = [0] * len(items)
    while fresh or suspects:
        is_alone = not fresh
        queue, width = (suspects, 1) if is_alone else (fresh, n_workers)
        under_way: dict[Future[Result], int] = {}
        # A new interpreter for each worker: a fork would take threads and locks of this one along.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(width, mp_context=context, initializer=_end_with_the_study)
        try:
            while queue or under_way:
                while queue and len(under_way) < width:
                    number = queue[0]
                    under_way[pool.submit(function, items[number])] = number
                    queue.popleft()
                for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield items[under_way.pop(future)], result
        except BrokenProcessPool:
            for number in under_way.values():
                deaths[number] += is_alone
                if deaths[number] == MOST_DEATHS:
                    yield items[number], None
                else:
                    suspects.append(number)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def on_cluster(
    function: Callable[[Work], Result], items: Sequence[Work], scheduler: str
) -> Iterator[tuple[Work, Result | None]]:
    """Yield every item with its result, as a Dask cluster gives them; None where its workers died again and again.

    Parameters
    ----------
    function, items : as for ``on_cores``
    scheduler : str -- address of the Dask scheduler; it counts the deaths itself

    Raises
    ------
    EstimationError
        No ``distributed`` package, no scheduler there, or no workers.
    """
    with cluster(scheduler) as client:
        from distributed import KilledWorker, as_completed

        futures = client.map(function, items, pure=False)
        items_of = {future.key: item for future, item in zip(futures, items, strict=True)}
        blamed = []
        for future in as_completed(futures, loop=client.loop):
            try:
                yield items_of[future.key], future.result()
            except KilledWorker:
                blamed.append(items_of[future.key])
        # The scheduler counts a death for all that the worker had in hand: alone, an item has its own deaths only.
        for item in blamed:
            try:
                yield item, client.submit(function, item, pure=False).result()
            except KilledWorker:
                yield item, None


def _end_with_the_study() -> None:
    """Let Ctrl-C and SIGTERM end a worker at once and in silence, and the death of the study's own process as well.

    The bag that it has in hand is done again when the study goes on.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent.join,), name="study", daemon=True).start()


def _follow(join: Callable[[], None]) -> None:
    join()
    os._exit(1)
