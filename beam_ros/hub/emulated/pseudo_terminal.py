"""A pseudo-terminal whose cable can be pulled and put in again, under a link that stays."""

from __future__ import annotations

import contextlib
import os
import tty
from pathlib import Path

from beam_ros.hub.errors import HubConnectionError

MAX_BACKLOG = 65_536
"""Bytes that wait where the line takes no more [2.7 s of telemetry]."""


class PseudoTerminal:
    """The device's end of a serial port.

    Parameters
    ----------
    link : path, optional
        A symbolic link to keep pointing at the terminal, which has another name after every ``plug``.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._link = link
        self._ends: tuple[int, int] | None = None
        self._path = ""
        self._backlog = bytearray()

    @property
    def port(self) -> str:
        """Path under which a driver opens it as a serial port."""
        return self._path if self._link is None else str(self._link)

    @property
    def descriptor(self) -> int | None:
        """What to wait for; None while the cable is out."""
        return None if self._ends is None else self._ends[0]

    def plug(self) -> None:
        """Put the cable in: a new terminal, under the same link.

        Raises
        ------
        HubConnectionError
            There is no pseudo-terminal available, or the link cannot be made.
        """
        try:
            self._ends = master, slave = os.openpty()
        except OSError as err:
            raise HubConnectionError(
                f"no pseudo-terminal for the emulated controller: {err}; expected a mounted /dev/pts; "
                "close programs that hold many terminals"
            ) from err
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._path = os.ttyname(slave)
        if self._link is not None:
            self._point(self._link)

    def unplug(self) -> None:
        """Pull the cable: the port vanishes, and with it what waited for it."""
        link = self._link
        # The terminal's number may be somebody else's at once, and the link another emulator's already.
        if link is not None and link.is_symlink() and os.readlink(link) == self._path:
            link.unlink()
        for end in self._ends or ():
            os.close(end)
        self._ends = None
        self._backlog.clear()

    def read(self) -> bytes:
        """Return what has come."""
        with contextlib.suppress(OSError):
            if self._ends is not None:
                return os.read(self._ends[0], 65536)
        return b""

    def write(self, data: bytes) -> None:
        """Write what the line takes, and keep the rest for later; beyond the backlog it is lost."""
        if self._ends is None:
            return
        if len(self._backlog) + len(data) <= MAX_BACKLOG:
            self._backlog += data
        if self._backlog:
            with contextlib.suppress(OSError):
                del self._backlog[: os.write(self._ends[0], self._backlog)]

    def _point(self, link: Path) -> None:
        try:
            if link.is_symlink():
                link.unlink()
            link.symlink_to(self._path)
        except OSError as err:
            raise HubConnectionError(
                f"link {link} to the emulated port {self._path}: {err}; expected a writable "
                "folder and no file of that name; choose another emulator.port_link"
            ) from err
