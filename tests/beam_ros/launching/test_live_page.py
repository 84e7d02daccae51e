"""A simulated rig watched by five browsers: curves move, the recorder loses nothing, a click stops the axis."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beam_ros.bags.reading import Bag
from beam_ros.bags.summary import summarise
from beam_ros.rig.rig import Rig
from tests.beam_ros.view.test_page import opened, until
from tests.browser import open_browser
from tests.graph import HANG_S

pytestmark = [pytest.mark.verify, pytest.mark.ros]
pytest.importorskip("rclpy")

READERS = 5


def called(executables: Any, *words: str) -> None:
    ended = executables.run("beam", "call", *words)
    assert ended.process.returncode == 0, ended.output()


@pytest.mark.parametrize("way", ["mouse", "key", "touch"])
def test_a_stop_on_the_page_is_at_the_plant_within_watchdog_and_ramp_and_the_recording_is_whole(
    executables, tmp_path: Path, way: str
) -> None:
    bag = tmp_path / "bag"
    up = executables.start(
        *("beam", "up", "--rig", "simulated", "--view", "--port", "0", "--record", str(bag)),
        *("-p", "simulation.images:=false", "-p", "excitation.duration:=30.0"),
        timeout_s=300.0,
    )
    output = up.wait_for("Ctrl-C ends it", HANG_S)
    link = next(line.removeprefix("page: ") for line in output.splitlines() if line.startswith("page: "))
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
        whole = [signal for signal in summarise(recorded).signals if signal.topic.startswith("/hub/")]
    assert [row["count"] for row in recorder] == [0]
    # Every tick of the device is there. A simulated camera may have left out frames where the computer was busy.
    assert [(signal.lost, signal.gaps) for signal in whole] == [(0, 0), (0, 0)]
    assert samples.velocities is not None
    moving = np.flatnonzero(samples.velocities)
    speed = np.abs(samples.velocities[samples.stamps_ns <= asked_ns]).max()
    rest_s = (samples.stamps_ns[moving[-1]] - asked_ns) * 1e-9
    hub = Rig.from_file().hub
    allowed_s = hub.watchdog + speed / (hub.stop_deceleration or hub.max_acceleration)
    assert rest_s < allowed_s, f"{way}: at rest {rest_s:.3f} s after the click, expected {allowed_s:.3f} s"
