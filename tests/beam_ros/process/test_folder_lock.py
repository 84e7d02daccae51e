"""One process in a folder: a second is refused with the first one's number, and a dead one holds nobody up."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from beam_ros.errors import UsageError
from beam_ros.process.folder_lock import LOCK_NAME, FolderLock

_HOLDER = """
import sys, time
from pathlib import Path
from beam_ros.process.folder_lock import FolderLock
lock = FolderLock(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", _HOLDER, str(tmp_path)],
        cwd=Path(__file__).parents[3],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait(10.0)
    process.stdout.close()


def test_a_second_process_is_refused_with_the_number_of_the_first(
    holder: subprocess.Popen[str], tmp_path: Path
) -> None:
    for _ in range(2):
        with pytest.raises(UsageError, match=rf"process {holder.pid} on .* is at work there.*another --out"):
            FolderLock(tmp_path)


def test_the_lock_of_a_process_that_was_killed_is_taken_over(
    holder: subprocess.Popen[str], tmp_path: Path
) -> None:
    holder.kill()
    holder.wait(10.0)
    assert str(holder.pid) in (tmp_path / LOCK_NAME).read_text()
    with FolderLock(tmp_path):
        assert str(holder.pid) not in (tmp_path / LOCK_NAME).read_text()
    assert list(tmp_path.iterdir()) == []


def test_what_is_given_back_can_be_taken_again(tmp_path: Path) -> None:
    first = FolderLock(tmp_path)
    first.release()
    with FolderLock(tmp_path):
        first.release()
        with pytest.raises(UsageError, match="at work there"):
            FolderLock(tmp_path)


def test_a_folder_that_is_not_there_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no lock can be made there"):
        FolderLock(tmp_path / "nothing")
