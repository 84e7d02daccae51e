"""One function over many records: in this process, over the machine's cores, or on a Dask cluster.

Order selection, Monte-Carlo studies and batches of experiments all are the same loop.  The
cluster is an address and nothing else: ``distributed`` is imported when one is given, and
the workers need this package as well.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from beam_ident.errors import EstimationError

Progress = Callable[[str, float], None]

Item = TypeVar("Item")
Result = TypeVar("Result")

_CONNECTION_TIMEOUT_S = 10


def map_records(
    function: Callable[[Item], Result],
    records: Iterable[Item],
    n_workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> list[Result]:
    """Apply a function to every record (or seed, or file name) and return the results in their order.

    Parameters
    ----------
    function : callable
        Of one argument.  For several processes it must be importable by name: a function of a
        module, or a ``functools.partial`` of one, no lambda.
    records : iterable -- the arguments, each of which can be pickled
    n_workers : int -- processes on this machine; 1 stays in this one
    scheduler : str or None
        Address of a Dask scheduler, such as ``tcp://192.168.1.5:8786``; its workers do all the
        work then, and ``n_workers`` is not looked at.
    progress : callable or None -- called with a phrase and the share done as results come in

    Raises
    ------
    EstimationError
        No worker, a function that other processes cannot import, no ``distributed`` package, or no
        scheduler at the address.  What the function raises comes through unchanged.
    """
    items = list(records)
    if n_workers < 1:
        raise EstimationError(f"n_workers is {n_workers}; expected at least 1")
    if scheduler is not None:
        return _on_cluster(function, items, scheduler, progress)
    if n_workers == 1 or len(items) < 2:
        results = []
        for done, item in enumerate(items):
            results.append(function(item))
            _tell(progress, done + 1, len(items))
        return results
    try:
        pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError) as err:
        raise EstimationError(
            f"{function!r} cannot be handed to other processes ({err}); expected a function that can be imported "
            "by its name, or n_workers=1"
        ) from err
    from concurrent.futures import ProcessPoolExecutor, as_completed  # here: most fits need no other process

    with ProcessPoolExecutor(min(n_workers, len(items))) as pool:
        futures = [pool.submit(function, item) for item in items]
        try:
            for done, future in enumerate(as_completed(futures)):
                future.result()  # raises what the function raised, at once
                _tell(progress, done + 1, len(items))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [future.result() for future in futures]


@contextmanager
def cluster(scheduler: str) -> Iterator[Any]:
    """Connect to a Dask cluster for the length of a block.

    Parameters
    ----------
    scheduler : str -- its address, such as ``tcp://192.168.1.5:8786``

    Yields
    ------
    distributed.Client

    Raises
    ------
    EstimationError
        No ``distributed`` package, no scheduler at the address, or no worker.
    """
    try:
        import distributed
    except ImportError as err:
        raise EstimationError(
            f"scheduler is {scheduler!r} and the package `distributed` is not installed; "
            "`pip install distributed` (or the extra `dask` of this suite) brings it"
        ) from err
    try:
        client = distributed.Client(scheduler, timeout=_CONNECTION_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as err:
        raise EstimationError(
            f"no Dask scheduler answers at {scheduler!r} within {_CONNECTION_TIMEOUT_S} s ({err}); expected an "
            "address like tcp://host:8786 of a running `dask scheduler`"
        ) from err
    with client:
        if not client.scheduler_info()["workers"]:
            raise EstimationError(
                f"the Dask scheduler at {scheduler!r} has no workers; start some with `dask worker {scheduler}`"
            )
        yield client


def _on_cluster(
    function: Callable[[Item], Result], items: list[Item], scheduler: str, progress: Progress | None
) -> list[Result]:
    with cluster(scheduler) as client:
        import distributed

        futures = client.map(function, items, pure=False)
        for done, future in enumerate(distributed.as_completed(futures, loop=client.loop)):
            future.result()
            _tell(progress, done + 1, len(items))
        return [future.result() for future in futures]


def _tell(progress: Progress | None, done: int, total: int) -> None:
    if progress is not None:
        progress(f"{done} of {total}", done / total)
