"""A drive that is written to and asked at a steady pace: all that such a link is, but for the drive's own words.

A thread keeps the pace on the steady clock. Whatever the plan says for the present instant is written, and the drive
is asked where the motor is; the sample's stamp is the middle of question and answer. The drive's own watchdog is
set, and provoked by a silence before it is believed. A link brings a ``PolledDrive``: orders to its controller
and questions, in turns of its motor.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from beam_ros.hub.contract import HubCapabilities, SampleBatch
from beam_ros.hub.errors import HubConnectionError, HubProtocolError
from beam_ros.hub.faults import fault
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.line.transport import RECONNECT_S, SerialTransport
from beam_ros.hub.link_parameters import DriveParameters
from beam_ros.hub.links.host_axis import AT_REST, HostAxis
from beam_ros.hub.links.host_paced_hub import HostPacedHub
from beam_ros.hub.links.query_line import Answer, QueryLine, SteadyTime, UnreadableAnswerError
from beam_ros.hub.parameters import AxisParameters, LinkParameters

MISSES = 5
"""So many answers in a row that did not come are a lost controller."""
LATE_NS = 20_000_000
"""A write that is later than this is looked at before anything else is written [ns]."""
LOOK_EVERY = 10
"""The drive's condition is read once in so many writes."""
FLOOD_BYTES = 500_000
"""More bytes in a second than a drive answers, or a bus of 4.5 Mbit/s carries."""
RTTS = 200
"""Exchanges of which the shortest counts."""
MAX_EXCESS_NS = 2_000_000
"""A measurement whose exchange took longer than the shortest by this has no time, and is not reported [ns]."""
POWER_S = 1.0
"""Longest wait for the drive to take the motor [s]."""
SILENCES = (0.4, 1.5)
"""Silences in the proof of the watchdog, as shares of its time: the first it must bear, the second it must notice."""
EARLIEST = 0.5
"""A watchdog that acts before this share of its time acts on something else."""
RATE_NS = 1_000_000_000
"""The rate that is achieved is counted over this time [ns]."""
SLOW_WINDOWS = 3
"""So many such times in a row below ``SLOW`` of the rate are no accident."""
SLOW = 0.9


@dataclass(frozen=True)
class DriveFaults:
    """What is known of the drive's faults.

    Parameters
    ----------
    names : tuple of str
        Of each fault but the watchdog's.
    is_expired : bool
        Whether the drive's watchdog has acted, which is the host's fault.
    text : str
        All of it, for people.
    """

    names: tuple[str, ...]
    is_expired: bool
    text: str


def capabilities(name: str, *shortcomings: str) -> HubCapabilities:
    """Return what such an axis can promise, whose drive has a watchdog and not all of the limits."""
    return HubCapabilities(
        name,
        modes=("acceleration", "velocity", "position"),
        is_buffered=False,
        has_device_clock=False,
        keeps_limits=False,
        telemetry="poll",
        shortcomings=(
            "the host paces every position: a busy computer is heard in the hub's motion",
            "samples carry the middle of their question and answer, not the drive's own time",
            *shortcomings,
            "what was written is not what was done: identify with the measured position",
        ),
    )


class PolledDrive(Protocol):
    """Orders to a controller, and questions; each call may raise ``HubProtocolError`` or ``HubConnectionError``."""

    name: str
    """For people."""
    capabilities: HubCapabilities
    is_fed_by_questions: bool
    """Whether questions feed its watchdog as orders do."""
    restarts_to_clear: bool
    """Whether it clears its faults by a restart, and is to be set up again."""

    def prepare(self, parameters: AxisParameters, metres_per_turn: float) -> tuple[str, float]:
        """Switch the motor off, set modes, limits and watchdog; return what it is, and its watchdog's time [s]."""

    def begin_proof(self) -> bool:
        """Let the watchdog watch; return whether it can, which a fault may forbid. The motor may be on then."""
        return True

    def feed(self) -> None:
        """Feed the watchdog, where questions do not."""

    def is_expired(self) -> bool:
        """Return whether the watchdog has acted."""

    def forgive_silence(self) -> None:
        """Clear the watchdog's fault, and no other."""

    def measure(self) -> tuple[float, float, Answer]:
        """Return where the motor is [turns], its speed [turns/s], and the answer that says so, with its times."""

    def lead(self, turns: float, speed: float) -> None:
        """Write where the motor is to be [turns], and how fast [turns/s]."""

    def look(self, is_on: bool) -> str:
        """Return what is seen of the drive where something is wrong with it; empty where nothing is."""

    def faults(self) -> DriveFaults:
        """Return all that can be read of the faults."""

    def clear_faults(self) -> None:
        """Clear them."""

    def take_motor(self, turns: float) -> None:
        """Switch the motor on, to hold where it stands."""

    def has_motor(self) -> bool:
        """Return whether the motor is led."""

    def let_go(self) -> None:
        """Switch the motor off."""


class WritingPace:
    """When the next position is due, how many are written a second, and how long their answers take.

    Parameters
    ----------
    rate : float
        That is wanted [1/s].
    steady : SteadyTime
        The clock.
    counters : dict
        Takes ``late_writes`` and ``writes_per_second``.
    """

    def __init__(self, rate: float, steady: SteadyTime, counters: dict[str, int]) -> None:
        self.rate = rate
        self._trips_ns: deque[int] = deque(maxlen=RTTS)
        self._steady, self._counters = steady, counters
        self._period_ns = round(1e9 / rate)
        self.begin()

    def begin(self) -> None:
        """Begin now."""
        self._due_ns = self._since_ns = self._steady.now_ns()
        self._n_written = self._n_slow = 0

    def wait(self) -> tuple[int, int]:
        """Wait until a position is due; return the steady time, and how late that is [ns]."""
        now_ns = self._steady.now_ns()
        if now_ns < self._due_ns:
            self._steady.wait((self._due_ns - now_ns) * 1e-9)
            now_ns = self._steady.now_ns()
        return now_ns, now_ns - self._due_ns

    def go_on(self, now_ns: int) -> bool:
        """Note that a position is written; return whether the pace is found too slow, once."""
        is_late = now_ns - self._due_ns >= self._period_ns
        self._counters["late_writes"] += is_late
        self._due_ns = (now_ns if is_late else self._due_ns) + self._period_ns
        self._n_written += 1
        passed_ns = now_ns - self._since_ns
        if passed_ns < RATE_NS:
            return False
        achieved = self._n_written * 1e9 / passed_ns
        self._counters["writes_per_second"] = round(achieved)
        self._since_ns, self._n_written = now_ns, 0
        self._n_slow = self._n_slow + 1 if achieved < SLOW * self.rate else 0
        return self._n_slow == SLOW_WINDOWS

    @property
    def shortest_trip_ns(self) -> int:
        """Of the newest questions with their answers [ns]."""
        return min(self._trips_ns)

    def is_timed(self, answer: Answer) -> bool:
        """Take an answer; return whether it came soon enough for the middle of its exchange to be its time."""
        trip_ns = answer.came_ns - answer.sent_ns
        self._trips_ns.append(trip_ns)
        is_late = trip_ns - self.shortest_trip_ns > MAX_EXCESS_NS
        self._counters["untimed_answers"] += is_late
        return not is_late


class PolledHub(HostPacedHub):
    """A hub on a drive that is written to and asked; implements ``Hub``.

    Parameters
    ----------
    parameters : AxisParameters
        The axis.
    link : LinkParameters
        Its port.
    settings : DriveParameters
        How the drive moves the hub.
    guard : BeamGuard, optional
        A further check of complete sequences, for limits that need a model of the beam.
    port : SerialTransport, optional
        An unopened port, in place of the one that ``link`` names.
    steady : SteadyTime, optional
        A clock of the caller's, who then calls ``turn`` again and again; else threads do that, and check sequences.

    Attributes
    ----------
    drive_class : callable
        Makes the drive of a line and the settings.
    """

    drive_class: ClassVar[Callable[..., PolledDrive]]

    def __init__(
        self,
        parameters: AxisParameters,
        link: LinkParameters,
        settings: DriveParameters,
        guard: BeamGuard | None = None,
        *,
        port: SerialTransport | None = None,
        steady: SteadyTime | None = None,
    ) -> None:
        self._port = port or SerialTransport(link.serial_port, link.serial_baud, FLOOD_BYTES)
        self._line = QueryLine(self._port, steady)
        self._drive = drive = type(self).drive_class(self._line, settings)
        counters = ("late_writes", "lost_answers", "untimed_answers", "writes_per_second")
        axis = HostAxis(
            parameters,
            guard,
            homes_here=settings.homes_here,
            counters=counters,
            checks_in_background=steady is None,
        )
        promised = dataclasses.replace(
            drive.capabilities,
            rate=settings.rate,
            shortcomings=drive.capabilities.shortcomings + link.shortcomings,
        )
        super().__init__(axis, promised, self._line.steady)
        self._settings, self._link = settings, link
        self._pace = WritingPace(settings.rate, self.steady, axis.journal.counters)
        self._patient_until_ns = self.steady.now_ns() + round(link.patience_s * 1e9)
        self._is_on = self._was_broken = self._is_silent = False
        # Names of the drive's faults that stand in the fault of the axis; None: it is no fault of the drive's.
        self._shown: tuple[str, ...] | None = None
        self._n_beats = self._misses = 0
        self._begin(steady)

    def _let_go(self) -> None:
        self._switch_off()
        self._port.dispose()

    def turn(self) -> None:
        """Connect, or write and measure once when that is due; what is lost is said, and tried again."""
        try:
            if self.axis.contact.is_made:
                self._beat()
            else:
                self._connect()
        except (HubConnectionError, HubProtocolError) as err:
            name = "status_unreadable" if isinstance(err, UnreadableAnswerError) else "no_answer"
            if isinstance(err, HubConnectionError):
                name = err.fault.name
            if name != "port_unavailable" or self.steady.now_ns() > self._patient_until_ns:
                self._lose(name, err)
            self.steady.wait(RECONNECT_S)

    # Connections ---------------------------------------------------------------------------------------

    def _lose(self, name: str, err: Exception) -> None:
        self._switch_off()
        self._port.close()
        with self.lock:
            self.axis.disconnect(name, str(err))

    def _switch_off(self) -> None:
        """Switch the motor off, as far as anybody listens; else the watchdog does it."""
        self._is_on = False
        if self._port.is_open:
            try:
                self._drive.let_go()
            except (HubConnectionError, HubProtocolError):
                return

    def _connect(self) -> None:
        if not self._port.is_open:
            self._port.open()
        self._line.drain()
        self._set_up()

    def _set_up(self) -> None:
        """Set modes, limits and watchdog of a drive whose motor is off, and prove the watchdog.

        Faults of the drive stay what they are: they become the axis's, for a person to see and to clear.
        """
        what, patience_s = self._drive.prepare(self.axis.parameters, self._settings.metres_per_turn)
        if self._link.prove_watchdog:
            self._prove_watchdog(patience_s)
        faults, seen = self._drive.faults(), self._drive.measure()
        with self.lock:
            self._observe(seen)
            self.axis.connect(f"{what} on {self._link.serial_port}")
            if faults.names:
                self._show(faults, f"{self._drive.name} reports {faults.text}")
        self._n_beats = self._misses = 0
        self._pace.begin()

    def _prove_watchdog(self, patience_s: float) -> None:
        """Fall silent, and require that the watchdog notices, neither early nor late."""
        drive, now_ns = self._drive, self.steady.now_ns
        speed = drive.measure()[1] * self._settings.metres_per_turn
        if abs(speed) > AT_REST:
            raise _unproved(
                f"the hub moves with {abs(speed):.3g} m/s: expected it at rest to prove the watchdog"
            )
        if not drive.begin_proof():
            return
        for share in SILENCES:
            begun_ns = now_ns()
            drive.feed()
            drive.measure()
            fed_ns = now_ns()
            self.steady.wait(share * patience_s)
            silent_s = (now_ns() - fed_ns) * 1e-9
            is_expired = drive.is_expired()
            if is_expired and (took_s := (now_ns() - begun_ns) * 1e-9) < EARLIEST * patience_s:
                raise _unproved(
                    f"the watchdog of {drive.name} acted within {took_s:.3f} s: expected {patience_s:g} s; look for "
                    "another program on the same drive"
                )
            if is_expired or self.steady.is_over:
                break
        else:
            raise _unproved(
                f"the watchdog of {drive.name} was set to {patience_s:g} s and did not act on {silent_s:.2f} s of "
                "silence: expected it to stop the motor and to say so; update its firmware"
            )
        drive.let_go()
        drive.forgive_silence()
        if drive.is_expired():
            raise _unproved(
                f"the watchdog of {drive.name} has acted, and that cannot be cleared: expected it to be; update its "
                "firmware"
            )

    # The pace ------------------------------------------------------------------------------------------

    def _beat(self) -> None:
        """Write and measure at its time."""
        now_ns, late_ns = self._pace.wait()
        try:
            if self._is_on and late_ns > LATE_NS:
                self._look()
                seen = self._drive.measure()
                with self.lock:
                    self._observe(seen)
                    self.axis.note_late(late_ns, now_ns)
            elif self._n_beats % LOOK_EVERY == 0 and not self._must_ask_nothing:
                self._look()
            self._lead()
            self._n_beats += 1
            self._misses = 0
        except HubProtocolError as err:
            self._misses += 1
            self.axis.journal.counters["lost_answers"] += 1
            if self._misses >= MISSES:
                if isinstance(err, UnreadableAnswerError):
                    raise
                reason = f"{self._drive.name} fell silent: {err}"
                raise HubConnectionError(reason, fault("controller_silent")) from err

    def _lead(self) -> None:
        """Write what is due now, and measure."""
        with self.lock:
            now_ns = self.steady.now_ns()
            self.axis.step(now_ns)
            self._is_silent = self.axis.must_be_silent(now_ns)
            is_wanted, waits = self.axis.is_powered, bool(self.axis.powering)
            is_cleared = self._was_broken and not self.axis.is_broken
            self._was_broken = self.axis.is_broken
        if is_cleared:
            self._clear()
        if waits:
            self._power_on()
        elif self._is_on and not is_wanted:
            self._switch_off()
        per_turn, now_ns = self._settings.metres_per_turn, self.steady.now_ns()
        if self._pace.go_on(now_ns):
            self.axis.journal.tell("warning", self._slowness())
        if self._is_on:
            with self.lock:
                now_ns = self.steady.now_ns()
                position, velocity, _ = self.axis.course.at(now_ns)
                raw = position + self.axis.place.zero
                self._note_written(now_ns, position, velocity)
            self._drive.lead(raw / per_turn, velocity / per_turn)
        elif not self._is_silent:
            self._drive.feed()
        if self._must_ask_nothing:
            return
        seen = self._drive.measure()
        with self.lock:
            self._observe(seen)

    @property
    def _must_ask_nothing(self) -> bool:
        return self._is_silent and self._drive.is_fed_by_questions

    def _slowness(self) -> str:
        achieved = self.axis.journal.counters["writes_per_second"]
        return (
            f"{self._drive.name} is written and asked {achieved} times a second, the quickest answer takes "
            f"{self._pace.shortest_trip_ns * 1e-6:.1f} ms: expected axis.rate = {self._pace.rate:g}; set the latency "
            "timer of the USB adapter to 1 ms, raise the baud rate, or lower axis.rate: docs/connect-your-axis.md"
        )

    def _observe(self, seen: tuple[float, float, Answer]) -> None:
        """Take where the motor is; an answer that came late has no time."""
        turns, speed, answer = seen
        stamps, stamp_ns = self.axis.stamps, None
        if self._pace.is_timed(answer) and stamps is not None:
            stamp_ns = stamps.stamp_ns((answer.sent_ns + answer.came_ns) // 2)
        per_turn = self._settings.metres_per_turn
        self.axis.measure(turns * per_turn, speed * per_turn, stamp_ns)

    def _note_written(self, now_ns: int, position: float, velocity: float) -> None:
        """Report one written position, with the time at which it was written."""
        stamps = self.axis.stamps
        if stamps is not None:
            batch = SampleBatch(
                stamps.stamp_ns(now_ns), 0, 1, positions=np.array([position]), velocities=np.array([velocity])
            )
            self.axis.add_applied(batch)

    # Faults and power ----------------------------------------------------------------------------------

    def _look(self) -> None:
        """Look whether the drive still leads the motor, and has no fault."""
        seen = self._drive.look(self._is_on)
        if not seen:
            return
        faults = self._drive.faults()
        was_on = self._is_on
        reason = f"{self._drive.name} reports {faults.text}"
        if was_on:
            self._switch_off()
            reason = f"{self._drive.name} leads the motor no more ({seen}): {faults.text}"
        with self.lock:
            self._show(faults, reason)

    def _show(self, faults: DriveFaults, reason: str) -> None:
        """Make the drive's faults the axis's, if it has none yet; it keeps them until a person clears them."""
        # One that was just cleared is still the drive's until the next turn.
        if self.axis.is_broken or self._was_broken:
            return
        is_silence = faults.is_expired and not faults.names
        self._shown = None if is_silence else faults.names
        self._was_broken = True
        self.axis.fail(
            "host_silent" if is_silence else "drive_alarm", reason, self.steady.now_ns(), is_limp=True
        )

    def _clear(self) -> None:
        """Clear what a person has seen and cleared; what came beside it becomes the next fault."""
        faults = self._drive.faults()
        if set(faults.names) - set(self._shown or ()):
            with self.lock:
                self._show(faults, f"{self._drive.name} reports {faults.text}")
        elif self._shown is not None:
            self._drive.clear_faults()
            self._shown = None
            if self._drive.restarts_to_clear:
                self._set_up()

    def _power_on(self) -> None:
        """Let the drive take the motor where it stands, for what waits for it."""
        drive = self._drive
        # The drive takes no motor while it has a fault; that a host was silent is none any more.
        drive.forgive_silence()
        seen = drive.measure()
        with self.lock:
            self._observe(seen)
            if self.axis.is_moving:
                speed = abs(seen[1] * self._settings.metres_per_turn)
                self.axis.deny(f"the hub moves with {speed:.3g} m/s")
                return
        drive.take_motor(seen[0])
        end_ns = self.steady.now_ns() + round(POWER_S * 1e9)
        while not drive.has_motor():
            drive.feed()
            faults = drive.faults()
            if faults.names or self.steady.now_ns() > end_ns:
                self._switch_off()
                with self.lock:
                    self._show(faults, f"{drive.name} does not take the motor: {faults.text}")
                return
            self.steady.wait(0.01)
        self._is_on = True
        with self.lock:
            self.axis.grant(self.steady.now_ns())


def _unproved(reason: str) -> HubConnectionError:
    return HubConnectionError(reason, fault("watchdog_unproved"))
