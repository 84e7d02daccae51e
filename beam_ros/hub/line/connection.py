"""The session with a device that is the axis of the rig file, keeps its limits, and stops when left alone.

A connection comes up in steps. The host greets; the device says who it is; the host hands it the rig's limits
and looks at what it will obey; then the host falls silent on purpose, at rest and disabled, and looks whether
the device notices in time. Only after that does the axis take commands.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Literal

from beam_ros.hub.faults import NO_FAULT, Fault, fault
from beam_ros.hub.journal import Journal
from beam_ros.hub.line import protocol
from beam_ros.hub.parameters import AxisParameters, LinkParameters

ConnectionState = Literal["down", "greeting", "limits", "proof", "up"]

HELLO_NS = 200_000_000
REFUSED_NS = 2_000_000_000
"""A device that was refused is greeted again after this time: somebody may have mended it."""
LIMITS_AGAIN_NS = 100_000_000
SILENCE_NS = 500_000_000
"""A device that says nothing for this long is lost."""
NO_ANSWER_NS = 3_000_000_000
"""A port where nobody answers the greeting for this long is opened anew."""
STEP_NS = 3_000_000_000
"""A device that rests and still has not set its limits after this time will not do it."""
COMPLAINT_NS = 2_000_000_000
"""A greeting that nobody answers for this long is reported."""
SINGLE_PRECISION = 1e-6
"""Limits may differ by this share: a device may calculate with 24 bits."""
PROOF_TRIALS = 3
"""A busy host may miss when the silence began; a device that has no watchdog misses every time."""
PROOF_SLACK_NS = 100_000_000
"""What the way of the last frame and of the status may add to the watchdog's time."""


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
    fault : Fault
        Why it is not up.
    reason : str
        The same with its numbers.
    round_trip_ns : int
        What the line itself takes for a word and its answer, as far as is known [ns].
    """

    def __init__(self, parameters: AxisParameters, link: LinkParameters, journal: Journal) -> None:
        self.state: ConnectionState = "down"
        self.fault: Fault = NO_FAULT
        self.reason = "not connected yet"
        self.round_trip_ns = 0
        self._parameters = parameters
        self._wanted = protocol.DeviceLimits.of(parameters)
        self._link = link
        self._journal = journal
        self._opened_ns = 0
        self._heard_ns = 0
        self._last_hello_ns: int | None = None
        self._next_hello_ns = 0
        self._n_unanswered = 0
        self._boot_id: int | None = None
        self._name = ""
        self._told: Fault = NO_FAULT
        self._is_at_rest = False
        self._rested_ns: int | None = None
        self._last_set_ns: int | None = None
        self._tick = 0
        self._silences = 0
        self._proof_began_ns: int | None = None
        self._proof_tick = 0
        self._proof_silences = 0
        self._n_trials = 0

    @property
    def is_up(self) -> bool:
        """Whether the axis takes commands."""
        return self.state == "up"

    @property
    def is_in_session(self) -> bool:
        """Whether the device has answered, so that its messages count."""
        return self.state in ("limits", "proof", "up")

    @property
    def must_be_silent(self) -> bool:
        """Whether the host says nothing, to see whether the device notices."""
        return self._proof_began_ns is not None

    def open(self, now_ns: int) -> None:
        """Begin to greet the device on the line."""
        self._greet_again(now_ns, now_ns)
        self._heard_ns = now_ns
        self._n_unanswered = 0

    def lose(self, cause: Fault, reason: str) -> None:
        """Take note that there is no line or no session any more."""
        was_in_session, self.state = self.is_in_session, "down"
        self._proof_began_ns = None
        if was_in_session or cause is not fault("controller_silent"):
            # Who never answered is no news when the port is opened anew.
            self._complain(cause, reason)

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
            patience_ns += self._proof_patience_ns
        elif not self.is_in_session:
            patience_ns = NO_ANSWER_NS
        since_ns = max(self._heard_ns, self._next_hello_ns, talking_since_ns)
        return now_ns - since_ns > patience_ns

    def words(self, now_ns: int) -> Iterator[protocol.Message]:
        """Yield what brings the connection up, where it is due now."""
        if self.state == "greeting":
            if self._is_hello_due(now_ns):
                yield protocol.Hello()
        elif self.state == "limits" and self._rested_ns is not None:
            if now_ns - self._rested_ns > STEP_NS:
                self._refuse(now_ns, fault("limits_not_obeyed"), "the controller does not answer SetLimits")
            elif self._last_set_ns is None or now_ns - self._last_set_ns >= LIMITS_AGAIN_NS:
                self._last_set_ns = now_ns
                yield protocol.SetLimits(1, self._wanted)
        elif self.state == "proof":
            yield from self._prove(now_ns)

    # What the device says -----------------------------------------------------------------------------

    def note_identity(self, identity: protocol.Identity, now_ns: int) -> Literal["new", "same", "lost"]:
        """Take the device's name; say whether a session begins, goes on, or was lost.

        A greeting that was repeated before the device could answer is answered twice: the second answer says
        nothing new.
        """
        is_same_boot = identity.boot_id == self._boot_id
        if self.is_in_session:
            if is_same_boot and self._n_unanswered > 0:
                self._n_unanswered -= 1
                return "same"
            return "lost"
        self._n_unanswered -= 1
        objection = _objection(identity, self._parameters)
        if objection is not None:
            self._refuse(now_ns, *objection)
            return "same"
        self.state, self.reason = "limits", "the controller is being given its limits"
        self._name = identity.name
        self._boot_id = identity.boot_id
        self._rested_ns = self._last_set_ns = None
        self._is_at_rest = False
        self._n_trials = 0
        self._journal.counters["watchdog_proved"] = 0
        return "new"

    def is_same_boot(self, identity: protocol.Identity) -> bool:
        """Whether the device has not restarted since the last session."""
        return identity.boot_id == self._boot_id

    def note_status(self, status: protocol.Status, now_ns: int) -> None:
        """Follow the device on the way up: is it at rest, has it noticed the host's silence?"""
        self._tick, self._silences = status.tick, status.silences
        self._is_at_rest = status.activity == "idle" and status.state != "enabled"
        if self.state == "limits" and self._is_at_rest and self._rested_ns is None:
            self._rested_ns = now_ns
        if self.must_be_silent and status.silences != self._proof_silences:
            self._judge(now_ns, (status.silence_tick - self._proof_tick) * self._parameters.period_ns)

    def note_limits(self, obeyed: protocol.DeviceLimits, now_ns: int) -> None:
        """Take the device's answer to what it was told to obey."""
        if self.state != "limits" or obeyed == protocol.DeviceLimits():
            return
        objection = _limits_objection(obeyed, self._wanted)
        if objection:
            self._refuse(now_ns, fault("limits_not_obeyed"), objection)
        elif self._link.prove_watchdog:
            self.state, self.reason = "proof", "the controller's watchdog is being proved"
        else:
            self._establish()

    # The proof of the watchdog ------------------------------------------------------------------------

    @property
    def _proof_patience_ns(self) -> int:
        """How long a device is given that does not notice the silence."""
        return 2 * self._wanted.watchdog_ns + PROOF_SLACK_NS + self.round_trip_ns

    def _prove(self, now_ns: int) -> Iterator[protocol.Message]:
        """Say a last word and be silent, or give a trial up that the device let pass."""
        if self._proof_began_ns is None:
            if self._is_at_rest:
                self._proof_began_ns = now_ns
                self._proof_tick, self._proof_silences = self._tick, self._silences
                yield protocol.Heartbeat()
        elif now_ns - self._proof_began_ns > self._proof_patience_ns:
            self._judge(now_ns, now_ns - self._proof_began_ns)

    def _judge(self, now_ns: int, elapsed_ns: int) -> None:
        """Compare the silence that the device noticed with its watchdog's time."""
        self._proof_began_ns = None
        # Between the newest tick that the host knew and the last word's arrival lies the line's round trip.
        allowed_ns = (
            self._wanted.watchdog_ns + 2 * self._parameters.batch_ns + PROOF_SLACK_NS + self.round_trip_ns
        )
        if 0 <= elapsed_ns <= allowed_ns:
            self._journal.counters["watchdog_proved"] = 1
            self._establish()
            return
        self._n_trials += 1
        if self._n_trials >= PROOF_TRIALS:
            self._refuse(
                now_ns,
                fault("watchdog_unproved"),
                f"{elapsed_ns * 1e-9:.3f} s of silence without a time-out of the controller: expected one within "
                f"{self._wanted.watchdog_ns * 1e-9:g} s",
            )

    # Inside -------------------------------------------------------------------------------------------

    def _establish(self) -> None:
        self.state, self.fault, self.reason = "up", NO_FAULT, ""
        self._told = NO_FAULT
        self._journal.counters["connections"] += 1
        self._journal.tell("info", f"connected: {self._name} on {self._link.serial_port}")

    def _greet_again(self, now_ns: int, hello_ns: int) -> None:
        self.state = "greeting"
        self.fault, self.reason = fault("no_answer"), "the controller has not answered yet"
        self._opened_ns = now_ns
        self._last_hello_ns = None
        self._next_hello_ns = hello_ns
        self._proof_began_ns = None

    def _is_hello_due(self, now_ns: int) -> bool:
        if now_ns < self._next_hello_ns:
            return False
        if now_ns - max(self._opened_ns, self._next_hello_ns) > COMPLAINT_NS:
            self._complain(
                fault("no_answer"),
                f"nobody answers on {self._link.serial_port} at {self._link.serial_baud} baud: "
                f"expected a controller that speaks protocol version {protocol.VERSION}; check serial.port, "
                "serial.baud, and that the controller has power and the firmware",
            )
        if self._last_hello_ns is not None and now_ns - self._last_hello_ns < HELLO_NS:
            return False
        self._last_hello_ns = now_ns
        self._n_unanswered += 1
        return True

    def _refuse(self, now_ns: int, cause: Fault, reason: str) -> None:
        """Leave this device alone for a while, and say once why."""
        self._greet_again(now_ns, now_ns + REFUSED_NS)
        self._complain(cause, f"{reason}; {cause.remedy}")

    def _complain(self, cause: Fault, text: str) -> None:
        """Say what is wrong with the connection, once until it is something else."""
        self.fault, self.reason = cause, text
        if cause is not self._told:
            self._told = cause
            self._journal.tell("error", text)


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
