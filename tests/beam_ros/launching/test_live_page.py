"""A simulated rig watched by five browsers: curves move, the recorder loses nothing, a click stops the axis."""

from __future__ import annotations

import contextlib
import signal
import socket
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beam_ros.bags.reading import Bag
from beam_ros.bags.summary import summarise
from beam_ros.rig.rig import Rig
from tests.beam_ros.view.test_page import opened, until
from tests.beam_ros.view.test_server import UPGRADE
from tests.browser import open_browser
from tests.graph import HANG_S

pytestmark = [pytest.mark.verify, pytest.mark.ros]
pytest.importorskip("rclpy")

READERS = 5


WATCHED = ("-p", "simulation.images:=false", "-p", "excitation.duration:=30.0")


def watched(executables: Any, bag: Path) -> tuple[Any, str]:
    """Start a rig that records and shows itself; returns it and the page's address."""
    words = ("beam", "up", "--rig", "simulated", "--view", "--port", "0", "--record", str(bag), *WATCHED)
    up = executables.start(*words, timeout_s=300.0)
    output = up.wait_for("Ctrl-C ends it", HANG_S)
    return up, next(line.removeprefix("page: ") for line in output.splitlines() if line.startswith("page: "))


def assert_whole(bag: Path) -> None:
    """Every tick of the device is there. A simulated camera may have left out frames where the computer was busy."""
    with Bag(bag) as recorded:
        whole = [signal for signal in summarise(recorded).signals if signal.topic.startswith("/hub/")]
    assert [(signal.lost, signal.gaps) for signal in whole] == [(0, 0), (0, 0)]


def called(executables: Any, *words: str) -> None:
    ended = executables.run("beam", "call", *words)
    assert ended.process.returncode == 0, ended.output()


@pytest.mark.parametrize("way", ["mouse", "key", "touch"])
def test_a_stop_on_the_page_is_at_the_plant_within_watchdog_and_ramp_and_the_recording_is_whole(
    executables, tmp_path: Path, way: str
) -> None:
    bag = tmp_path / "bag"
    up, link = watched(executables, bag)
    with open_browser() as browser:
        pages = [opened(browser, link, has_touch=True)[0] for _ in range(READERS)]
        called(executables, "hub/home")
        called(executables, "hub/enable", "true")
        called(executables, "excitation/start")
        for page in pages:
            until(page, "rows.hub.some((row) => Math.abs(row[1]) > 0.5)")
        page = pages[0]
        box = page.locator("#stop").bounding_box()
        middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        asked_ns = time.time_ns()
        if way == "mouse":
            page.mouse.click(*middle)
        elif way == "touch":
            page.touchscreen.tap(*middle)
        else:
            page.keyboard.press("Escape")
        until(page, "document.getElementById('answer').textContent.startsWith('Stop: ')")
        until(page, "document.getElementById('answer').textContent.includes('homed, switched off')")
        until(pages[-1], "document.getElementById('axis').textContent === 'homed, switched off'")
        recorder = page.evaluate("parts.losses.filter((loss) => loss.where === 'recorder')")
    up.send_signal(signal.SIGINT)
    assert up.wait() == 0, up.output()
    with Bag(bag) as recorded:
        samples = recorded.hub_samples("hub/measured")
    assert [row["count"] for row in recorder] == [0]
    assert_whole(bag)
    assert samples.velocities is not None
    moving = np.flatnonzero(samples.velocities)
    speed = np.abs(samples.velocities[samples.stamps_ns <= asked_ns]).max()
    rest_s = (samples.stamps_ns[moving[-1]] - asked_ns) * 1e-9
    hub = Rig.from_file().hub
    allowed_s = hub.watchdog + speed / (hub.stop_deceleration or hub.max_acceleration)
    assert rest_s < allowed_s, f"{way}: at rest {rest_s:.3f} s after the click, expected {allowed_s:.3f} s"


def test_a_thousand_connections_and_hostile_frames_leave_rig_and_recording_unharmed(
    executables, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    up, link = watched(executables, bag)
    port = int(link.rstrip("/").rpartition(":")[2])
    for words in (("hub/home",), ("hub/enable", "true"), ("excitation/start",)):
        called(executables, *words)
    with open_browser() as browser:
        page, _ = opened(browser, link)
        until(page, "rows.hub.some((row) => Math.abs(row[1]) > 0.5)")
        lines = []
        for k in range(1000):
            line = socket.socket()
            line.setblocking(False)
            line.connect_ex(("127.0.0.1", port))
            lines.append(line)
            with contextlib.suppress(OSError):
                line.sendall((UPGRADE + b"\x81\xff\x7f" + bytes(8), b"\xff" * 4096, UPGRADE)[k % 3])
        newest = page.evaluate("rows.hub.at(-1)[0]")
        until(page, f"rows.hub.at(-1)[0] > {newest + 1.0}")
        assert page.evaluate("parts.axis.words") == "switched on, a sequence runs"
        for line in lines:
            line.close()
        page.click("#stop")
        until(page, "document.getElementById('answer').textContent.includes('homed, switched off')")
    up.send_signal(signal.SIGINT)
    assert up.wait() == 0, up.output()
    assert "Traceback" not in up.output()
    assert_whole(bag)
