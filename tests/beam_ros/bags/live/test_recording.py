"""A recording's own thread: nothing waits for the disk, nothing is lost unsaid, a full disk is survived."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.stream_reader import StreamReader

from beam_ros.bags.batches import encode_batch
from beam_ros.bags.errors import BagError
from beam_ros.bags.live import recording as recording_module
from beam_ros.bags.live.recording import LossCounter, Recording
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import FileLimits
from beam_ros.interfaces import graph
from beam_ros.offline.recovery import recover
from tests.beam_ros.bags.small_bags import BATCH, START, batch

pytestmark = pytest.mark.slow

TOPIC = graph.TOPICS["hub/measured"]


def _announce(recording):
    recording.announce("/hub/measured", TOPIC.type_name, (TOPIC.qos,))


def _put(recording, k):
    now = START + k * 20_000_000
    recording.put("/hub/measured", now, now - 1000, encode_batch(batch(k)))


def test_what_was_handed_over_is_in_the_bag(tmp_path):
    recording = Recording(tmp_path / "run")
    _announce(recording)
    for k in range(200):
        _put(recording, k)
    recording.stop()
    assert recording.message_count == 200
    assert recording.dropped == 0
    with Bag(tmp_path / "run") as bag:
        assert len(bag.hub_samples().stamps_ns) == 200 * BATCH


def test_the_last_message_before_a_silence_reaches_the_file_within_a_second(tmp_path):
    recording = Recording(tmp_path / "run")
    _announce(recording)
    _put(recording, 0)
    time.sleep(0.95)
    saved = []
    # The file has no end yet, so its records end in an exception.
    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream, contextlib.suppress(McapError):
        for record in StreamReader(stream).records:
            saved.append(type(record).__name__)
    assert saved.count("Message") == 1
    recording.stop()


def test_what_the_disk_cannot_follow_is_dropped_and_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(recording_module, "MAX_WAITING_BYTES", 2000)
    recording = Recording(tmp_path / "run")
    _announce(recording)
    recording.put("/hub/measured", START, START, bytes(2001))
    _put(recording, 0)
    recording.stop()
    assert recording.dropped == 1
    assert recording.message_count == 1


_FULL_DISK = """
import resource, sys, time
from beam_ros.bags.errors import BagError
from beam_ros.bags.live.recording import Recording
from beam_ros.bags.recording_mark import is_being_written, is_marked
from tests.beam_ros.bags.live.test_recording import _announce, _put

resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
recording = Recording(__import__("pathlib").Path(sys.argv[1]))
_announce(recording)
for k in range(1000):
    _put(recording, k)
end = time.monotonic() + 10
while not recording.failure and time.monotonic() < end:
    time.sleep(0.01)
_put(recording, 1000)
assert recording.dropped >= 1
try:
    recording.stop()
except BagError as err:
    print(err)
assert is_marked(recording.path) and not is_being_written(recording.path)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit on the size of files")
def test_a_full_disk_is_said_and_leaves_a_recoverable_bag(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[4])}
    result = subprocess.run(
        [sys.executable, "-c", _FULL_DISK, str(tmp_path / "run")],
        capture_output=True,
        text=True,
        timeout=60,
        env=environment,
    )
    assert result.returncode == 0, result.stderr
    assert "cannot write bag" in result.stdout
    report = recover(tmp_path / "run")
    assert report.message_count > 50
    with Bag(report.target) as bag:
        assert not bag.hub_samples().gaps


def test_a_recording_ends_as_a_whole_bag_before_the_disk_is_full(tmp_path):
    limits = FileLimits(duration_ns=200_000_000)
    recording = Recording(tmp_path / "run", limits=limits, min_free=1)
    _announce(recording)
    for k in range(100):
        _put(recording, k)
    while recording.message_count < 100:  # the writer has its own time
        time.sleep(0.01)
    recording._min_free = 10**18  # as if others had filled the disk meanwhile
    k = 100
    while not recording.failure:
        _put(recording, k)
        time.sleep(0.01)
        k += 1
    _put(recording, k)
    assert "before the disk is full" in recording.failure
    with pytest.raises(BagError, match="make space"):
        recording.stop()
    assert recording.dropped > 0  # what came later is counted
    with Bag(tmp_path / "run") as bag:
        n_samples = len(bag.hub_samples().stamps_ns)
        assert not list(bag.damage())
    assert n_samples == recording.message_count * BATCH >= 100 * BATCH


def test_losses_are_the_missing_numbers_of_an_only_publisher():
    counter = LossCounter()
    for number in (17, 18, 21, 22, None, 24):
        counter.see(number)
    assert counter.lost == 2 + 1
    counter.see(1)  # the publisher began anew
    counter.see(2)
    assert counter.lost == 3
    counter.forget()  # several publishers
    counter.see(900)
    assert counter.lost == 3
