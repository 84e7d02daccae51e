"""What runs a built firmware: an emulated processor for a microcontroller's, this computer for its own.

Two sockets lead to it: the host's line, and the plant port.
"""

from __future__ import annotations

import contextlib
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from beam_ros.hub.errors import HubConnectionError, HubParameterError

START_S = 20.0
"""The longest time until a firmware is connected [s]."""
STARTS_ADDRESS = 0x2001FFF8
"""Where the firmware of the STM32F405 counts its starts, in memory that a reset leaves alone."""
PACING_ADDRESS = STARTS_ADDRESS + 4
"""Where it looks whether an emulator paces the time."""
PACED = 0x50414345
INSTRUCTION_SHIFT = 0
"""Where time is counted in instructions, one takes 2^0 ns."""

_ELF_MACHINE = slice(18, 20)
_ARM = (40).to_bytes(2, "little")
_QEMU = "qemu-system-arm"


class FirmwareMachine:
    """One run of a firmware, from power-on to power-off.

    Parameters
    ----------
    file : path
        The built firmware with a plant port, an ELF file for the STM32F405 or for this computer.
    n_starts : int
        Another one for every start, from which the firmware makes its boot id.
    options : sequence of str
        More arguments for QEMU or for the program.
    is_paced : bool
        Whether time goes on only when the plant has answered, counted in instructions; an STM32F405's alone can.

    Attributes
    ----------
    line, plant : socket
        The host's line and the plant port.
    bell : socket or None
        Where a byte tells a microcontroller's firmware that the plant has said something, and where a paced one
        tells that it waits for the plant; a program has none.

    Raises
    ------
    HubParameterError
        There is no such file, or it is no ELF.
    HubConnectionError
        QEMU is missing, or the firmware does not start.
    """

    def __init__(
        self, file: str | Path, n_starts: int = 0, options: Sequence[str] = (), *, is_paced: bool = False
    ) -> None:
        file = Path(file)
        is_for_arm = _is_for_arm(file)
        if is_for_arm and shutil.which(_QEMU) is None:
            raise HubConnectionError(
                f"firmware {file}: is for an STM32F405, and {_QEMU} is not installed; install the package "
                f"{_QEMU} of Debian or Ubuntu, or give a firmware built for this computer"
            )
        if is_paced and not is_for_arm:
            raise HubParameterError(
                f"firmware {file}: runs in real time on this computer; expected one for the STM32F405, which an "
                "emulator can pace"
            )
        self._file, self._options = file, options
        self._process: subprocess.Popen[bytes] | None = None
        self.bell: socket.socket | None = None
        with contextlib.ExitStack() as stack:
            self._log = stack.enter_context(tempfile.TemporaryFile())
            stack.callback(self._end)
            start = self._start_qemu if is_for_arm else self._start_program
            self.line, self.plant = (stack.enter_context(end) for end in start(n_starts, is_paced))
            self._resources = stack.pop_all()

    @property
    def is_running(self) -> bool:
        """Whether the firmware still runs."""
        return self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int:
        """Number of its process."""
        assert self._process is not None
        return self._process.pid

    def ring(self) -> None:
        """Let a firmware look for a message of the plant before its next tick."""
        if self.bell is not None:
            with contextlib.suppress(OSError):
                self.bell.sendall(b"\x01")

    def close(self) -> None:
        """Switch it off."""
        self._resources.close()
        if self.bell is not None:
            self.bell.close()

    def _start_qemu(self, n_starts: int, is_paced: bool) -> tuple[socket.socket, socket.socket]:
        """Start a processor that runs the firmware instruction by instruction.

        Its plant port is the debugger's channel; a byte on the second serial port says that a message waits.
        """
        # The serial port sends every byte by itself. TCP puts them together, and so holds far more of them; a local
        # pair tells when they have been taken.
        line, its_line = socket.socketpair() if is_paced else _tcp_pair()
        (plant, its_plant), (self.bell, its_bell) = socket.socketpair(), socket.socketpair()
        its_plant.setblocking(False)
        with its_line, its_plant, its_bell:
            self._popen(
                [
                    *(_QEMU, "-machine", "netduinoplus2", "-kernel", str(self._file)),
                    *("-nodefaults", "-display", "none", "-monitor", "none"),
                    *("-chardev", f"socket,id=line,fd={its_line.fileno()}", "-serial", "chardev:line"),
                    *("-chardev", f"socket,id=bell,fd={its_bell.fileno()}", "-serial", "chardev:bell"),
                    *("-semihosting-config", "enable=on,target=native"),
                    *_stored(STARTS_ADDRESS, n_starts),
                    *(_stored(PACING_ADDRESS, PACED) if is_paced else ()),
                    *(("-icount", f"shift={INSTRUCTION_SHIFT},sleep=off") if is_paced else ()),
                ],
                channel=its_plant.fileno(),
                passed=(its_line.fileno(), its_bell.fileno()),
            )
        return line, plant

    def _start_program(self, _n_starts: int, _is_paced: bool) -> tuple[socket.socket, socket.socket]:
        """Start the firmware as a program, which prints the ports on which it listens."""
        self._popen([str(self._file), "--listen", "0", "--plant", "0"])
        deadline = time.monotonic() + START_S
        while True:
            urls = dict(line.split() for line in self._words() if line.count(" ") == 1)
            if {"host", "plant"} <= urls.keys():
                return _connected(urls["host"]), _connected(urls["plant"])
            if not self.is_running or time.monotonic() > deadline:
                raise HubConnectionError(
                    f"firmware {self._file}: says no ports ({self.last_words}); expected the program "
                    "beam-firmware; build it again with `make firmware`"
                )
            time.sleep(0.01)

    def _popen(
        self,
        command: Sequence[str],
        channel: int | None = None,
        passed: Sequence[int] = (),
    ) -> None:
        # The kernel ends it with this process, however that ends.
        with_parent = ["setpriv", "--pdeathsig", "KILL"] if shutil.which("setpriv") else []
        self._process = subprocess.Popen(
            [*with_parent, *command, *self._options],
            stdin=subprocess.DEVNULL if channel is None else channel,
            stdout=self._log if channel is None else channel,
            stderr=self._log,
            pass_fds=passed,
            start_new_session=True,
        )

    @property
    def last_words(self) -> str:
        """The last line that it printed, for a message about its end."""
        words = self._words()
        return words[-1] if words else "it printed nothing"

    def _words(self) -> list[str]:
        self._log.seek(0)
        return self._log.read().decode(errors="replace").splitlines()

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()


def _is_for_arm(file: Path) -> bool:
    try:
        with file.open("rb") as stream:
            head = stream.read(_ELF_MACHINE.stop)
    except OSError as err:
        raise HubParameterError(
            f"firmware {file}: {err.strerror}; expected a file that `make firmware` has built"
        ) from err
    if not head.startswith(b"\x7fELF") or len(head) < _ELF_MACHINE.stop:
        raise HubParameterError(
            f"firmware {file}: is no ELF file; expected a file that `make firmware` has built"
        )
    return head[_ELF_MACHINE] == _ARM


def _stored(address: int, word: int) -> tuple[str, str]:
    """Return QEMU's arguments that put a word into the memory at every reset."""
    return "-device", f"loader,addr={address:#x},data={word:#x},data-len=4"


def _tcp_pair() -> tuple[socket.socket, socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = socket.create_connection(server.getsockname())
        theirs = server.accept()[0]
    for end in (ours, theirs):
        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return ours, theirs


def _connected(url: str) -> socket.socket:
    address, _, port = url.removeprefix("socket://").rpartition(":")
    end = socket.create_connection((address, int(port)))
    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return end
