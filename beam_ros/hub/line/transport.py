"""Bytes over a serial port, and what can be wrong with the port."""

from __future__ import annotations

import errno
import time
from typing import Any

from beam_ros.hub.errors import HubConnectionError

WRITE_TIMEOUT_S = 0.25


class SerialTransport:
    """A serial port that is open or closed; every fault is a ``HubConnectionError``.

    Parameters
    ----------
    port : str
        Path or name of the port.
    baud : int
        Bits per second.
    """

    def __init__(self, port: str, baud: int) -> None:
        self._port = port
        self._baud = baud
        self._serial: Any = None

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._serial is not None

    def open(self) -> None:
        """Open the port and throw away what waited in it.

        Raises
        ------
        HubConnectionError
            The port is not named, not there, not permitted or in use.
        """
        if not self._port:
            raise HubConnectionError(
                'serial.port is "": expected the port of the motion controller'
                f"{_present_ports()}; set serial.port in the rig file"
            )
        import serial  # Only a real axis needs pyserial.

        try:
            self._serial = serial.Serial(
                self._port, self._baud, timeout=0, write_timeout=WRITE_TIMEOUT_S, exclusive=True
            )
            self._serial.reset_input_buffer()
        except (OSError, ValueError) as err:
            self.close()
            raise HubConnectionError(self._explain(err)) from err

    def close(self) -> None:
        """Close the port, whatever state it is in."""
        port, self._serial = self._serial, None
        if port is not None:
            try:
                port.close()
            except OSError:
                return  # It is gone already, which is what was wanted.

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises
        ------
        HubConnectionError
            The port vanished or takes nothing.
        """
        if data:
            try:
                self._serial.write(data)
            except OSError as err:
                raise self._lost(err) from err

    def read(self, timeout_s: float) -> tuple[bytes, int]:
        """Wait for bytes; return those that are there, and the steady time at which the first came [ns].

        Parameters
        ----------
        timeout_s : float
            How long to wait; ``wake`` ends it early.

        Raises
        ------
        HubConnectionError
            The port vanished.
        """
        try:
            self._serial.timeout = timeout_s
            data = self._serial.read(1)
            arrived_ns = time.monotonic_ns()
            waiting = self._serial.in_waiting if data else 0
            if waiting:
                data += self._serial.read(waiting)
        except (OSError, TypeError) as err:
            raise self._lost(err) from err
        return data, arrived_ns

    def wake(self) -> None:
        """End a wait in ``read``; may be called from another thread."""
        port = self._serial
        if port is not None:
            try:
                port.cancel_read()
            except (OSError, AttributeError, TypeError):
                return  # Closed meanwhile: nobody waits.

    def _lost(self, err: Exception) -> HubConnectionError:
        return HubConnectionError(
            f"serial port {self._port} was lost: {err}; expected a connected controller; check cable and power"
        )

    def _explain(self, err: Exception) -> str:
        number = getattr(err, "errno", None)
        expected, remedy = "a serial port", f"check serial.port and serial.baud ({self._baud})"
        if number == errno.ENOENT:
            expected, remedy = (
                f"an existing port{_present_ports()}",
                "connect the controller or correct serial.port",
            )
        elif number == errno.EACCES:
            expected, remedy = "permission to use it", "add yourself to the group `dialout` and log in again"
        elif number in (errno.EBUSY, errno.EAGAIN):
            expected, remedy = "a port that no other program uses", "close the other program"
        return f"serial port {self._port} cannot be opened: {err}; expected {expected}; {remedy}"


def _present_ports() -> str:
    from serial.tools import list_ports

    names = sorted(port.device for port in list_ports.comports())
    return f" (present: {', '.join(names)})" if names else " (none is present)"
