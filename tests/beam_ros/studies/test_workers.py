"""Workers that die cost the item that they had in hand, and nothing else."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from beam_ros.studies.workers import MOST_DEATHS, on_cluster, on_cores


def square(number: int) -> int:
    return number * number


def die_at_seven(number: int) -> int:
    if number == 7:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.01)
    return number


def die_once(path: Path) -> str:
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name


def test_every_item_has_its_result() -> None:
    assert dict(on_cores(square, range(20), 2)) == {number: number**2 for number in range(20)}


@pytest.mark.slow
def test_what_kills_its_worker_again_and_again_is_given_up_and_nothing_else() -> None:
    found = dict(on_cores(die_at_seven, range(20), 2))
    assert found == {number: None if number == 7 else number for number in range(20)}
    assert MOST_DEATHS > 1


@pytest.mark.slow
def test_what_was_under_way_when_a_worker_was_killed_is_done_again(tmp_path: Path) -> None:
    paths = [tmp_path / str(number) for number in range(3)]
    assert dict(on_cores(die_once, paths, 2)) == {path: path.name for path in paths}


@pytest.mark.verify
def test_a_cluster_does_the_same_work_and_gives_up_the_same_item() -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        found = dict(on_cluster(die_at_seven, range(5, 9), cluster.scheduler_address))
    assert found == {5: 5, 6: 6, 7: None, 8: 8}
