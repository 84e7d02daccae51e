"""An ODrive behind its ASCII protocol: the host writes every position, and asks for every measurement.

What is due is written with the command ``p`` (position, with the velocity as feed-forward), and ``f`` asks where the
motor is. The ODrive's own watchdog is set, read back and provoked before it is believed: set over ASCII it once did
not run (https://github.com/odriverobotics/ODrive/issues/460).
"""

from __future__ import annotations

import itertools

from beam_ros.hub.errors import HubConnectionError, HubProtocolError
from beam_ros.hub.faults import fault
from beam_ros.hub.link_parameters import OdriveParameters
from beam_ros.hub.links import odrive_protocol as ascii_protocol
from beam_ros.hub.links.polled_hub import DriveFaults, PolledDrive, PolledHub, capabilities
from beam_ros.hub.links.query_line import Answer, QueryLine, UnreadableAnswerError
from beam_ros.hub.parameters import AxisParameters

CAPABILITIES = capabilities(
    "odrive",
    "the drive keeps the speed limit alone: travel and acceleration are kept by this program, not by the drive",
    "when the host falls silent the drive switches the motor off, so that the hub coasts instead of braking",
)


class Odrive(PolledDrive):
    """One axis of an ODrive.

    Parameters
    ----------
    line : QueryLine
        The way to it.
    settings : OdriveParameters
        Which of its axes.
    """

    name = "the ODrive"
    capabilities = CAPABILITIES
    is_fed_by_questions = False
    restarts_to_clear = False

    def __init__(self, line: QueryLine, settings: OdriveParameters) -> None:
        self._line = line
        self._registers = itertools.cycle(ascii_protocol.SHORT_REGISTERS)
        self.axis = settings.axis

    # Questions and orders ------------------------------------------------------------------------------

    def tell(self, command: str) -> None:
        """Send a command that has no answer."""
        self._line.tell(ascii_protocol.encode_line(command))

    def ask(self, command: str) -> tuple[str, Answer]:
        """Send a question; return the answer's text, and the answer with its times.

        Raises
        ------
        HubProtocolError
            No answer, or a spoilt one.
        HubConnectionError
            The port vanished.
        """
        answer = self._line.ask(ascii_protocol.encode_line(command), command, ascii_protocol.take_line)
        return ascii_protocol.decode_line(answer.data), answer

    def numbers(self, question: str, count: int) -> tuple[tuple[float, ...], Answer]:
        """Send a question that numbers answer; return them, and the answer with its times.

        Raises
        ------
        UnreadableAnswerError
            The answer is no such numbers.
        HubProtocolError
            No answer, or a spoilt one.
        """
        text, answer = self.ask(question)
        try:
            return ascii_protocol.numbers(text, count, question), answer
        except UnreadableAnswerError:
            # It may be the refusal of an earlier command: then the answer to this question is still to come.
            self._line.drain()
            raise

    def read(self, path: str) -> float:
        """Return a property of the axis."""
        return self.property(f"axis{self.axis}.{path}")

    def property(self, path: str) -> float:
        """Return a property of the ODrive."""
        (value,), _ = self.numbers(f"r {path}", 1)
        return value

    def write(self, path: str, value: float) -> None:
        """Set a property of the axis and read it back.

        Raises
        ------
        HubProtocolError
            The ODrive keeps another value.
        """
        self.tell(f"w axis{self.axis}.{path} {value:.9g}")
        kept = self.read(path)
        if not abs(kept - value) <= 1e-5 * abs(value) + ascii_protocol.PRINTED_STEP:
            raise HubProtocolError(
                f"axis{self.axis}.{path} is {kept:g} after it was set to {value:g}: expected the value that was "
                "set; update the ODrive's firmware"
            )

    def version(self) -> tuple[int, int, int]:
        """Return the firmware's version."""
        major, minor, revision = (
            int(self.property(f"fw_version_{part}")) for part in ("major", "minor", "revision")
        )
        return major, minor, revision

    # The drive -----------------------------------------------------------------------------------------

    def prepare(self, parameters: AxisParameters, metres_per_turn: float) -> tuple[str, float]:
        """Switch the motor off, set modes, limits and watchdog; return what it is, and its watchdog's time [s]."""
        try:
            objection = ascii_protocol.version_objection(self.version())
        except UnreadableAnswerError as err:
            raise HubConnectionError(str(err), fault("wrong_version")) from err
        if objection:
            raise HubConnectionError(objection, fault("wrong_version"))
        self.let_go()
        self.write("config.enable_watchdog", 0)
        self.write("controller.config.control_mode", ascii_protocol.POSITION_CONTROL)
        self.write("controller.config.input_mode", ascii_protocol.PASSTHROUGH)
        self.write("controller.config.vel_limit", parameters.max_speed / abs(metres_per_turn))
        self.write("controller.config.enable_overspeed_error", 1)
        self.write("config.watchdog_timeout", parameters.watchdog_s)
        self.forgive_silence()
        self.write("config.enable_watchdog", 1)
        return f"ODrive axis {self.axis}", parameters.watchdog_s

    def feed(self) -> None:
        """Feed the watchdog."""
        self.tell(f"u {self.axis}")

    def is_expired(self) -> bool:
        """Return whether the watchdog has acted."""
        return bool(int(self.read("error")) & ascii_protocol.WATCHDOG_EXPIRED)

    def forgive_silence(self) -> None:
        """Clear the watchdog's fault, and no other: ``sc`` would clear what nobody has seen.

        Fed first: a watchdog that is cleared while it is overdue acts again at once.
        """
        self.feed()
        value = int(self.read("error"))
        if value & ascii_protocol.WATCHDOG_EXPIRED:
            self.tell(f"w axis{self.axis}.error {value & ~ascii_protocol.WATCHDOG_EXPIRED}")

    def measure(self) -> tuple[float, float, Answer]:
        """Return where the motor is [turns], its speed [turns/s], and the answer that says so, with its times."""
        (turns, speed), answer = self.numbers(f"f {self.axis}", 2)
        return turns, speed, answer

    def lead(self, turns: float, speed: float) -> None:
        """Write where the motor is to be [turns], and how fast [turns/s]."""
        self.tell(f"p {self.axis} {turns:.9f} {speed:.6f}")

    def look(self, is_on: bool) -> str:
        """Return the state of an axis that has dropped the motor, or where the next register holds a fault."""
        state = int(self.read("current_state"))
        has_dropped = is_on and state != ascii_protocol.CLOSED_LOOP
        return f"state {state}" if self._has_fault(next(self._registers)) or has_dropped else ""

    def _has_fault(self, register: str) -> bool:
        """Return whether a register of ``SHORT_REGISTERS`` holds a fault, the watchdog's apart."""
        value = int(self.property(register.format(self.axis)))
        if register == ascii_protocol.AXIS_REGISTER:
            value &= ~ascii_protocol.WATCHDOG_EXPIRED
        return value != 0

    def faults(self) -> DriveFaults:
        """Return what can be read of the faults."""
        names: list[str] = []
        unreadable: list[str] = []
        is_expired = False
        for register in ascii_protocol.FAULT_REGISTERS:
            path = register.format(self.axis)
            text, _ = self.ask(f"r {path}")
            if not text.isdecimal():
                unreadable.append(f"{path} cannot be read ({text!r})")
                continue
            value = int(text)
            if register == ascii_protocol.AXIS_REGISTER:
                is_expired = bool(value & ascii_protocol.WATCHDOG_EXPIRED)
                value &= ~ascii_protocol.WATCHDOG_EXPIRED
            names += ascii_protocol.fault_names(register, self.axis, value)
        known = ", ".join(names + ["WATCHDOG_TIMER_EXPIRED"] * is_expired) or "no fault that can be read"
        remedy = f"; {', '.join(unreadable)}: see dump_errors(odrv0) in odrivetool" if unreadable else ""
        return DriveFaults(tuple(names), is_expired, known + remedy)

    def clear_faults(self) -> None:
        """Clear them all."""
        self.tell("sc")

    def take_motor(self, turns: float) -> None:
        """Switch the motor on, to hold where it stands."""
        self.lead(turns, 0.0)
        self.tell(f"w axis{self.axis}.requested_state {ascii_protocol.CLOSED_LOOP}")

    def has_motor(self) -> bool:
        """Return whether the motor is led."""
        return int(self.read("current_state")) == ascii_protocol.CLOSED_LOOP

    def let_go(self) -> None:
        """Switch the motor off."""
        self.tell(f"w axis{self.axis}.requested_state {ascii_protocol.IDLE}")


class OdriveHub(PolledHub):
    """A hub on an ODrive; implements ``Hub``."""

    drive_class = Odrive
