"""Bytes over a port, and what can be wrong with it.

A port is whatever pyserial can open: the path of a device, or a URL such as ``socket://host:4000`` or
``rfc2217://host:4000``. Drivers, kernels and pyserial's handlers raise many kinds of exceptions when a cable is
pulled (``termios.error`` is no ``OSError``, a vanished descriptor gives a ``TypeError``); all of them leave this
module as a ``HubConnectionError`` with a row of the table of faults.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import select
import socket
import time
from pathlib import Path
from typing import Any

from beam_ros.hub.errors import HubConnectionError, PortDeniedError
from beam_ros.hub.faults import fault

WRITE_TIMEOUT_S = 0.25
WRITE_WAIT_S = 0.01
"""Longest wait for a port to take more [s], and the most that counts of it: a frozen process does not wait."""
BLOCKING_READ_S = 0.005
"""Longest wait in a port that has no descriptor to wait on [s]; nothing ends it early."""
RECONNECT_S = 0.3
"""A port that was lost is tried again after this time [s]."""
MOST_AT_ONCE = 16_384
"""Bytes of one read."""
WINDOW_NS = 1_000_000_000
"""Bytes are counted over this time."""


class SerialTransport:
    """A port that is open or closed; every fault is a ``HubConnectionError``.

    Parameters
    ----------
    port : str
        Path or URL of the port.
    baud : int
        Bits per second.
    most_bytes : int
        More than this in a second is a flood.

    Raises
    ------
    HubConnectionError
        The port is not named, or its URL is of a kind that pyserial does not know: waiting would not help.
    """

    def __init__(self, port: str, baud: int, most_bytes: int) -> None:
        self._port = port
        self._baud = baud
        self._most_bytes = most_bytes
        self._serial: Any = None
        self._descriptor: int | None = None
        self._is_plain = False
        self._counted_since_ns = 0
        self._n_counted = 0
        if not port:
            raise HubConnectionError(
                'serial.port is "": expected the port of the motion controller'
                f"{_present_ports()}; set serial.port in the rig file"
            )
        self._unopened()
        self._waker, self._woken = socket.socketpair()
        for end in (self._waker, self._woken):
            end.setblocking(False)

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._serial is not None

    def open(self) -> None:
        """Open the port and throw away what waited in it.

        Raises
        ------
        HubConnectionError
            The port is not there; ``PortDeniedError`` where it is there, and not permitted or in use.
        """
        port = self._unopened()
        try:
            port.open()
            self._serial = port
            self._descriptor = _descriptor_of(port)
            self._is_plain = self._descriptor is not None and _is_plain(port)
            if self._descriptor is None:
                port.timeout = BLOCKING_READ_S
            else:
                # RFC 2217, which has no descriptor, refuses a time-out of writing.
                port.timeout, port.write_timeout = 0, WRITE_TIMEOUT_S
            port.reset_input_buffer()
        except Exception as err:
            self.close()
            raise self._unavailable(err) from err
        self._counted_since_ns = self._n_counted = 0

    def close(self) -> None:
        """Close the port, whatever state it is in."""
        port, self._serial, self._descriptor = self._serial, None, None
        if port is not None:
            with contextlib.suppress(Exception):  # It is gone already, which is what was wanted.
                port.close()

    def dispose(self) -> None:
        """Close the port for good."""
        self.close()
        self._waker.close()
        self._woken.close()

    def write(self, data: bytes) -> None:
        """Send bytes; takes ``WRITE_TIMEOUT_S`` at the most, and for as long as the process is frozen.

        Raises
        ------
        HubConnectionError
            The port vanished, or does not take the bytes in time.
        """
        if data:
            try:
                if self._descriptor is not None and self._is_plain:
                    _write(self._descriptor, data)
                else:
                    self._serial.write(data)
            except Exception as err:
                raise self._lost(err) from err

    def read(self, timeout_s: float) -> tuple[bytes, int]:
        """Wait for bytes; return those that are there, and a steady time by which all of them had come [ns].

        Parameters
        ----------
        timeout_s : float
            How long to wait; ``wake`` ends it early.

        Raises
        ------
        HubConnectionError
            The port vanished, or more bytes come than an axis can say.
        """
        try:
            if self._descriptor is None:
                data = self._serial.read(1)
                if data:
                    data += self._serial.read(min(self._serial.in_waiting, MOST_AT_ONCE))
                arrived_ns = time.monotonic_ns()
            else:
                watched: list[Any] = [self._descriptor, self._woken]
                ready, _, _ = select.select(watched, [], [], timeout_s)
                if self._woken in ready:
                    self._woken.recv(MOST_AT_ONCE)
                # Before the clock is read: a process that is put aside behind it would read what came meanwhile.
                n_there = self._there() if self._descriptor in ready else 0
                arrived_ns = time.monotonic_ns()
                data = self._serial.read(n_there) if n_there else b""
                if not self._is_plain:
                    arrived_ns = time.monotonic_ns()
        except Exception as err:
            raise self._lost(err) from err
        self._count(len(data), arrived_ns)
        return bytes(data), arrived_ns

    def _there(self) -> int:
        """Return how many bytes have come; at least one, so that reading tells of a port that is gone."""
        return min(max(self._serial.in_waiting, 1), MOST_AT_ONCE) if self._is_plain else MOST_AT_ONCE

    def wake(self) -> None:
        """End a wait in ``read``; may be called from another thread."""
        with contextlib.suppress(OSError):  # Woken often enough already, or closed for good: nobody waits.
            self._waker.send(b"!")

    def _unopened(self) -> Any:
        import serial  # Only a real axis needs pyserial.

        try:
            return serial.serial_for_url(self._port, self._baud, do_not_open=True, exclusive=True)
        except Exception as err:
            raise HubConnectionError(
                f"serial.port is {self._port!r}: {err}; expected a device such as /dev/serial/by-id/... or a URL "
                "such as socket://host:4000 or rfc2217://host:4000; correct it in the rig file"
            ) from err

    def _count(self, n_bytes: int, now_ns: int) -> None:
        """Give the port up where more comes than an axis can say; else the host would do nothing but listen."""
        if now_ns - self._counted_since_ns > WINDOW_NS:
            self._counted_since_ns, self._n_counted = now_ns, 0
        self._n_counted += n_bytes
        if self._n_counted > self._most_bytes:
            cause = fault("line_flooded")
            raise HubConnectionError(
                f"serial port {self._port} brought {self._n_counted} bytes within a second: expected at most "
                f"{self._most_bytes}; {cause.remedy}",
                cause,
            )

    def _lost(self, err: Exception) -> HubConnectionError:
        text = str(err) or type(err).__name__
        return HubConnectionError(
            f"serial port {self._port} was lost: {text}; expected a connected controller; check cable and power",
            fault("port_lost"),
        )

    def _unavailable(self, err: Exception) -> HubConnectionError:
        kind = HubConnectionError
        expected, remedy = "a serial port", f"check serial.port and serial.baud ({self._baud})"
        number = _number_of(err)
        if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
            expected = f"an existing port{_present_ports()}"
            remedy = "connect the controller or correct serial.port"
        elif number in (errno.EACCES, errno.EPERM):
            kind, expected, remedy = PortDeniedError, "permission to use it", _permission(self._port)
        elif number in (errno.EBUSY, errno.EAGAIN):
            kind, expected, remedy = (
                PortDeniedError,
                "a port that no other program uses",
                "close the other program",
            )
        elif number in (errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ETIMEDOUT):
            expected, remedy = "a serial server that listens there", "start it, or correct serial.port"
        text = str(err) or type(err).__name__
        return kind(f"serial port {self._port} cannot be opened: {text}; expected {expected}; {remedy}")


def _descriptor_of(port: Any) -> int | None:
    """Return what the system can wait on for a port's bytes, where there is such a thing."""
    try:
        return int(port.fileno())
    except (AttributeError, io.UnsupportedOperation):
        return None


def _is_plain(port: Any) -> bool:
    """Say whether a port is a device and nothing else: ``spy://`` and others do more with bytes than send them."""
    import serial

    return os.name == "posix" and type(port) is serial.Serial


def _write(descriptor: int, data: bytes) -> None:
    """Write to a descriptor that does not block.

    pyserial looks at its time-out also when all bytes were taken, so that a process that is frozen within its
    ``write`` loses a port that works. Here the port is asked once more before it is given up, and of a time in which
    the process was frozen ``WRITE_WAIT_S`` counts at the most.

    Raises
    ------
    TimeoutError
        The port did not take the bytes in time.
    OSError
        The port vanished.
    """
    waited_s, last_s, rest = 0.0, time.monotonic(), memoryview(data)
    while True:
        with contextlib.suppress(BlockingIOError):
            rest = rest[os.write(descriptor, rest) :]
        if not rest:
            return
        if waited_s >= WRITE_TIMEOUT_S:
            raise TimeoutError(
                f"it took {len(data) - len(rest)} of {len(data)} bytes within {WRITE_TIMEOUT_S:g} s"
            )
        select.select([], [descriptor], [], WRITE_WAIT_S)
        now_s = time.monotonic()
        waited_s += min(now_s - last_s, WRITE_WAIT_S)
        last_s = now_s


def _number_of(err: BaseException | None) -> int | None:
    """Return the system's number of an error, which pyserial may have wrapped."""
    while err is not None:
        number = getattr(err, "errno", None)
        if isinstance(number, int):
            return number
        err = err.__cause__ or err.__context__
    return None


def _permission(port: str) -> str:
    """Say how to be allowed to use a port: by its group, or by a rule where it has none for people."""
    import grp  # Not on Windows, where nobody is denied a port in this way.

    try:
        group = grp.getgrgid(os.stat(port).st_gid).gr_name
    except (OSError, KeyError):
        group = "dialout"
    if group == "root":
        return "it belongs to root alone: install the udev rule of docs/serial-port.md and plug it in again"
    return f"run `sudo usermod -aG {group} $USER` and log in again, or see docs/serial-port.md"


def _present_ports() -> str:
    from serial.tools import list_ports

    lasting = {os.path.realpath(link): str(link) for link in Path("/dev/serial/by-id").glob("*")}
    names = sorted(port.device for port in list_ports.comports())
    told = [f"{name} = {lasting[name]}" if name in lasting else name for name in names]
    return f" (present: {', '.join(told)})" if told else " (none is present)"
