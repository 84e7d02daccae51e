"""The small server of the page: a few files, one stream of news to each reader, and a few orders.

It runs in a thread of its own with an event loop of its own, so that it neither waits for the rig nor lets the rig
wait. Every reader is sent what is newest when it can take it (``beam_ros.view.scene``): one that is slow misses
what was between. What comes in is bounded: connections, readers, the size of a frame, the time to a first request.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, cast

from aiohttp import WSCloseCode, WSMessage, WSMsgType, web
from aiohttp.web_protocol import RequestHandler

from beam_ros.errors import RigUnavailableError
from beam_ros.process.strict_json import strict_json
from beam_ros.view.admission import Admission, reachable_name
from beam_ros.view.scene import Cursor, Scene

DEFAULT_HOST = "127.0.0.1"

ASSETS = {
    "/": ("page.html", "text/html"),
    "/view.js": ("view.js", "text/javascript"),
    "/view.css": ("view.css", "text/css"),
    "/uplot/uPlot.iife.min.js": ("uplot/uPlot.iife.min.js", "text/javascript"),
    "/uplot/uPlot.min.css": ("uplot/uPlot.min.css", "text/css"),
}
"""All that is served as it lies; there is no way from a path in a request to one on the disk."""

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Server": "beam view",
}
"""The page loads nothing from elsewhere, and nobody may put it into a frame, where a click could be stolen."""

_SESSION = "beam_view"

Order = Callable[[Any], str]


class OrderRefusedError(RigUnavailableError):
    """An order was understood and could not be carried out; the message says why, and what to do."""


@dataclass(frozen=True)
class Limits:
    """What the server bears.

    Attributes
    ----------
    connections, readers : int -- at a time
    frame_bytes : int -- longest frame that a reader may send
    first_request_s : float -- a connection that has asked for nothing by then is closed [s]
    news_hz, pictures_hz : float -- how often a reader receives what is new [Hz]
    silence_s : float -- so long at most a reader hears nothing; then it hears that there is nothing [s]
    patience_s : float -- a reader that takes nothing for so long is left [s]
    leave_s : float -- so long a reader that is sent away may take to say goodbye [s]
    """

    connections: int = 128
    readers: int = 32
    frame_bytes: int = 4096
    first_request_s: float = 10.0
    news_hz: float = 20.0
    pictures_hz: float = 10.0
    silence_s: float = 1.0
    patience_s: float = 10.0
    leave_s: float = 1.0


class _Refusing(asyncio.Protocol):
    """Closes a connection that is one too many."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        cast(asyncio.Transport, transport).abort()


class PageServer:
    """Serves one scene.

    Parameters
    ----------
    scene : Scene
    orders : mapping of str to callable -- by name; takes the order's value, returns what came of it in words
    on_tick : callable -- called before readers receive what is new, from the server's thread
    on_link : callable -- called with the address that opens the page, and with every new one
    host : str -- where it is bound; more than this computer asks for a token
    port : int -- 0: any that is free
    limits : Limits, optional

    Raises
    ------
    RigUnavailableError
        The port is taken, or the host is none of this computer's.
    """

    def __init__(
        self,
        scene: Scene,
        orders: Mapping[str, Order],
        *,
        on_tick: Callable[[], None],
        on_link: Callable[[str], None],
        host: str = DEFAULT_HOST,
        port: int = 0,
        limits: Limits | None = None,
    ) -> None:
        self._scene, self._orders, self._on_tick = scene, orders, on_tick
        self.limits = limits or Limits()
        self._socket = _bound(host, port)
        self.port = int(self._socket.getsockname()[1])
        self._address = f"http://{reachable_name(host)}:{self.port}/"
        self._on_link = on_link
        self._assets = {
            path: ((files("beam_ros.view") / "page" / name).read_bytes(), kind)
            for path, (name, kind) in ASSETS.items()
        }
        self._admission = Admission(host, lambda token: on_link(f"{self._address}?token={token}"))
        if not self._admission.needs_session:
            on_link(self._address)
        self._mute: set[RequestHandler] = set()
        self._readers: set[web.WebSocketResponse] = set()
        self._workers = ThreadPoolExecutor(max_workers=4, thread_name_prefix="order")
        self._loop = asyncio.new_event_loop()
        self._is_ending = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()

    @property
    def has_readers(self) -> bool:
        """Whether anybody looks at the page."""
        return bool(self._readers)

    def close(self) -> None:
        """Send the readers away and free the port."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._is_ending.set)
            self._thread.join(self.limits.patience_s)
        self._workers.shutdown(wait=False, cancel_futures=True)
        self._socket.close()

    # --- connections

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        app = web.Application(middlewares=[self._guarded])
        app.router.add_get("/news", self._stream)
        for path in ASSETS:
            app.router.add_get(path, self._asset)
        app.on_response_prepare.append(_with_headers)
        # What strangers send is no news for the terminal.
        quiet = logging.getLogger("beam_ros.view")
        quiet.addHandler(logging.NullHandler())
        quiet.propagate = False
        runner = web.AppRunner(
            app, access_log=None, logger=quiet, handle_signals=False, shutdown_timeout=self.limits.leave_s
        )
        await runner.setup()

        def accepted() -> asyncio.Protocol:
            server = runner.server
            if server is None or len(server.connections) >= self.limits.connections:
                return _Refusing()
            handler = server()
            self._mute.add(handler)
            self._loop.call_later(self.limits.first_request_s, self._end_if_mute, handler)
            return handler

        listening = await self._loop.create_server(accepted, sock=self._socket)
        ticking = asyncio.ensure_future(self._tick())
        await self._is_ending.wait()
        ticking.cancel()
        listening.close()
        for reader in tuple(self._readers):
            with contextlib.suppress(Exception):
                await reader.close(code=WSCloseCode.GOING_AWAY)
        await runner.cleanup()

    def _end_if_mute(self, handler: RequestHandler) -> None:
        if handler in self._mute:
            self._mute.discard(handler)
            if handler.transport is not None:
                handler.transport.abort()

    async def _tick(self) -> None:
        while True:
            if self._readers:
                self._on_tick()
            await asyncio.sleep(1.0 / self.limits.news_hz)

    @web.middleware
    async def _guarded(
        self, request: web.Request, handler: Callable[[web.Request], Any]
    ) -> web.StreamResponse:
        self._mute.discard(request.protocol)
        is_stream = request.path == "/news"
        refusal = self._admission.refusal(
            request.headers.get("Host"), request.headers.get("Origin"), needs_origin=is_stream
        )
        if refusal:
            return web.Response(status=403, text=f"{refusal}\n")
        if request.path == "/" and (session := self._admission.redeem(request.query.get("token", ""))):
            redirect = web.Response(status=303, headers={"Location": "/"})
            redirect.set_cookie(_SESSION, session, httponly=True, samesite="Strict", path="/")
            return redirect
        if not self._admission.knows(request.cookies.get(_SESSION)):
            return web.Response(
                status=403,
                text="This page is opened by the link that `beam view` shows in its terminal, which opens it once; "
                "the next link stands there already.\n",
            )
        return cast(web.StreamResponse, await handler(request))

    async def _asset(self, request: web.Request) -> web.Response:
        body, kind = self._assets[request.path]
        return web.Response(body=body, content_type=kind, charset="utf-8")

    # --- readers

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        if len(self._readers) >= self.limits.readers:
            return web.Response(status=503, text="too many readers: close this page somewhere else\n")
        reader = web.WebSocketResponse(
            timeout=self.limits.leave_s,
            heartbeat=self.limits.patience_s,
            max_msg_size=self.limits.frame_bytes,
            compress=False,
        )
        await reader.prepare(request)
        self._readers.add(reader)
        sending = asyncio.ensure_future(self._send(reader, request))
        try:
            async for message in reader:
                if not await self._obey(reader, message):
                    break
        finally:
            sending.cancel()
            self._readers.discard(reader)
        return reader

    async def _send(self, reader: web.WebSocketResponse, request: web.Request) -> None:
        """Tell a reader what is new, as fast as it takes it and no faster than the limits say."""
        cursor, ticks, told_s = Cursor(), 0, self._loop.time()
        pictures_every = max(1, round(self.limits.news_hz / self.limits.pictures_hz))
        try:
            while not reader.closed:
                news = self._scene.news(cursor)
                if news or self._loop.time() - told_s > self.limits.silence_s:
                    told_s = self._loop.time()
                    await asyncio.wait_for(reader.send_str(news or "{}"), self.limits.patience_s)
                if ticks % pictures_every == 0 and (picture := self._scene.picture(cursor)):
                    await asyncio.wait_for(reader.send_bytes(picture), self.limits.patience_s)
                ticks += 1
                await asyncio.sleep(1.0 / self.limits.news_hz)
        except (asyncio.TimeoutError, ConnectionError):
            pass
        finally:
            # Whatever ended it: a page that hears nothing must not look as if it were connected.
            if not reader.closed and request.transport is not None:
                request.transport.abort()

    async def _obey(self, reader: web.WebSocketResponse, message: WSMessage) -> bool:
        """Carry out an order; return False, and close, for what is none."""
        order = _order_in(message) if message.type is WSMsgType.TEXT else None
        if order is None or order[0] not in self._orders:
            names = ", ".join(self._orders)
            reason = f'expected {{"order": one of {names}}}'
            await reader.close(code=WSCloseCode.POLICY_VIOLATION, message=reason.encode())
            return False
        name, value = order
        try:
            text = await self._loop.run_in_executor(self._workers, self._orders[name], value)
            is_done = True
        except OrderRefusedError as err:
            text, is_done = str(err), False
        with contextlib.suppress(ConnectionError):
            await reader.send_str(strict_json({"answer": {"order": name, "text": text, "done": is_done}}))
        return True


def _bound(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=64)
    except (OSError, OverflowError) as err:
        raise RigUnavailableError(
            f"the page cannot be served at {host}, port {port} ({err}): expected a free port of this computer; give "
            "another --port, 0 for any that is free, or end what holds this one"
        ) from err


def _order_in(message: WSMessage) -> tuple[str, Any] | None:
    try:
        content = json.loads(message.data)
    except (ValueError, RecursionError):
        return None
    if not isinstance(content, dict) or not isinstance(content.get("order"), str):
        return None
    return content["order"], content.get("value")


async def _with_headers(_request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(HEADERS)
