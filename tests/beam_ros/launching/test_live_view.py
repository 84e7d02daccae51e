"""`beam view`: the running rig and a bag on the page, and the stop that reaches the axis."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import time
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest

from beam_ros.bags.batches import decode_batch
from tests.beam_ros.bags.small_bags import write_experiment
from tests.graph import HANG_S

BAGS = Path(__file__).resolve().parents[3] / "bags"


def link_of(running: Any) -> str:
    output = running.wait_for("Ctrl-C ends it", HANG_S)
    return next(line.partition("page: ")[2] for line in output.splitlines() if "page: " in line)


async def read_until(stream: Any, page: dict[str, Any], condition: Any) -> None:
    """Take news into a copy of the page until a condition holds."""
    while not condition(page):
        message = await asyncio.wait_for(stream.receive(), HANG_S)
        assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
        if message.type is aiohttp.WSMsgType.TEXT:
            page.update(json.loads(message.data))
        else:
            page["picture"] = message.data


def look(link: str, conversation: Any) -> Any:
    """Open the page's stream and talk over it."""

    async def talked() -> Any:
        url = link.rstrip("/")
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(f"{url}/news", origin=url, max_msg_size=0) as stream,
        ):
            return await conversation(stream)

    return asyncio.run(talked())


@pytest.mark.ros
def test_stop_on_the_page_brings_a_moving_axis_to_rest_and_shows_what_it_did(
    executables, graph, tmp_path: Path
) -> None:
    pytest.importorskip("rclpy")
    calm = ("--ros-args", "-p", "simulation.images:=false", "-p", "hub.watchdog:=1.0")
    executables.start("simulator", *calm)
    executables.start(
        "excitation_generator", *calm, "-p", "excitation.duration:=60.0", "-p", "excitation.acceleration:=0.3"
    )
    view = executables.start("beam", "view", "--port", "0")
    link = link_of(view)
    measured: list[Any] = []
    graph.listen("hub/measured", lambda data: measured.append(decode_batch(bytes(data))), raw=True)
    graph.switch_on()
    assert graph.call("excitation/start").success
    graph.wait(lambda: any(np.abs(batch.velocities).max() > 0.01 for batch in measured), "motion")

    async def conversation(stream: Any) -> dict[str, Any]:
        page: dict[str, Any] = {}
        await read_until(
            stream, page, lambda p: p.get("axis", {}).get("words") == "switched on, a sequence runs"
        )
        await stream.send_str('{"order": "stop"}')
        await read_until(stream, page, lambda p: "answer" in p)
        await read_until(stream, page, lambda p: p["axis"]["words"] == "homed, switched off")
        await read_until(stream, page, lambda p: p["sequence"]["state"] == "aborted")
        return page

    page = look(link, conversation)
    assert page["answer"]["done"], page["answer"]
    shown_ns = time.time_ns()
    graph.wait(lambda: measured[-1].stamp_ns > shown_ns + 500_000_000, "samples of after the stop")
    assert all(not batch.velocities.any() for batch in measured if batch.stamp_ns > shown_ns)
    view.send_signal(signal.SIGINT)
    assert view.wait() == 0
    assert "Traceback" not in view.output()


@pytest.mark.ros
def test_a_hub_that_is_gone_is_said_and_stop_says_what_to_do_instead(executables) -> None:
    pytest.importorskip("rclpy")
    simulator = executables.start("simulator", "--ros-args", "-p", "simulation.images:=false")
    view = executables.start("beam", "view", "--port", "0")

    async def conversation(stream: Any) -> dict[str, Any]:
        page: dict[str, Any] = {}
        await read_until(stream, page, lambda p: p.get("hub", {}).get("rows"))
        simulator.send_signal(signal.SIGINT)
        await asyncio.get_running_loop().run_in_executor(None, simulator.wait)
        await read_until(stream, page, lambda p: p["axis"]["silent"])
        await stream.send_str('{"order": "stop"}')
        await read_until(stream, page, lambda p: "answer" in p)
        return page

    answer = look(link_of(view), conversation)["answer"]
    assert not answer["done"]
    assert "stop the axis at its own switch" in answer["text"]


def test_a_bag_is_played_paused_and_entered_over_the_page(executables) -> None:
    view = executables.start("beam", "view", str(BAGS / "frames"), "--port", "0", "--paused")

    async def conversation(stream: Any) -> dict[str, Any]:
        page: dict[str, Any] = {}
        await read_until(stream, page, lambda p: "player" in p)
        assert not page["player"]["playing"]
        await stream.send_str('{"order": "seek", "value": 2.0}')
        await read_until(stream, page, lambda p: p["player"]["position"] == 2.0 and "picture" in p)
        await stream.send_str('{"order": "play"}')
        await read_until(stream, page, lambda p: p["player"]["position"] > 2.5)
        await stream.send_str('{"order": "pause"}')
        await read_until(stream, page, lambda p: not p["player"]["playing"])
        await stream.send_str('{"order": "stop"}')  # a bag has no axis
        closing = [message async for message in stream]
        assert all(message.type is not aiohttp.WSMsgType.ERROR for message in closing)
        return page

    page = look(link_of(view), conversation)
    assert page["beam"]["source"] == "bag"
    assert page["shape"]["measured"]
    view.send_signal(signal.SIGINT)
    assert view.wait() == 0
    assert "Traceback" not in view.output()


def test_what_is_no_bag_and_a_port_that_is_taken_are_one_line_each(beam, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.mcap").write_text("no bag")
    for name in ("nothing", "folder", "text.mcap"):
        ended = beam("view", name)
        assert ended.returncode == 2
        assert ended.stderr.count("\n") == 1, ended.stderr
    path = write_experiment(tmp_path / "bag")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        ended = beam("view", str(path), "--port", str(taken.getsockname()[1]))
    assert ended.returncode == 2
    assert "give another --port" in ended.stderr
    assert ended.stderr.count("\n") == 1
