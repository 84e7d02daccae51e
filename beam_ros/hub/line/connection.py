"""The session with a device that is the axis of the rig file, keeps its limits, and stops when left alone.

A connection comes up in steps. The host greets; the device says who it is; the host hands it the rig's limits
and looks at what it will obey; then the host falls silent on purpose, at rest and disabled, and looks whether
the device notices in time. Only after that does the axis take commands.

A device has one session: the newest greeting takes it. A host that loses its session without a restart of the device
may have a rival, and waits before it greets again, twice as long each time, until each leaves the other the time to
come up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Literal

from beam_ros.hub.faults import Fault, fault
from beam_ros.hub.host.contact import Contact
from beam_ros.hub.journal import Journal
from beam_ros.hub.line import protocol
from beam_ros.hub.line.greeting import Greeting
from beam_ros.hub.line.watchdog_proof import WatchdogProof
from beam_ros.hub.parameters import AxisParameters, LinkParameters

ConnectionState = Literal["down", "greeting", "limits", "proof", "up"]

REFUSED_NS = 2_000_000_000
"""A device that was refused is greeted again after this time: somebody may have mended it."""
LIMITS_AGAIN_NS = 100_000_000
SILENCE_NS = 500_000_000
"""A device that says nothing for this long is lost."""
NO_ANSWER_NS = 3_000_000_000
"""A port where nobody answers the greeting for this long is opened anew."""
STEP_NS = 3_000_000_000
"""A device that rests and still has not set its limits after this time will not do it."""
SINGLE_PRECISION = 1e-6
"""Limits may differ by this share: a device may calculate with 24 bits."""


class Connection:
    """The session with the device.

    Parameters
    ----------
    parameters : AxisParameters
        What the rig file says of the axis; the device must agree.
    link : LinkParameters
        The port, for messages, and whether the watchdog is proved.
    journal : Journal
        Is told of changes.

    Attributes
    ----------
    state : str
        down: no port; greeting: the device has not answered; limits: it is given what to obey; proof: the host is
        silent on purpose; up: in session.
    contact : Contact
        Why it is not up.
    round_trip_ns : int
        What the line itself takes for a word and its answer, as far as is known [ns].
    """

    def __init__(self, parameters: AxisParameters, link: LinkParameters, journal: Journal) -> None:
        self.state: ConnectionState = "down"
        self.contact = Contact(journal)
        self.round_trip_ns = 0
        self._parameters = parameters
        self._link = link
        self._journal = journal
        self._heard_ns = 0
        self._greeting = Greeting()
        self._proof = WatchdogProof(parameters)
        self._device: protocol.Identity | None = None
        self._rested_ns: int | None = None
        self._last_set_ns: int | None = None
        self._up_ns: int | None = None

    @property
    def _wanted(self) -> protocol.DeviceLimits:
        return protocol.DeviceLimits.of(self._parameters)

    @property
    def is_up(self) -> bool:
        """Whether the axis takes commands."""
        return self.state == "up"

    @property
    def is_in_session(self) -> bool:
        """Whether the device has answered, so that its messages count."""
        return self.state in ("limits", "proof", "up")

    @property
    def greeted_ns(self) -> int:
        """Steady time at which the device was greeted last [ns]: what it says in the session came after that."""
        return self._greeting.newest_ns

    @property
    def must_be_silent(self) -> bool:
        """Whether the host says nothing, to see whether the device notices."""
        return self._proof.is_silent

    def open(self, now_ns: int) -> None:
        """Begin to greet the device on the line."""
        self._greet_again(now_ns)
        self._heard_ns = now_ns
        self._greeting.n_unanswered = 0

    def lose(self, cause: Fault, reason: str) -> None:
        """Take note that there is no line or no session any more."""
        was_in_session, self.state = self.is_in_session, "down"
        self._proof.give_up()
        if was_in_session or cause is not fault("controller_silent"):
            # Who never answered is no news when the port is opened anew.
            self.contact.lose(cause, reason)

    def hear(self, now_ns: int) -> None:
        """Note a sign of life of the device."""
        self._heard_ns = now_ns

    def is_silent(self, now_ns: int, talking_since_ns: int | None) -> bool:
        """Whether the device has said nothing for so long that the port should be opened anew."""
        if talking_since_ns is None:
            return False
        # A device that stopped talking to a silent host is heard again a round trip after the host's next word.
        patience_ns = SILENCE_NS + self.round_trip_ns
        if self.state == "proof":
            patience_ns += self._proof.patience_ns(self.round_trip_ns)
        elif not self.is_in_session:
            patience_ns = NO_ANSWER_NS
        since_ns = max(self._heard_ns, self._greeting.next_ns, talking_since_ns)
        return now_ns - since_ns > patience_ns

    def words(self, now_ns: int) -> Iterator[protocol.Message]:
        """Yield what brings the connection up, where it is due now."""
        if self.state == "greeting":
            yield from self._greet(now_ns)
        elif self.state == "limits" and self._rested_ns is not None:
            if now_ns - self._rested_ns > STEP_NS:
                self._refuse(now_ns, fault("limits_not_obeyed"), "the controller does not answer SetLimits")
            elif self._last_set_ns is None or now_ns - self._last_set_ns >= LIMITS_AGAIN_NS:
                self._last_set_ns = now_ns
                yield protocol.SetLimits(1, self._wanted)
        elif self.state == "proof":
            yield from self._prove(now_ns)

    # What the device says -----------------------------------------------------------------------------

    def note_identity(
        self, identity: protocol.Identity, now_ns: int
    ) -> Literal["new", "same", "restarted", "lost"]:
        """Take the device's name; say whether a session begins, goes on, or is gone, by a restart or without one.

        A greeting that was repeated before the device could answer is answered twice: the second answer says
        nothing new. An answer to no greeting of this host's is somebody else's, or ends the session.
        """
        is_same_boot, greeting = self.is_same_boot(identity), self._greeting
        if self.is_in_session and not (is_same_boot and greeting.n_unanswered > 0):
            self._lose_session(now_ns, is_same_boot=is_same_boot)
            return "lost" if is_same_boot else "restarted"
        if greeting.n_unanswered == 0:
            return "same"
        greeting.n_unanswered -= 1
        if self.is_in_session:
            return "same"
        objection = _objection(identity, self._parameters)
        if objection is not None:
            self._refuse(now_ns, *objection)
            return "same"
        self.state, self.contact.reason = "limits", "the controller is being given its limits"
        self._device = identity
        self._rested_ns = self._last_set_ns = None
        self._proof.restart()
        self._journal.counters["watchdog_proved"] = 0
        return "new"

    def is_same_boot(self, identity: protocol.Identity) -> bool:
        """Whether the device has not restarted since the last session."""
        return self._device is not None and identity.boot_id == self._device.boot_id

    def _lose_session(self, now_ns: int, *, is_same_boot: bool) -> None:
        """Greet anew: at once a device that restarted, after a pause one that may have another host."""
        greeting, longest_ns = self._greeting, self._proof.longest_ns(self.round_trip_ns)
        is_news = not is_same_boot or (self._up_ns is not None and now_ns - self._up_ns > longest_ns)
        if is_news:
            greeting.pause_ns = 0
        is_rivalry = greeting.pause_ns > 0
        # Up to the time in which the other host comes up at its slowest.
        wait_ns = greeting.leave_to_another(longest_ns) if is_same_boot else 0
        cause = fault("other_host" if is_rivalry else "session_lost" if is_same_boot else "restarted")
        self._greet_again(now_ns, wait_ns)
        self._heard_ns = now_ns
        greeting.n_unanswered = 0
        self.contact.lose(cause, f"{cause.sentence}; {cause.remedy}", is_news=is_news)

    def note_status(self, status: protocol.Status, now_ns: int) -> None:
        """Follow the device on the way up: is it at rest, has it noticed the host's silence?"""
        noticed_ns = self._proof.note_status(status)
        if self.state == "limits" and self._proof.is_at_rest and self._rested_ns is None:
            self._rested_ns = now_ns
        if noticed_ns is not None:
            self._judge(now_ns, noticed_ns)

    def note_limits(self, obeyed: protocol.DeviceLimits, now_ns: int) -> None:
        """Take the device's answer to what it was told to obey."""
        if self.state != "limits" or obeyed == protocol.DeviceLimits():
            return
        objection = _limits_objection(obeyed, self._wanted)
        if objection:
            self._refuse(now_ns, fault("limits_not_obeyed"), objection)
        elif self._link.prove_watchdog:
            self.state, self.contact.reason = "proof", "the controller's watchdog is being proved"
        else:
            self._establish(now_ns)

    # The proof of the watchdog ------------------------------------------------------------------------

    def _prove(self, now_ns: int) -> Iterator[protocol.Message]:
        """Say a last word and be silent, or give a trial up that the device let pass."""
        if self._proof.begin(now_ns):
            yield protocol.Heartbeat()
        elif (overdue_ns := self._proof.overdue_ns(now_ns, self.round_trip_ns)) is not None:
            self._judge(now_ns, overdue_ns)

    def _judge(self, now_ns: int, elapsed_ns: int) -> None:
        """Take the silence that the device noticed, or in which it noticed nothing."""
        is_proved = self._proof.judge(elapsed_ns, self.round_trip_ns)
        if is_proved:
            self._journal.counters["watchdog_proved"] = 1
            self._establish(now_ns)
        elif is_proved is not None:
            self._refuse(
                now_ns,
                fault("watchdog_unproved"),
                f"{elapsed_ns * 1e-9:.3f} s of silence without a time-out of the controller: expected one within "
                f"{self._wanted.watchdog_ns * 1e-9:g} s",
            )

    # Inside -------------------------------------------------------------------------------------------

    def _establish(self, now_ns: int) -> None:
        assert self._device is not None
        self.state, self._up_ns = "up", now_ns
        # A rival is reported once, however often each of the two comes up.
        self.contact.make(
            f"{self._device.name} on {self._link.serial_port}", is_lasting=self._greeting.pause_ns == 0
        )

    def _greet_again(self, now_ns: int, wait_ns: int = 0) -> None:
        self.state = "greeting"
        self.contact.await_answer()
        self._greeting.begin(now_ns, wait_ns)
        self._up_ns = None
        self._proof.give_up()

    def _greet(self, now_ns: int) -> Iterator[protocol.Message]:
        if self._greeting.is_in_vain(now_ns):
            self.contact.lose(
                fault("no_answer"),
                f"nobody answers on {self._link.serial_port} at {self._link.serial_baud} baud: "
                f"expected a controller that speaks protocol version {protocol.VERSION}; check serial.port, "
                "serial.baud, and that the controller has power and the firmware",
            )
        if self._greeting.is_due(now_ns):
            yield protocol.Hello()

    def _refuse(self, now_ns: int, cause: Fault, reason: str) -> None:
        """Leave this device alone for a while, and say once why."""
        self._greet_again(now_ns, REFUSED_NS)
        self.contact.lose(cause, f"{reason}; {cause.remedy}")


_EQUAL = {
    "period_ns": "period_ns",
    "command_mode": "command mode",
    "encoder_resolution": "encoder resolution",
}
"""What device and rig file must agree on, and how a message names it."""


def _objection(identity: protocol.Identity, parameters: AxisParameters) -> tuple[Fault, str] | None:
    """Return why this device cannot be the axis of the rig file."""
    if identity.version != protocol.VERSION:
        return fault("wrong_version"), (
            f"the controller speaks protocol versions {identity.lowest_version} to "
            f"{identity.highest_version}: expected {protocol.VERSION}"
        )
    for name, words in _EQUAL.items():
        value, wanted = getattr(identity, name), getattr(parameters, name)
        if value != wanted:
            return fault("wrong_axis"), (
                f"the controller's {words} is {value}, the rig file's {wanted}: expected the same"
            )
    for words, count in (
        ("ticks in a batch", identity.batch_ticks),
        ("room for samples", identity.buffer_samples),
    ):
        if count < 1:
            return fault("wrong_axis"), f"the controller names {count} {words}: expected at least 1"
    widest, wanted_limits = vars(identity.widest), vars(protocol.DeviceLimits.of(parameters))
    for name, limit in widest.items():
        if not (math.isfinite(limit) and limit > 0):
            return fault(
                "limits_not_obeyed"
            ), f"the controller names {name} {limit}: expected a positive number"
        if limit < wanted_limits[name] * (1 - SINGLE_PRECISION):
            return fault("wrong_axis"), (
                f"the controller allows {name} {limit:g}, the rig file {wanted_limits[name]:g}: "
                f"lower hub.{_key(name)}"
            )
    return None


def _limits_objection(obeyed: protocol.DeviceLimits, wanted: protocol.DeviceLimits) -> str | None:
    """Return why what a device will obey is not what the rig file says."""
    for field in fields(wanted):
        limit, allowed = getattr(obeyed, field.name), getattr(wanted, field.name)
        if not abs(limit - allowed) <= SINGLE_PRECISION * allowed:
            return f"the controller will obey {field.name} {limit:g}: expected {allowed:g} of hub.{_key(field.name)}"
    return None


def _key(limit: str) -> str:
    """Return the rig file's name of a limit."""
    return "watchdog" if limit == "watchdog_ns" else limit
