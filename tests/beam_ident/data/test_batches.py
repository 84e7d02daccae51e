from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from beam_ident import EstimationError
from beam_ident.data.batches import map_records
from beam_ident.transfer_function_estimation.order_selection import select_transfer_function
from tests.beam_ident.rao_garnier import benchmark_record

ROOT = Path(__file__).resolve().parents[3]


def square(number: int) -> int:
    if number < 0:
        raise ValueError("a negative number")
    return number * number


def place(number: int, shift: int) -> tuple[int, int]:
    return os.getpid(), number + shift


@pytest.mark.parametrize("n_workers", [1, 2])
def test_results_come_in_order_and_progress_ends_at_one(n_workers):
    seen = []
    found = map_records(square, range(6), n_workers, progress=lambda phrase, share: seen.append(share))
    assert found == [0, 1, 4, 9, 16, 25]
    assert seen == pytest.approx([k / 6 for k in range(1, 7)])


def test_other_processes_do_the_work():
    found = map_records(partial(place, shift=10), range(4), n_workers=2)
    assert [value for _, value in found] == [10, 11, 12, 13]
    assert os.getpid() not in {process for process, _ in found}


@pytest.mark.parametrize("n_workers", [1, 2])
def test_what_the_function_raises_comes_through(n_workers):
    with pytest.raises(ValueError, match="a negative number"):
        map_records(square, [1, -1, 2], n_workers)


def test_impossible_requests_are_refused():
    with pytest.raises(EstimationError, match="expected at least 1"):
        map_records(square, [1], n_workers=0)
    with pytest.raises(EstimationError, match="imported by its name"):
        map_records(lambda number: number, [1, 2], n_workers=2)


def test_without_the_package_a_cluster_is_refused_with_the_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(EstimationError, match="pip install distributed"):
        map_records(square, [1], scheduler="tcp://127.0.0.1:8786")


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """Start a real scheduler and a real worker as processes of their own; yield the address."""
    pytest.importorskip("distributed")
    room = tmp_path_factory.mktemp("dask")
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}

    def start(*arguments: str) -> subprocess.Popen[bytes]:
        log = (room / f"{arguments[0]}.log").open("wb")
        return subprocess.Popen(
            [sys.executable, "-m", "distributed.cli." + arguments[0], *arguments[1:]],
            cwd=room,
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
        )

    processes = [start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")]
    try:
        address = None
        deadline = time.monotonic() + 60.0
        while address is None and time.monotonic() < deadline:
            text = (room / "dask_scheduler.log").read_text()
            found = re.search(r"Scheduler at:\s*(tcp://\S+)", text)
            address = found.group(1) if found else None
            assert processes[0].poll() is None, text
            time.sleep(0.05)
        assert address is not None, "the scheduler named no address within 60 s"
        with pytest.raises(EstimationError, match="has no workers"):
            map_records(square, [1], scheduler=address)
        processes.append(start("dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"))
        while time.monotonic() < deadline:
            if "Registered to" in (room / "dask_worker.log").read_text():
                break
            time.sleep(0.05)
        yield address
    finally:
        for process in reversed(processes):
            process.terminate()
        for process in reversed(processes):
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()


@pytest.mark.slow
def test_a_cluster_does_the_same_work_elsewhere(scheduler):
    seen = []
    found = map_records(
        partial(place, shift=1),
        range(5),
        scheduler=scheduler,
        progress=lambda phrase, share: seen.append(share),
    )
    assert [value for _, value in found] == [1, 2, 3, 4, 5]
    assert os.getpid() not in {process for process, _ in found}
    assert seen[-1] == 1.0


@pytest.mark.slow
def test_orders_are_selected_on_a_cluster_as_at_home(scheduler):
    record = benchmark_record(1, 10.0)
    here = select_transfer_function(record, [3, 4], [1])
    there = select_transfer_function(record, [3, 4], [1], scheduler=scheduler)
    assert [e.bic for e in there.table] == pytest.approx([e.bic for e in here.table], rel=1e-9)
    assert there.chosen.model.n_poles == here.chosen.model.n_poles == 4


@pytest.mark.slow
def test_a_fault_on_the_cluster_comes_through(scheduler):
    with pytest.raises(ValueError, match="a negative number"):
        map_records(square, [1, -1], scheduler=scheduler)


@pytest.mark.slow
def test_an_address_where_nobody_listens_is_named(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("beam_ident.data.batches._CONNECTION_TIMEOUT_S", 1)
    with pytest.raises(EstimationError, match="no Dask scheduler answers at"):
        map_records(square, [1], scheduler="tcp://127.0.0.1:9")
