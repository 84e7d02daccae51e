"""Writing to a real pseudo-terminal: what it takes, what it does not take, and what a frozen process makes of it."""

from __future__ import annotations

import itertools
import os
import random
import select
import signal
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from beam_ros.hub.errors import HubConnectionError
from beam_ros.hub.faults import fault
from beam_ros.hub.line import transport
from beam_ros.hub.line.transport import WRITE_TIMEOUT_S, SerialTransport

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[4]
FREEZES = 30
FREEZE_TIMEOUT_S = 0.02
ROUND = 2000
"""So many bytes fit into a pseudo-terminal that nobody reads: no write of a round has to wait."""
WRITING = f"""
import sys
from beam_ros.hub.line import transport
transport.WRITE_TIMEOUT_S = {FREEZE_TIMEOUT_S}
port = transport.SerialTransport(sys.argv[1], 921_600, 10**9)
port.open()
print("open", flush=True)
while True:
    for _ in range({ROUND}):
        port.write(b"x")
    while not port.read(1.0)[0]:
        pass
"""


@pytest.fixture
def pair() -> Iterator[tuple[int, str]]:
    """Give the far end of a pseudo-terminal, which does not block, and the path of its port."""
    far, near = os.openpty()
    tty.setraw(near)
    os.set_blocking(far, False)
    yield far, os.ttyname(near)
    os.close(near)
    os.close(far)


@pytest.fixture
def opened() -> Iterator[Any]:
    ports = []

    def open_port(port: str) -> SerialTransport:
        ports.append(SerialTransport(port, 921_600, 10**9))
        ports[-1].open()
        return ports[-1]

    yield open_port
    for port in ports:
        port.dispose()


def _drain(far: int, n_bytes: int, at_once: int = 65_536) -> bytes:
    """Read from the far end until so many bytes have come, or nothing more comes for a long time."""
    data = b""
    while len(data) < n_bytes and select.select([far], [], [], 20.0)[0]:
        data += os.read(far, at_once)
    return data


def test_a_process_that_is_frozen_while_it_writes_keeps_its_port(pair) -> None:
    far, port = pair
    rng = random.Random(5)
    child = subprocess.Popen(
        [sys.executable, "-c", WRITING, port],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    n_read = 0

    def read_for(seconds: float) -> None:
        """Take what the child wrote, and tell it of each whole round."""
        nonlocal n_read
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            if select.select([far], [], [], left)[0]:
                before, n_read = n_read, n_read + len(os.read(far, 65_536))
                if n_read // ROUND > before // ROUND:
                    os.write(far, b"!")

    try:
        assert child.stdout is not None
        assert select.select([child.stdout], [], [], 20.0)[0]
        assert child.stdout.readline() == "open\n"
        for n_freezes in range(FREEZES):
            read_for(rng.uniform(1e-3, 10e-3))
            assert child.poll() is None, f"after {n_freezes} freezes: {child.communicate(timeout=5.0)[1]}"
            child.send_signal(signal.SIGSTOP)
            os.waitpid(child.pid, os.WUNTRACED)
            time.sleep(2.0 * FREEZE_TIMEOUT_S)
            child.send_signal(signal.SIGCONT)
        before = n_read
        read_for(0.1)
        assert n_read > before
    finally:
        child.kill()
        child.communicate(timeout=5.0)


def test_a_process_that_is_frozen_once_all_was_taken_keeps_its_port(pair, opened, monkeypatch) -> None:
    """The same without chance: the time-out is over when the system's ``write`` returns."""
    far, port = pair
    near = opened(port)
    write = os.write

    def frozen_write(descriptor: int, data: bytes) -> int:
        n = write(descriptor, data)
        time.sleep(1.2 * WRITE_TIMEOUT_S)
        return n

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", frozen_write)
        near.write(b"hello")
    assert _drain(far, 5) == b"hello"


def test_a_process_that_is_frozen_while_the_port_is_full_has_its_time_afterwards(
    pair, opened, monkeypatch
) -> None:
    far, port = pair
    near = opened(port)
    data = random.Random(6).randbytes(200_000)
    heard: list[bytes] = []
    # Small bites, so that one look after the freeze does not find room for all that is left.
    drain = threading.Thread(target=lambda: heard.append(_drain(far, len(data), 1000)), daemon=True)

    class FreezingSelect:
        """Freezes the process in its first wait; the port is read only afterwards."""

        @staticmethod
        def select(*arguments: Any) -> Any:
            if not drain.is_alive():
                time.sleep(1.2 * WRITE_TIMEOUT_S)
                drain.start()
                return [], [], []
            return select.select(*arguments)

    monkeypatch.setattr(transport, "select", FreezingSelect)
    near.write(data)
    drain.join(60.0)
    assert heard == [data]


def test_a_port_that_has_room_after_the_last_wait_is_asked_once_more(pair, opened, monkeypatch) -> None:
    far, port = pair
    near = opened(port)
    write, waits = os.write, []

    class Select:
        @staticmethod
        def select(_read: Any, _write: Any, _failed: Any, timeout_s: float) -> Any:
            time.sleep(timeout_s)
            waits.append(timeout_s)
            return [], [], []

    def late_write(descriptor: int, data: bytes) -> int:
        if sum(waits) < WRITE_TIMEOUT_S:
            raise BlockingIOError
        return write(descriptor, data)

    with monkeypatch.context() as patched:
        patched.setattr(transport, "select", Select)
        patched.setattr(os, "write", late_write)
        near.write(b"hello")
    assert _drain(far, 5) == b"hello"


def test_a_port_that_promises_room_and_has_none_is_given_up_in_time(pair, opened, monkeypatch) -> None:
    near = opened(pair[1])
    answers = itertools.cycle((0, BlockingIOError()))

    def full_write(_descriptor: int, _data: bytes) -> int:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    begin = time.monotonic()
    with monkeypatch.context() as patched:
        patched.setattr(os, "write", full_write)
        with pytest.raises(
            HubConnectionError, match=r"was lost: it took 0 of 5 bytes within 0\.25 s; expected"
        ):
            near.write(b"hello")
    assert time.monotonic() - begin >= WRITE_TIMEOUT_S


def test_what_a_port_takes_in_parts_arrives_whole_and_in_order(pair, opened) -> None:
    far, port = pair
    near = opened(port)
    data = random.Random(7).randbytes(500_000)
    heard: list[bytes] = []
    drain = threading.Thread(target=lambda: heard.append(_drain(far, len(data))), daemon=True)
    drain.start()
    near.write(data)
    drain.join(60.0)
    assert heard == [data]


def test_a_port_that_takes_nothing_is_given_up_in_time_with_what_it_took(pair, opened) -> None:
    _, port = pair
    near = opened(port)
    begin = time.monotonic()
    with pytest.raises(
        HubConnectionError, match=r"it took \d+ of 500000 bytes within 0\.25 s; .*check"
    ) as caught:
        near.write(bytes(500_000))
    assert caught.value.fault is fault("port_lost")
    assert time.monotonic() - begin >= WRITE_TIMEOUT_S


def test_a_port_that_vanishes_is_lost_with_the_systems_reason(opened) -> None:
    far, near_end = os.openpty()
    tty.setraw(near_end)
    near = opened(os.ttyname(near_end))
    os.close(near_end)
    os.close(far)
    with pytest.raises(HubConnectionError, match=r"was lost: .*Input/output error; expected") as caught:
        near.write(b"hello")
    assert caught.value.fault is fault("port_lost")
    near.close()
    with pytest.raises(HubConnectionError, match="was lost"):
        near.write(b"hello")


def test_a_port_that_is_more_than_a_device_keeps_its_own_way_to_write(pair, opened, tmp_path: Path) -> None:
    far, port = pair
    spied = tmp_path / "spied"
    near = opened(f"spy://{port}?file={spied}")
    near.write(b"hello")
    near.close()
    assert _drain(far, 5) == b"hello"
    assert "TX   0000  68 65 6C 6C 6F" in spied.read_text()
    loop = opened("loop://")
    loop.write(b"hello")
    assert loop.read(0.1)[0] == b"hello"


def test_what_comes_behind_the_look_at_the_clock_is_not_read_with_it(pair, opened, monkeypatch) -> None:
    """A process is put aside there: what came meanwhile would pass for older than it is, and bend the clock's map."""
    far, port = pair
    near = opened(port)
    os.write(far, b"early")
    clock = time.monotonic_ns

    def look_and_be_put_aside() -> int:
        now_ns = clock()
        os.write(far, b"late")
        while near._serial.in_waiting < len(b"earlylate"):
            time.sleep(1e-3)
        return now_ns

    with monkeypatch.context() as patched:
        patched.setattr(transport.time, "monotonic_ns", look_and_be_put_aside)
        assert near.read(1.0)[0] == b"early"
    assert near.read(1.0)[0] == b"late"
