"""The server over real sockets: what it hands out, and what strangers get."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from collections.abc import Iterator

import aiohttp
import pytest

from beam_ros.errors import RigUnavailableError
from beam_ros.rig.rig import Rig
from beam_ros.view.scene import Scene
from beam_ros.view.server import ASSETS, Limits, OrderRefusedError, PageServer
from tests.graph import HANG_S

pytestmark = pytest.mark.slow  # sockets and their clock

LIMITS = Limits(
    connections=16, readers=3, first_request_s=0.5, news_hz=100.0, pictures_hz=100.0, silence_s=0.2
)


class Served:
    """A server with a scene, and what was ordered."""

    def __init__(self, host: str = "127.0.0.1", limits: Limits = LIMITS, port: int = 0) -> None:
        self.scene = Scene(Rig.from_file(), source="rig", title="a rig")
        self.ordered: list[object] = []
        self.links: list[str] = []
        self.server = PageServer(
            self.scene,
            {"stop": self._stop},
            on_tick=lambda: None,
            on_link=self.links.append,
            host=host,
            port=port,
            limits=limits,
        )
        self.url = f"http://127.0.0.1:{self.server.port}"

    def _stop(self, value: object) -> str:
        self.ordered.append(value)
        if value == "refuse":
            raise OrderRefusedError("no hub offers hub/stop")
        return "stopping"

    def ask(self, path: str = "/", **options: object) -> tuple[int, dict[str, str], bytes]:
        async def asked() -> tuple[int, dict[str, str], bytes]:
            async with aiohttp.ClientSession() as session:
                method = str(options.pop("method", "GET"))
                async with session.request(
                    method, self.url + path, allow_redirects=False, **options
                ) as response:
                    return response.status, dict(response.headers), await response.read()

        return asyncio.run(asyncio.wait_for(asked(), HANG_S))

    def talk(self, conversation, origin: str | None = None, **options: object):
        """Open a reader's stream and run a conversation over it."""

        async def talked():
            async with (
                aiohttp.ClientSession() as session,
                session.ws_connect(self.url + "/news", origin=origin or self.url, **options) as stream,
            ):
                return await conversation(stream)

        return asyncio.run(asyncio.wait_for(talked(), HANG_S))


@pytest.fixture
def served() -> Iterator[Served]:
    served = Served()
    yield served
    served.server.close()


async def first_news(stream) -> dict:
    """Return the next thing that is new; that there is nothing is passed over."""
    while not (news := json.loads((await stream.receive()).data)):
        pass
    return news


def is_alive(served: Served) -> bool:
    return "beam" in served.talk(first_news) and served.ask()[0] == 200


def raw(served: Served, data: bytes, timeout_s: float = HANG_S) -> bytes:
    """Send bytes and return what comes until the server closes."""
    with socket.create_connection(("127.0.0.1", served.server.port), timeout=timeout_s) as line:
        found = b""
        try:
            line.sendall(data)
            while piece := line.recv(65536):
                found += piece
        except ConnectionError:
            pass
        return found


def test_the_page_and_all_that_it_loads_come_from_here_with_headers_that_keep_others_out(served):
    for path, (_, kind) in ASSETS.items():
        status, headers, body = served.ask(path)
        assert (status, headers["Content-Type"].partition(";")[0]) == (200, kind)
        assert len(body) > 500
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["X-Frame-Options"] == "DENY"
        assert b"http://" not in body.replace(b"http://www.w3.org/2000/svg", b"")


def test_a_reader_is_told_what_is_new_and_an_order_is_answered(served):
    async def conversation(stream):
        assert "beam" in await first_news(stream)
        served.scene.note("info", "something", 0.0)
        assert (await first_news(stream))["log"]["rows"][0]["text"] == "something"
        await stream.send_str('{"order": "stop", "value": 7}')
        return await first_news(stream)

    assert served.talk(conversation) == {"answer": {"order": "stop", "text": "stopping", "done": True}}
    assert served.ordered == [7]


def test_a_reader_hears_that_there_is_nothing_new_so_that_it_knows_a_dead_line_from_a_quiet_one(served):
    async def conversation(stream):
        await first_news(stream)
        return json.loads((await stream.receive()).data)

    assert served.talk(conversation) == {}


def test_an_order_that_cannot_be_carried_out_says_why(served):
    async def conversation(stream):
        await first_news(stream)
        await stream.send_str('{"order": "stop", "value": "refuse"}')
        return (await first_news(stream))["answer"]

    answer = served.talk(conversation)
    assert (answer["done"], answer["text"]) == (False, "no hub offers hub/stop")


FOREIGN = ["http://evil.example", "http://localhost.evil.example", "null", "file://"]


@pytest.mark.parametrize("origin", FOREIGN)
def test_a_page_of_another_origin_gets_no_stream_and_no_order_through(served, origin):
    async def never(_stream):
        raise AssertionError("a stranger was let in")

    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        served.talk(never, origin=origin)
    assert refused.value.status == 403
    assert served.ask(headers={"Origin": origin})[0] == 403
    assert not served.ordered


def test_a_foreign_name_for_this_server_is_refused(served):
    assert served.ask(headers={"Host": "evil.example"})[0] == 403
    assert raw(served, b"GET / HTTP/1.1\r\nConnection: close\r\n\r\n").split(b"\r\n")[0].split()[1] in (
        b"400",
        b"403",
    )


@pytest.mark.parametrize(
    "path",
    [
        "/../setup.py",
        "/..%2f..%2fetc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/uplot/../../server.py",
        "//etc/passwd",
        "/page.html/..",
        "/view.js%00.html",
        "/uplot/",
        "/uplot",
        "/server.py",
        "/__init__.py",
        "/etc/passwd",
    ],
)
def test_no_path_leads_to_a_file_beside_the_few_that_are_served(served, path):
    head = f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    answer = raw(served, head.encode())
    assert int(answer.split()[1]) in (400, 403, 404)
    assert b"root:" not in answer
    assert b"import" not in answer


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT"])
def test_the_page_is_only_read(served, method):
    head = f"{method} / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    assert int(raw(served, head.encode()).split()[1]) in (400, 404, 405)
    assert not served.ordered


@pytest.mark.parametrize(
    "frame",
    [
        "",
        "stop",
        "[]",
        "null",
        "7",
        '"stop"',
        '{"order": 7}',
        '{"order": "home"}',
        '{"order": "enable", "value": true}',
        "{" * 2000,
        "[" * 4000,
        '{"order": "__class__"}',
    ],
)
def test_a_frame_that_is_no_order_ends_the_stream_and_moves_nothing(served, frame):
    async def conversation(stream):
        await stream.send_str(frame)
        async for _ in stream:
            pass
        return stream.close_code

    assert served.talk(conversation) == aiohttp.WSCloseCode.POLICY_VIOLATION
    assert not served.ordered
    assert is_alive(served)


def test_an_oversized_frame_and_a_binary_one_end_the_stream(served):
    async def conversation(stream, send):
        await send(stream)
        async for _ in stream:
            pass
        return stream.close_code

    big = '{"order": "stop", "value": "' + "x" * LIMITS.frame_bytes + '"}'
    codes = [
        served.talk(lambda stream, send=send: conversation(stream, send))
        for send in (
            lambda stream: stream.send_str(big),
            lambda stream: stream.send_bytes(b'{"order": "stop"}'),
        )
    ]
    assert codes == [aiohttp.WSCloseCode.MESSAGE_TOO_BIG, aiohttp.WSCloseCode.POLICY_VIOLATION]
    assert not served.ordered
    assert is_alive(served)


UPGRADE = (
    b"GET /news HTTP/1.1\r\nHost: localhost\r\nOrigin: http://localhost\r\nUpgrade: websocket\r\n"
    b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: x3JJHMbDL1EzLkh9GBhXDw==\r\n\r\n"
)


@pytest.mark.parametrize(
    "data",
    [
        b"\x00" * 4096,
        b"\xff\xfe\xfd" * 1000,
        b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"b" * 100_000 + b"\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: -1\r\n\r\n",
        b"GET / HTTP/9.9\r\nHost: localhost\r\n\r\n",
        UPGRADE + b"\x81\x05stop!",  # a browser masks its frames
        UPGRADE + b"\xf1\x80\x00\x00\x00\x00",  # reserved bits
        UPGRADE + b"\x8f\x80\x00\x00\x00\x00",  # no such kind of frame
        UPGRADE + b"\x89\xfe\x10\x00\x00\x00\x00\x00",  # a ping that is too long
        UPGRADE + b"\x81\xff\x7f\xff\xff\xff\xff\xff\xff\xff\x00\x00\x00\x00",  # 2^63 bytes announced
        UPGRADE + b"\x81\x81\x00\x00\x00\x00\xff",  # text that is no UTF-8
    ],
)
def test_what_is_no_request_or_no_frame_is_cut_off_and_nothing_is_printed(served, data, capfd):
    raw(served, data)
    assert not served.ordered
    assert is_alive(served)
    assert capfd.readouterr() == ("", "")


def test_a_connection_that_asks_for_nothing_is_closed(served):
    begun = time.monotonic()
    assert raw(served, b"") == b""
    assert raw(served, b"GET / HTTP/1.1\r\nHost: local") == b""
    assert time.monotonic() - begun < HANG_S


def test_a_thousand_connections_are_refused_and_a_reader_that_is_there_goes_on(served):
    async def conversation(stream):
        await first_news(stream)
        lines = []
        for _ in range(1000):
            line = socket.socket()
            line.setblocking(False)
            line.connect_ex(("127.0.0.1", served.server.port))
            lines.append(line)
        try:
            served.scene.note("info", "still here", 0.0)
            assert (await first_news(stream))["log"]["rows"][0]["text"] == "still here"
            await stream.send_str('{"order": "stop"}')
            return (await first_news(stream))["answer"]["text"]
        finally:
            for line in lines:
                line.close()

    assert served.talk(conversation) == "stopping"


def test_readers_beyond_the_limit_are_refused_and_a_place_is_free_when_one_leaves(served):
    async def conversation(_stream):
        async with aiohttp.ClientSession() as session:
            streams = [
                await session.ws_connect(served.url + "/news", origin=served.url)
                for _ in range(LIMITS.readers - 1)
            ]
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                await session.ws_connect(served.url + "/news", origin=served.url)
            for stream in streams:
                await stream.close()
            return refused.value.status

    assert served.talk(conversation) == 503
    assert is_alive(served)


def test_a_reader_that_takes_nothing_costs_the_others_nothing(served):
    line = socket.create_connection(("127.0.0.1", served.server.port))
    line.sendall(UPGRADE)
    end = time.monotonic() + HANG_S
    while not served.server.has_readers and time.monotonic() < end:
        time.sleep(0.01)
    # Far more than sockets hold back: the mute reader's part is never made.
    for k in range(200):
        served.scene.show("nodes", [{"name": "x" * 20_000, "level": "OK", "sentence": str(k)}])
    news = served.talk(first_news)
    assert news["nodes"][0]["sentence"] == "199"
    line.close()


def test_others_get_in_by_the_link_alone_and_by_each_link_once():
    served = Served(host="0.0.0.0")
    try:
        (link,) = served.links
        token = link.partition("?token=")[2]
        for path in ("/", "/view.js", "/news", "/?token=wrong", f"/view.js?token={token}"):
            assert served.ask(path, headers={"Origin": served.url})[0] == 403
        status, headers, _ = served.ask(f"/?token={token}")
        cookie = headers["Set-Cookie"]
        assert (status, headers["Location"]) == (303, "/")
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        session = {"Cookie": cookie.partition(";")[0]}
        assert served.ask(headers=session)[0] == 200
        assert served.ask(f"/?token={token}")[0] == 403
        assert len(served.links) == 2
        assert "beam" in served.talk(first_news, headers=session)
    finally:
        served.server.close()


def test_a_port_that_is_taken_and_a_host_that_is_not_here_are_one_line_with_the_remedy(served):
    with pytest.raises(RigUnavailableError, match=r"port \d+ .*give another --port"):
        Served(port=served.server.port)
    with pytest.raises(RigUnavailableError, match="free port of this computer"):
        Served(host="192.0.2.1")
    with pytest.raises(RigUnavailableError, match="free port of this computer"):
        Served(port=70_000)


def test_a_server_that_ends_sends_its_readers_away_and_frees_its_port(served):
    async def conversation(stream):
        await first_news(stream)
        threading.Thread(target=served.server.close).start()
        async for _ in stream:
            pass
        return stream.close_code

    assert served.talk(conversation) in (aiohttp.WSCloseCode.OK, aiohttp.WSCloseCode.GOING_AWAY)
    again = Served(port=served.server.port)
    assert is_alive(again)
    again.server.close()
