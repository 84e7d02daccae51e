"""An emulated ODrive: its ASCII protocol, its properties, its watchdog, with the beam on its motor.

Written from the documentation of firmware 0.5 (ascii-protocol.rst, and the lists of properties and faults of 0.5.6)
and from what drives with it were seen to do, not from the host's side of this suite: the two meet on the wire. What
the documentation does not say: a register of 64 bits is printed as ``lu`` (ODrive's issue 571), an answer is cut
after nine characters, a request for a state takes effect in the drive's own loop, and a fault of the motor need not
show in the register of its axis.
"""

from __future__ import annotations

from functools import reduce
from operator import xor

from beam_ros.hub.emulated.servo import ServoAxis

_IDLE, _CLOSED_LOOP = 1, 8
_WATCHDOG_TIMER_EXPIRED = 0x800
_INVALID_STATE = 0x1
_OVERSPEED = 0x1
_CONTROLLER_FAILED = 0x200
_ANSWER_CHARACTERS = 9
"""The firmware prints a property into ten bytes, of which the last is the end of the text."""
_VERSION = ("major", "minor", "revision")
_REGISTERS = (
    "error",
    "axis0.error",
    "axis0.motor.error",
    "axis0.controller.error",
    "axis0.encoder.error",
    "axis0.sensorless_estimator.error",
)


class EmulatedOdrive:
    """An ODrive with one axis in use, number 0.

    Parameters
    ----------
    axis : ServoAxis
        The motor, with the hub on it.
    metres_per_turn : float
        Travel of the hub for one turn [m].
    has_watchdog : bool, optional
        False: a firmware whose watchdog does not run when it is set over ASCII (ODrive's issue 460).
    prints_64_bits : bool, optional
        True: a firmware that was built with a C library that can print them.
    closing_s : float, optional
        How long the drive takes until it leads the motor [s]; 0: at once, as the documentation has it.
    version : (int, int, int), optional
        What it says of its firmware.
    """

    def __init__(
        self,
        axis: ServoAxis,
        *,
        metres_per_turn: float = 1.0,
        has_watchdog: bool = True,
        prints_64_bits: bool = False,
        closing_s: float = 0.02,
        version: tuple[int, int, int] = (0, 5, 6),
    ) -> None:
        self.axis = axis
        self._turn = metres_per_turn
        self._has_watchdog = has_watchdog
        self._prints_64_bits = prints_64_bits
        self._closing_ns = round(closing_s * 1e9)
        self._closed_ns: int | None = None
        self._fed_ns = self._now_ns = axis.device_ns
        self._input = b""
        self._position = self.axis.true_position
        self._velocity = 0.0
        self._properties: dict[str, float] = {
            "vbus_voltage": 24.0875,
            **{f"fw_version_{part}": number for part, number in zip(_VERSION, version, strict=True)},
            "axis0.requested_state": 0,
            "axis0.current_state": _IDLE,
            **dict.fromkeys(_REGISTERS, 0),
            "axis0.config.enable_watchdog": 0,
            "axis0.config.watchdog_timeout": 0.0,
            "axis0.controller.config.control_mode": 3,
            "axis0.controller.config.input_mode": 1,
            "axis0.controller.config.vel_limit": 2.0,
            "axis0.controller.config.enable_overspeed_error": 1,
        }
        self._read_only = {
            "vbus_voltage",
            "axis0.current_state",
            *(f"fw_version_{part}" for part in _VERSION),
        }

    def exchange(self, data: bytes, device_ns: int) -> bytes:
        """Advance to a device time [ns], do what the bytes say, and return the answers."""
        self._now_ns = device_ns
        self.axis.speed_limit = self._properties["axis0.controller.config.vel_limit"] * abs(self._turn)
        self.axis.advance(device_ns, self._command)
        self._watch()
        self._close_loop()
        *lines, self._input = (self._input + data).split(b"\n")
        self._input = self._input[-256:]
        return b"".join(map(self._answer, lines))

    def fail(self, register: str, bits: int) -> None:
        """Let a fault come about: a register such as ``axis0.motor.error``, and its bits."""
        self._properties[register] = int(self._properties[register]) | bits
        self._properties["axis0.current_state"] = _IDLE
        self._closed_ns = None

    def _command(self, device_ns: int) -> tuple[float, float] | None:
        if self._properties["axis0.current_state"] != _CLOSED_LOOP or self._is_overdue(device_ns):
            return None
        return self._position, self._velocity

    def _is_overdue(self, device_ns: int) -> bool:
        patience_ns = self._properties["axis0.config.watchdog_timeout"] * 1e9
        is_on = self._has_watchdog and bool(self._properties["axis0.config.enable_watchdog"])
        return is_on and device_ns - self._fed_ns > patience_ns

    def _watch(self) -> None:
        if self._is_overdue(self._now_ns):
            self.fail("axis0.error", _WATCHDOG_TIMER_EXPIRED)
        limit = self.axis.speed_limit * 1.2
        if (
            self._properties["axis0.current_state"] == _CLOSED_LOOP
            and self._properties["axis0.controller.config.enable_overspeed_error"]
            and abs(self.axis.velocity) > limit
        ):
            self.fail("axis0.controller.error", _OVERSPEED)
            self.fail("axis0.error", _CONTROLLER_FAILED)

    def _answer(self, line: bytes) -> bytes:
        body = line.partition(b";")[0].strip(b"\r\n")
        command, star, checksum = body.rpartition(b"*")
        if not star:
            command = body
        elif not checksum.strip().isdigit() or int(checksum) != reduce(xor, command, 0):
            return b""
        try:
            words = command.decode("ascii").split()
            text = self._do(words) if words else ""
        except (ValueError, IndexError):
            text = "invalid command format"
        if not text:
            return b""
        answer = text.encode("ascii")
        return answer + (b"*%d" % reduce(xor, answer) if star else b"") + b"\r\n"

    def _do(self, words: list[str]) -> str:
        """Do one command; return its answer, empty where it has none."""
        verb = words[0]
        if verb in ("p", "v", "c", "t", "q", "u", "f"):
            if int(words[1]) != 0:
                return "invalid motor 1"
            return self._do_motor(verb, [float(word) for word in words[2:]])
        if verb == "r":
            value = self._properties.get(words[1])
            return "invalid property" if value is None else self._printed(words[1], value)
        if verb == "w":
            return self._set(words[1], float(words[2]))
        if verb == "sc":
            self._properties.update(dict.fromkeys(_REGISTERS, 0))
            return ""
        return "unknown command"

    def _do_motor(self, verb: str, values: list[float]) -> str:
        if verb == "f":
            position = self.axis.position_at(self._now_ns) / self._turn
            return f"{position:f} {self.axis.velocity / self._turn:f}"
        self._fed_ns = self._now_ns
        if verb == "p":
            self._position = values[0] * self._turn
            self._velocity = values[1] * self._turn if len(values) > 1 else 0.0
        return ""

    def _set(self, path: str, value: float) -> str:
        if path not in self._properties or path in self._read_only:
            return "invalid property"
        self._properties[path] = value
        if path == "axis0.requested_state":
            self._request_state(int(value))
        elif path.startswith("axis0.config."):
            self._fed_ns = self._now_ns
        return ""

    def _request_state(self, state: int) -> None:
        # A request forgets that the one before it could not be met.
        self._properties["axis0.error"] = int(self._properties["axis0.error"]) & ~_INVALID_STATE
        self._closed_ns = None
        if state == _CLOSED_LOOP and not any(self._properties[path] for path in _REGISTERS):
            self._closed_ns = self._now_ns + self._closing_ns
            self._close_loop()
        elif state == _IDLE:
            self._properties["axis0.current_state"] = _IDLE
        else:
            self.fail("axis0.error", _INVALID_STATE)

    def _close_loop(self) -> None:
        """Lead the motor, once the drive has got as far."""
        if self._closed_ns is not None and self._now_ns >= self._closed_ns:
            self._closed_ns = None
            # Where the motor stands is what it holds, until a command says otherwise.
            self._position, self._velocity = self.axis.true_position, 0.0
            self._properties["axis0.current_state"] = _CLOSED_LOOP

    def _printed(self, path: str, value: float) -> str:
        if path == "axis0.motor.error" and not self._prints_64_bits:
            return "lu"
        is_real = path.endswith(("voltage", "timeout", "limit"))
        return (f"{value:f}" if is_real else str(int(value)))[:_ANSWER_CHARACTERS]
