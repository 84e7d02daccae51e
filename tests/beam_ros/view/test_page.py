"""The page in a real Chromium: read on every screen and by everybody, stopped by mouse, key and touch."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.bags.batches import encode_batch
from beam_ros.hub.contract import SampleBatch
from beam_ros.interfaces import graph as table
from beam_ros.messages import BagTypes, Health, LiveIdentification
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.rig import Rig
from beam_ros.view.recorded import RecordedScene
from beam_ros.view.scene import Scene
from beam_ros.view.server import PageServer
from tests.beam_ros.view.live_example import live_example
from tests.browser import CUT_OFF, WIDTHS, open_browser
from tests.graph import HANG_S

pytestmark = pytest.mark.verify

BAGS = Path(__file__).resolve().parents[3] / "bags"
TYPES = BagTypes()
START = 1_700_000_000_000_000_000
NASTY = '<img src=x onerror="document.title=1"> & <b>bold</b>'
IN_SIGHT = """
() => {
  const box = document.getElementById("stop").getBoundingClientRect();
  return box.top >= 0 && box.bottom <= innerHeight && box.left >= 0 && box.right <= innerWidth && box.height >= 44;
}
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with open_browser() as browser:
        yield browser


class Rigged:
    """A page of a rig that is fed by hand, and the stops that it was asked for."""

    def __init__(self, port: int = 0) -> None:
        self.scene = Scene(Rig.from_file(), source="rig", title="ROS_DOMAIN_ID=7, range LOCALHOST")
        self.stops = 0
        self.came = threading.Event()
        self.server = PageServer(
            self.scene,
            {"stop": self._stop},
            on_tick=lambda: None,
            on_link=lambda link: setattr(self, "link", link),
            port=port,
        )
        self.link: str

    def _stop(self, _value: Any) -> str:
        self.stops += 1
        self.came.set()
        return "stopping"

    def say(self, topic: str, content: dict[str, Any]) -> None:
        data = TYPES.serialize(messages.json_text(TYPES, content), table.STRING)
        self.scene.take(topic, data, time.monotonic(), time.time())

    def move(self, first_s: float, seconds: float) -> None:
        """Let hub and markers swing."""
        for k in range(round(first_s * 50), round((first_s + seconds) * 50)):
            ticks = np.arange(20 * k, 20 * (k + 1))
            batch = SampleBatch(
                START + int(ticks[0]) * 1_000_000, 1_000_000, 1, positions=4e-3 * np.sin(ticks * 0.02)
            )
            self.scene.take("hub/measured", encode_batch(batch), k * 0.02, time.time())
            places = batch.positions[0] * np.array([1.0, 1.5, 2.0])
            seen = messages.displacement(TYPES, batch.stamp_ns, ("z010", "z225", "z285"), places)
            data = TYPES.serialize(seen, table.JOINT_STATE)
            self.scene.take("beam/displacement", data, k * 0.02, time.time())

    def fill(self) -> None:
        """Show all that there can be, a fault, losses and hostile words among it."""
        self.move(0.0, 8.0)
        fault = {"number": 65, "name": "port_lost", "sentence": NASTY, "remedy": "check cable and power"}
        mode = {"state": "fault", "activity": "idle", "fault": fault, "since": 0.0, "reason": NASTY}
        self.say("hub/mode", mode)
        self.say("hub/sequence_state", {"id": NASTY, "state": "aborted", "points": 9, "reason": "hub/stop"})
        self.say(
            "recorder/state",
            {"recording": True, "path": "/a/very/long/way/to/the/bag/of/this/run", "messages": 9, "lost": 2},
        )
        values = {"lost_ticks": 3, "real_time_jumps": 0}
        statuses = [
            Health("hub", "ERROR", NASTY, "hub", values),
            Health(
                "tracker", "WARN", "52 of 133 frames are missing by their stamps", "tracker", {"z225 lost": 4}
            ),
        ]
        message = messages.diagnostics(TYPES, START, statuses)
        self.scene.take("/diagnostics", TYPES.serialize(message, table.DIAGNOSTICS), 0.0, time.time())
        self.scene.look(0.1, time.time())
        pixels = np.tile(np.linspace(0, 200, 320, dtype=np.uint8), (240, 1))
        data = TYPES.serialize(messages.image(TYPES, START, pixels), "sensor_msgs/msg/Image")
        self.scene.take("camera/image_raw", data, 0.0, time.time())
        self.scene.show_live(LiveIdentification.from_json(strict_json(live_example())), time.time())


@pytest.fixture
def rig() -> Iterator[Rigged]:
    rigged = Rigged()
    rigged.fill()
    yield rigged
    rigged.server.close()


def opened(browser: Any, link: str, **options: Any) -> tuple[Any, list[str]]:
    """Open the page in a context of its own; returns it and what the browser complains of."""
    page = browser.new_context(**options).new_page()
    page.set_default_timeout(1e3 * HANG_S)
    said: list[str] = []
    page.on("console", lambda message: said.append(f"console: {message.text}"))
    page.on("pageerror", lambda error: said.append(f"error: {error}"))
    page.on(
        "request",
        lambda request: said.append(request.url) if not request.url.startswith((link, "data:")) else 0,
    )
    page.goto(link)
    until(page, "document.getElementById('link').textContent === 'connected'")
    until(page, "!document.getElementById('stop').hidden || !document.getElementById('player').hidden")
    return page, said


def until(page: Any, condition: str) -> None:
    """Wait for what JavaScript says; Playwright's own way is forbidden by the page's policy, as all ``eval`` is."""
    end = time.monotonic() + HANG_S
    while not page.evaluate(condition):
        assert time.monotonic() < end, f"{condition} did not come true"
        time.sleep(0.02)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_reads_on_every_screen_and_by_everybody(browser, rig, scheme):
    from axe_playwright_python.sync_playwright import Axe

    page, said = opened(browser, rig.link, color_scheme=scheme)
    page.wait_for_selector("#camera:not([hidden])")
    faults = []
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 740})
        faults += [f"{width} px: {fault}" for fault in page.evaluate(CUT_OFF)]
        for violation in Axe().run(page).response["violations"]:
            first = violation["nodes"][0]["html"][:120]
            faults.append(
                f"{width} px: {violation['impact']}: {violation['id']}: {violation['help']}: {first}"
            )
        for _ in range(2):  # at the top and at the end of the page
            assert page.evaluate(IN_SIGHT)
            page.evaluate("scrollTo(0, document.body.scrollHeight)")
    assert not faults, "\n".join(faults)
    assert said == []


def test_words_of_the_rig_are_shown_as_they_are_and_never_as_markup(browser, rig):
    page, _ = opened(browser, rig.link)
    until(page, "document.getElementById('fault').textContent.includes('onerror')")
    assert page.evaluate("document.querySelectorAll('main img, main b').length") == 0
    assert page.title().endswith("beam rig")


@pytest.mark.parametrize("way", ["mouse", "escape", "enter", "touch"])
def test_stop_is_one_move_away_and_says_what_the_axis_did(browser, rig, way):
    page, _ = opened(browser, rig.link, has_touch=True, viewport={"width": 360, "height": 640})
    if way == "mouse":
        page.mouse.click(*_middle(page))
    elif way == "touch":
        page.touchscreen.tap(*_middle(page))
    elif way == "escape":
        page.keyboard.press("Escape")
    else:
        page.keyboard.press("Tab")  # the stop is the first thing that the keyboard reaches
        page.keyboard.press("Enter")
    assert rig.came.wait(HANG_S)
    until(page, "document.getElementById('answer').textContent.startsWith('Stop: stopping')")
    mode = {"state": "homed", "activity": "idle", "fault": None, "since": 0.0, "reason": "hub/stop"}
    rig.say("hub/mode", mode)
    until(page, "document.getElementById('answer').textContent.includes('homed, switched off')")
    assert rig.stops == 1


def _middle(page: Any) -> tuple[float, float]:
    box = page.locator("#stop").bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_curves_move_and_a_page_whose_server_ends_comes_back_by_itself(browser, rig):
    page, _ = opened(browser, rig.link)
    until(page, "hubChart.data[0].length > 100")
    newest = page.evaluate("hubChart.data[0][hubChart.data[0].length - 1]")
    rig.move(8.0, 1.0)
    until(page, f"hubChart.data[0][hubChart.data[0].length - 1] > {newest + 0.9}")
    rig.server.close()
    until(page, "document.getElementById('link').textContent.includes('connection lost')")
    page.click("#stop")
    assert "did not reach the rig" in page.inner_text("#answer")
    again = Rigged(rig.server.port)
    try:
        again.move(0.0, 2.0)
        until(page, "document.getElementById('link').textContent === 'connected'")
        until(page, "hubChart.data[0].length > 100 && hubChart.data[0].at(-1) < 2.1")
        page.click("#stop")
        assert again.came.wait(HANG_S)
    finally:
        again.server.close()


def test_the_band_shrinks_and_the_table_shows_two_digits_of_each_deviation(browser, rig):
    page, _ = opened(browser, rig.link)
    until(page, "responseChart.data[0].length === 200")
    width = "responseChart.data[1].reduce((sum, v, k) => sum + Math.log(v / responseChart.data[2][k]), 0)"
    before = page.evaluate(width)
    rig.scene.show_live(LiveIdentification.from_json(strict_json(live_example(120.0))), 0.0)
    until(page, f"{width} < {0.5 * before}")
    cells = page.locator("#modes tbody tr").first.locator("th, td").all_inner_texts()
    assert cells[0] == "1"
    assert len(cells[2].replace(".", "").lstrip("0")) == 2
    assert len(cells[1].partition(".")[2]) == len(cells[2].partition(".")[2])
    page.select_option("#output", "z010")
    assert "z010" in page.inner_text("#response-note")


def test_mode_shapes_stand_beside_those_of_the_rig_file(browser, rig):
    page, _ = opened(browser, rig.link)
    until(page, "document.querySelectorAll('#shape-plots circle').length === 6")
    note = page.evaluate("document.getElementById('shapes-note').textContent")
    captions = page.evaluate(
        "Array.from(document.querySelectorAll('#shape-plots figcaption'), (own) => own.textContent)"
    )
    assert captions == ["4.384 Hz (4.384 Hz)", "28.26 Hz (28.26 Hz)"]
    # The example is the rig file's own beam: straight lines between 41 heights leave that.
    apart = [float(words.split(" %")[0]) for words in note.split("within ")[1:]]
    assert len(apart) == 2
    assert max(apart) < 0.5
    other = live_example()
    other["shape"]["modes"][0][2] *= 1.2
    rig.scene.show_live(LiveIdentification.from_json(strict_json(other)), time.time())
    until(page, "/mode 1 within [1-9][\\d.]* %/.test(document.getElementById('shapes-note').textContent)")


def test_a_bag_is_played_paused_and_entered_by_keys(browser):
    scene = Scene(Rig.from_file(), source="bag", title="bags/frames")
    player = RecordedScene(BAGS / "frames", scene)
    links: list[str] = []
    server = PageServer(scene, player.orders, on_tick=player.show, on_link=links.append)
    try:
        player.start()
        page, said = opened(browser, links[0], viewport={"width": 360, "height": 640})
        page.wait_for_selector("#camera:not([hidden])")
        assert page.is_hidden("#stop")
        until(page, "Number(document.getElementById('seek').value) > 1")
        page.focus("#play")
        page.keyboard.press("Space")
        until(page, "document.getElementById('play').textContent === 'Play'")
        place = page.evaluate("parts.player.position")
        page.focus("#seek")
        page.keyboard.press("Home")
        until(page, "parts.player.position === 0 && rows.hub.length < 100")
        page.keyboard.press("End")
        until(page, f"parts.player.position > {place} && rows.hub.length > 500")
        assert page.evaluate(CUT_OFF) == []
        assert said == []
    finally:
        server.close()
        player.close()
