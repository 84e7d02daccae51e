"""Whether there is a session with a device, and whether it is the axis of the rig file."""

from __future__ import annotations

from typing import Literal

from beam_ros.hub.journal import Journal
from beam_ros.hub.line import protocol
from beam_ros.hub.parameters import AxisParameters, LinkParameters

ConnectionState = Literal["down", "greeting", "up"]

HELLO_NS = 200_000_000
SILENCE_NS = 500_000_000
"""A device that says nothing for this long is lost."""
NO_ANSWER_NS = 3_000_000_000
"""A port where nobody answers the greeting for this long is opened anew."""
COMPLAINT_NS = 2_000_000_000
"""A greeting that nobody answers for this long is reported."""


class Connection:
    """The session with the device.

    Parameters
    ----------
    parameters : AxisParameters
        What the rig file says of the axis; the device must agree.
    link : LinkParameters
        The port, for messages.
    journal : Journal
        Is told of changes.

    Attributes
    ----------
    state : str
        down: no port; greeting: the device has not answered; up: in session.
    reason : str
        Why it is not up.
    """

    def __init__(self, parameters: AxisParameters, link: LinkParameters, journal: Journal) -> None:
        self.state: ConnectionState = "down"
        self.reason = "not connected yet"
        self._parameters = parameters
        self._link = link
        self._journal = journal
        self._opened_ns = 0
        self._heard_ns = 0
        self._last_hello_ns: int | None = None
        self._boot_id: int | None = None
        self._has_complained = False

    @property
    def is_up(self) -> bool:
        """Whether there is a session."""
        return self.state == "up"

    def open(self, now_ns: int) -> None:
        """Begin to greet the device on the line."""
        self.state = "greeting"
        self.reason = "the controller has not answered yet"
        self._opened_ns = self._heard_ns = now_ns
        self._last_hello_ns = None

    def lose(self, reason: str) -> None:
        """Take note that there is no line any more."""
        self.state, self.reason = "down", reason

    def hear(self, now_ns: int) -> None:
        """Note a sign of life of the device."""
        self._heard_ns = now_ns

    def is_silent(self, now_ns: int, talking_since_ns: int | None) -> bool:
        """Whether the device has said nothing for so long that the port should be opened anew."""
        if talking_since_ns is None:
            return False
        patience_ns = SILENCE_NS if self.is_up else NO_ANSWER_NS
        return now_ns - max(self._heard_ns, talking_since_ns) > patience_ns

    def is_hello_due(self, now_ns: int) -> bool:
        """Whether the device is to be greeted now."""
        if now_ns - self._opened_ns > COMPLAINT_NS:
            self._complain(
                f"nobody answers on {self._link.serial_port} at {self._link.serial_baud} baud: "
                f"expected a controller that speaks protocol version {protocol.VERSION}; check serial.port, "
                "serial.baud, and that the controller has power and the firmware"
            )
        if self._last_hello_ns is not None and now_ns - self._last_hello_ns < HELLO_NS:
            return False
        self._last_hello_ns = now_ns
        return True

    def is_same_boot(self, identity: protocol.Identity) -> bool:
        """Whether the device has not restarted since the last session."""
        return identity.boot_id == self._boot_id

    def establish(self, identity: protocol.Identity) -> bool:
        """Begin a session with a device that is the axis of the rig file; else say why it is not."""
        objection = _objection(identity, self._parameters)
        if objection:
            self._complain(objection)
            return False
        self.state, self.reason = "up", ""
        self._boot_id = identity.boot_id
        self._has_complained = False
        self._journal.counters["connections"] += 1
        self._journal.tell("info", f"connected: {identity.name} on {self._link.serial_port}")
        return True

    def _complain(self, text: str) -> None:
        """Say once what is wrong with the connection."""
        self.reason = text
        if not self._has_complained:
            self._has_complained = True
            self._journal.tell("error", text)


_EQUAL = {
    "period_ns": "period_ns",
    "command_mode": "command mode",
    "encoder_resolution": "encoder resolution",
}
"""What device and rig file must agree on, and how a message names it."""


def _objection(identity: protocol.Identity, parameters: AxisParameters) -> str | None:
    """Return why this device cannot be the axis of the rig file."""
    if identity.version != protocol.VERSION:
        return (
            f"the controller speaks protocol versions {identity.lowest_version} to "
            f"{identity.highest_version}: expected {protocol.VERSION}; update the firmware or this suite"
        )
    for name, words in _EQUAL.items():
        value, wanted = getattr(identity, name), getattr(parameters, name)
        if value != wanted:
            return f"the controller's {words} is {value}, the rig file's {wanted}: make them the same"
    for name in ("travel", "max_speed", "max_acceleration", "max_effort"):
        limit, allowed = getattr(identity, name), getattr(parameters, name)
        if limit < allowed * (1 - 1e-9):
            return f"the controller allows {name} {limit:g}, the rig file {allowed:g}: lower hub.{name}"
    return None
