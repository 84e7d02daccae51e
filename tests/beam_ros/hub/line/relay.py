"""A serial server: bytes between a TCP connection and a port, late, as RFC 2217, or drowned in noise."""

from __future__ import annotations

import contextlib
import os
import random
import select
import socket
import threading
import time
from collections import deque

import serial
from serial.rfc2217 import PortManager


class SerialServer:
    """Serves one port to one host at a time, until it is closed.

    Parameters
    ----------
    port : str -- path of the port; empty: nothing is behind, bytes of the host are lost
    delay_s : float -- each way
    speaks_rfc2217 : bool -- else bytes as they are
    noise_seed : int, optional -- bytes without end towards the host, as fast as it takes them
    """

    def __init__(
        self, port: str, *, delay_s: float = 0.0, speaks_rfc2217: bool = False, noise_seed: int | None = None
    ) -> None:
        self._port = port
        self._delay_s = delay_s
        self._speaks_rfc2217 = speaks_rfc2217
        self._noise = None if noise_seed is None else random.Random(noise_seed).randbytes(65_536)
        self._is_closing = False
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.05)
        kind = "rfc2217" if speaks_rfc2217 else "socket"
        self.url = f"{kind}://127.0.0.1:{self._listener.getsockname()[1]}"
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._is_closing = True
        self._thread.join(timeout=5.0)
        self._listener.close()

    def _run(self) -> None:
        while not self._is_closing:
            with contextlib.suppress(OSError):
                connection, _ = self._listener.accept()
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                with connection:
                    self._serve(connection)

    def _serve(self, connection: socket.socket) -> None:
        if self._noise is not None:
            connection.settimeout(0.05)
            while not self._is_closing:
                with contextlib.suppress(TimeoutError):
                    connection.send(self._noise)
            return
        with _Port(self._port, timeout=0) as port:
            manager = PortManager(port, _Writer(connection)) if self._speaks_rfc2217 else None
            ways: dict[str, deque[tuple[float, bytes]]] = {"out": deque(), "back": deque()}
            while not self._is_closing:
                select.select([connection, port.fileno()], [], [], 0.001)
                now = time.monotonic()
                with contextlib.suppress(BlockingIOError):
                    data = connection.recv(65_536, socket.MSG_DONTWAIT)
                    if not data:
                        return
                    ways["out"].append((now, b"".join(manager.filter(data)) if manager else data))
                answer = port.read(65_536)
                if answer:
                    ways["back"].append((now, b"".join(manager.escape(answer)) if manager else answer))
                for name, way in ways.items():
                    while way and way[0][0] <= now - self._delay_s:
                        _, data = way.popleft()
                        if name == "out":
                            os.write(port.fileno(), data)
                        else:
                            connection.sendall(data)


class _Port(serial.Serial):
    """A pseudo-terminal has no modem lines, which RFC 2217 asks for."""

    cts = dsr = ri = cd = property(lambda self: False)

    def _update_dtr_state(self) -> None:
        pass

    _update_rts_state = _update_break_state = _update_dtr_state


class _Writer:
    """What a ``PortManager`` writes its own answers to."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection

    def write(self, data: bytes) -> None:
        self._connection.sendall(data)
