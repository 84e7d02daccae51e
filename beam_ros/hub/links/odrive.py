"""An ODrive behind its ASCII protocol: the host writes every position, and asks for every measurement.

A thread keeps the pace on the steady clock. Whatever the plan says for the present instant is written with the
command ``p`` (position, with the velocity as feed-forward), and ``f`` asks where the motor is. The
ODrive's own watchdog is set, read back and provoked before it is believed: set over ASCII it once did not run
(https://github.com/odriverobotics/ODrive/issues/460).
"""

from __future__ import annotations

import dataclasses
import threading
import time
from collections import deque
from dataclasses import dataclass

import numpy as np

from beam_ros.hub.contract import HubCapabilities, SampleBatch
from beam_ros.hub.errors import HubConnectionError, HubProtocolError
from beam_ros.hub.faults import fault
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.line.transport import SerialTransport
from beam_ros.hub.link_parameters import OdriveParameters
from beam_ros.hub.links import odrive_protocol as ascii_protocol
from beam_ros.hub.links.host_axis import HostAxis
from beam_ros.hub.links.host_paced_hub import HostPacedHub
from beam_ros.hub.parameters import AxisParameters, LinkParameters

ANSWER_S = 0.1
"""An answer that has not come by then does not come."""
MISSES = 5
"""So many answers in a row that did not come are a lost controller."""
RECONNECT_S = 0.3
LATE_NS = 20_000_000
"""A write that is later than this is looked at before anything else is written [ns]."""
LOOK_EVERY = 10
"""The ODrive's state and faults are read once in so many writes."""
RTTS = 200
"""Exchanges of which the shortest counts."""
MAX_EXCESS_NS = 2_000_000
"""A measurement whose exchange took longer than the shortest by this has no time, and is not reported [ns]."""
FLOOD_BYTES = 200_000
"""More bytes in a second than an ODrive answers."""
POWER_S = 1.0
"""Longest wait for the ODrive to take the motor [s]."""

CAPABILITIES = HubCapabilities(
    name="odrive",
    modes=("acceleration", "velocity", "position"),
    is_buffered=False,
    has_device_clock=False,
    has_watchdog=True,
    keeps_limits=False,
    telemetry="poll",
    rate=200.0,
    shortcomings=(
        "the host paces every position: a busy computer is heard in the hub's motion",
        "samples carry the middle of their question and answer, not the drive's own time",
        "the drive keeps the speed limit alone: travel and acceleration are kept by this program, not by the drive",
        "when the host falls silent the drive switches the motor off, so that the hub coasts instead of braking",
        "what was written is not what was done: identify with the measured position",
    ),
)


@dataclass(frozen=True)
class Feedback:
    """Where the motor is.

    Parameters
    ----------
    turns, speed : float
        Position [turns] and velocity [turns/s].
    middle_ns : int
        Steady time in the middle of question and answer [ns].
    excess_ns : int
        By how much both took longer than the shortest of late [ns]: the time is wrong by half of it at the most,
        besides what all exchanges share.
    """

    turns: float
    speed: float
    middle_ns: int
    excess_ns: int


class Odrive:
    """Questions and answers over an open port.

    Parameters
    ----------
    transport : SerialTransport
        The port.
    axis : int
        Number of the axis.
    """

    def __init__(self, transport: SerialTransport, axis: int) -> None:
        self._transport = transport
        self._buffer = b""
        self._rtts_ns: deque[int] = deque(maxlen=RTTS)
        self.axis = axis

    def tell(self, command: str) -> None:
        """Send a command that has no answer."""
        self._transport.write(ascii_protocol.encode_line(command))

    def ask(self, command: str) -> tuple[str, int, int]:
        """Send a question; return the answer and the steady times of both [ns].

        Raises
        ------
        HubProtocolError
            No answer, or a spoilt one.
        HubConnectionError
            The port vanished.
        """
        sent_ns = time.monotonic_ns()
        self._buffer = b""
        self.tell(command)
        end_ns = sent_ns + round(ANSWER_S * 1e9)
        is_over = False
        while b"\n" not in self._buffer:
            if is_over or len(self._buffer) > ascii_protocol.MAX_LINE:
                self.drain()
                raise HubProtocolError(
                    f"no answer to {command!r} within {ANSWER_S:g} s: expected one line; check the cable and "
                    "serial.baud"
                )
            # An answer that came while this process was frozen is there, although the time is over.
            left_s = (end_ns - time.monotonic_ns()) * 1e-9
            is_over = left_s <= 0.0
            data, came_ns = self._transport.read(max(0.0, left_s))
            self._buffer += data
        line, _, rest = self._buffer.partition(b"\n")
        if rest:
            self.drain()
        return ascii_protocol.decode_line(line), sent_ns, came_ns

    def drain(self) -> None:
        """Throw away what still comes of earlier answers."""
        end = time.monotonic() + ANSWER_S
        while time.monotonic() < end:
            if not self._transport.read(0.01)[0]:
                return

    def read(self, path: str) -> float:
        """Return a property of the axis."""
        text, _, _ = self.ask(f"r axis{self.axis}.{path}")
        return ascii_protocol.numbers(text, 1)[0]

    def write(self, path: str, value: float) -> None:
        """Set a property of the axis and read it back.

        Raises
        ------
        HubProtocolError
            The ODrive keeps another value.
        """
        self.tell(f"w axis{self.axis}.{path} {value:.9g}")
        kept = self.read(path)
        if not abs(kept - value) <= 1e-5 * abs(value):
            raise HubProtocolError(
                f"axis{self.axis}.{path} is {kept:g} after it was set to {value:g}: expected the value that was "
                "set; update the ODrive's firmware"
            )

    def feedback(self) -> Feedback:
        """Ask where the motor is."""
        text, sent_ns, came_ns = self.ask(f"f {self.axis}")
        position, velocity = ascii_protocol.numbers(text, 2)
        self._rtts_ns.append(came_ns - sent_ns)
        excess_ns = came_ns - sent_ns - min(self._rtts_ns)
        return Feedback(position, velocity, (sent_ns + came_ns) // 2, excess_ns)

    def faults(self) -> list[str]:
        """Return the names of all faults of the axis."""
        names = []
        for register in ascii_protocol.FAULT_REGISTERS:
            names += ascii_protocol.fault_names(register, int(self.read(register)))
        return names


class OdriveHub(HostPacedHub):
    """A hub on an ODrive; implements ``Hub``.

    Parameters
    ----------
    parameters : AxisParameters
        The axis.
    link : LinkParameters
        Its port.
    odrive : OdriveParameters
        How the ODrive moves the hub.
    guard : BeamGuard, optional
        A further check of complete sequences, for limits that need a model of the beam.
    """

    def __init__(
        self,
        parameters: AxisParameters,
        link: LinkParameters,
        odrive: OdriveParameters,
        guard: BeamGuard | None = None,
    ) -> None:
        axis = HostAxis(
            parameters,
            guard,
            homes_here=odrive.homes_here,
            counters=("late_writes", "lost_answers", "untimed_answers", "connections"),
        )
        super().__init__(axis, dataclasses.replace(CAPABILITIES, rate=odrive.rate))
        self._parameters = parameters
        self._settings = odrive
        self._link = link
        self._transport = SerialTransport(link.serial_port, link.serial_baud, FLOOD_BYTES)
        self._odrive = Odrive(self._transport, odrive.axis)
        self._is_on = False
        self._was_broken = False
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="odrive", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop the axis, switch the motor off, and let go of the port."""
        if not self._ending.is_set():
            super().close()
            self._ending.set()
            self._thread.join(timeout=2.0)

    # The thread ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        patient_until = time.monotonic() + self._link.patience_s
        while not self._ending.is_set():
            try:
                self._transport.open()
                self._prepare()
                self._lead()
            except HubConnectionError as err:
                if err.fault.name != "port_unavailable" or time.monotonic() > patient_until:
                    self._lose(err.fault.name, err)
            except _UnprovedError as err:
                self._lose("watchdog_unproved", err)
            except HubProtocolError as err:
                self._lose("no_answer", err)
            self._ending.wait(RECONNECT_S)
        self._switch_off()
        self._transport.dispose()

    def _lose(self, name: str, err: Exception) -> None:
        self._switch_off()
        self._transport.close()
        with self.lock:
            self.axis.disconnect(name, str(err))

    def _switch_off(self) -> None:
        """Switch the motor off, as far as anybody listens; else the watchdog does it."""
        self._is_on = False
        if self._transport.is_open:
            try:
                self._odrive.tell(f"w axis{self._settings.axis}.requested_state {ascii_protocol.IDLE}")
            except HubConnectionError:
                return

    def _prepare(self) -> None:
        """Set modes, limits and watchdog of an ODrive whose motor is off, and prove the watchdog."""
        odrive, n = self._odrive, self._settings.axis
        odrive.drain()
        odrive.tell(f"w axis{n}.requested_state {ascii_protocol.IDLE}")
        per_turn = abs(self._settings.metres_per_turn)
        odrive.write("config.enable_watchdog", 0)
        odrive.write("controller.config.control_mode", ascii_protocol.POSITION_CONTROL)
        odrive.write("controller.config.input_mode", ascii_protocol.PASSTHROUGH)
        odrive.write("controller.config.vel_limit", self._parameters.max_speed / per_turn)
        odrive.write("controller.config.enable_overspeed_error", 1)
        odrive.write("config.watchdog_timeout", self._parameters.watchdog_s)
        odrive.tell("sc")
        odrive.tell(f"u {n}")
        odrive.write("config.enable_watchdog", 1)
        if self._link.prove_watchdog:
            self._prove_watchdog()
        seen = odrive.feedback()
        with self.lock:
            self._observe(seen)
            self.axis.connect()
            self.axis.journal.counters["connections"] += 1
            self.axis.journal.tell("info", f"connected: ODrive axis {n} on {self._link.serial_port}")

    def _prove_watchdog(self) -> None:
        """Fall silent with the motor off, and require that the watchdog notices, neither early nor late."""
        odrive, n = self._odrive, self._settings.axis
        patience = self._parameters.watchdog_s
        odrive.tell(f"u {n}")
        start = asked = time.monotonic()
        while not int(odrive.read("error")) & ascii_protocol.WATCHDOG_EXPIRED:
            if asked - start > 1.5 * patience + ANSWER_S:
                raise _UnprovedError(
                    f"the ODrive's watchdog was set to {patience:g} s and did not act on "
                    f"{asked - start:.2f} s of silence: expected WATCHDOG_TIMER_EXPIRED; update its "
                    "firmware to 0.5.1 or later"
                )
            self._ending.wait(patience / 20)
            asked = time.monotonic()
        took = time.monotonic() - start
        if took < 0.5 * patience:
            raise _UnprovedError(
                f"the ODrive's watchdog acted after {took:.3f} s: expected {patience:g} s; look for another program "
                "on the same ODrive"
            )
        # Fed first: a watchdog that is cleared while it is overdue acts again at once.
        odrive.tell(f"u {n}")
        odrive.tell("sc")
        left = int(odrive.read("error"))
        if left & ascii_protocol.WATCHDOG_EXPIRED:
            raise _UnprovedError(
                "the ODrive's watchdog fault cannot be cleared: expected `sc` to clear it; update its firmware"
            )

    def _lead(self) -> None:
        """Write and measure at the rate, until the port is lost or the hub is closed."""
        period_ns = round(1e9 / self._settings.rate)
        due_ns = time.monotonic_ns()
        misses = turn = 0
        while not self._ending.is_set():
            now_ns = time.monotonic_ns()
            if now_ns < due_ns:
                self._ending.wait((due_ns - now_ns) * 1e-9)
                now_ns = time.monotonic_ns()
            late_ns = now_ns - due_ns
            due_ns = due_ns + period_ns if late_ns < period_ns else now_ns + period_ns
            if late_ns > period_ns:
                self.axis.journal.counters["late_writes"] += 1
            try:
                if self._is_on and late_ns > LATE_NS:
                    self._check()
                    seen = self._odrive.feedback()
                    with self.lock:
                        self._observe(seen)
                        self.axis.note_late(late_ns, now_ns)
                elif turn % LOOK_EVERY == 0:
                    self._check()
                self._turn()
                turn += 1
                misses = 0
            except HubProtocolError as err:
                misses += 1
                self.axis.journal.counters["lost_answers"] += 1
                if misses >= MISSES:
                    reason = f"the ODrive fell silent: {err}"
                    raise HubConnectionError(reason, fault("controller_silent")) from err

    def _turn(self) -> None:
        """Write what is due now, and measure."""
        with self.lock:
            self.axis.step(time.monotonic_ns())
            is_wanted, waits = self.axis.is_powered, bool(self.axis.powering)
            is_cleared = self._was_broken and not self.axis.is_broken
            self._was_broken = self.axis.is_broken
        if is_cleared:
            self._odrive.tell("sc")
        if waits:
            self._power_on()
        elif self._is_on and not is_wanted:
            self._switch_off()
        per_turn = self._settings.metres_per_turn
        if self._is_on:
            with self.lock:
                now_ns = time.monotonic_ns()
                position, velocity, _ = self.axis.reference(now_ns)
                raw = position + self.axis.zero
                self._note_written(now_ns, position, velocity)
            self._odrive.tell(f"p {self._settings.axis} {raw / per_turn:.9f} {velocity / per_turn:.6f}")
        else:
            self._odrive.tell(f"u {self._settings.axis}")
        seen = self._odrive.feedback()
        with self.lock:
            self._observe(seen)
            stamps = self.axis.stamps
            if seen.excess_ns > MAX_EXCESS_NS:
                self.axis.journal.counters["untimed_answers"] += 1
            elif stamps is not None:
                stamp_ns = stamps.stamp_ns(seen.middle_ns)
                self.axis.add_measured(stamp_ns, seen.turns * per_turn, seen.speed * per_turn, None)

    def _observe(self, seen: Feedback) -> None:
        per_turn = self._settings.metres_per_turn
        self.axis.observe(seen.turns * per_turn, seen.speed * per_turn)

    def _note_written(self, now_ns: int, position: float, velocity: float) -> None:
        """Report one written position, with the time at which it was written."""
        stamps = self.axis.stamps
        if stamps is not None:
            batch = SampleBatch(
                stamps.stamp_ns(now_ns), 0, 1, positions=np.array([position]), velocities=np.array([velocity])
            )
            self.axis.add_applied(batch)

    def _check(self) -> None:
        """Look whether the ODrive still leads the motor, and whether it reports faults."""
        state = int(self._odrive.read("current_state"))
        error = int(self._odrive.read("error"))
        if self._is_on and (state != ascii_protocol.CLOSED_LOOP or error):
            names = ", ".join(self._odrive.faults()) or "no fault named"
            self._is_on = False
            silent = bool(error & ascii_protocol.WATCHDOG_EXPIRED)
            with self.lock:
                self.axis.fail(
                    "host_silent" if silent else "drive_alarm",
                    f"the ODrive switched the motor off (state {state}): {names}",
                    time.monotonic_ns(),
                    is_limp=True,
                )
        elif not (self._is_on or self.axis.is_broken) and error & ~ascii_protocol.WATCHDOG_EXPIRED:
            # The drive keeps its faults until it is told to clear them, which follows on hub/clear_fault.
            names = ", ".join(self._odrive.faults())
            with self.lock:
                self.axis.fail(
                    "drive_alarm", f"the ODrive reports {names}", time.monotonic_ns(), is_limp=True
                )

    def _power_on(self) -> None:
        """Let the ODrive take the motor where it stands, for what waits for it."""
        odrive, n = self._odrive, self._settings.axis
        odrive.tell(f"u {n}")
        odrive.tell("sc")
        seen = odrive.feedback()
        with self.lock:
            self._observe(seen)
            if self.axis.is_moving:
                self.axis.deny(
                    f"the hub moves with {abs(seen.speed * self._settings.metres_per_turn):.3g} m/s"
                )
                return
        odrive.tell(f"p {n} {seen.turns:.9f} 0")
        odrive.tell(f"w axis{n}.requested_state {ascii_protocol.CLOSED_LOOP}")
        end = time.monotonic() + POWER_S
        while int(odrive.read("current_state")) != ascii_protocol.CLOSED_LOOP:
            odrive.tell(f"u {n}")
            names = odrive.faults()
            if names or time.monotonic() > end:
                self._switch_off()
                with self.lock:
                    self.axis.deny(
                        f"the ODrive does not take the motor ({', '.join(names) or 'no fault named'}); calibrate it "
                        "with odrivetool"
                    )
                return
            self._ending.wait(0.01)
        self._is_on = True
        with self.lock:
            self.axis.grant(time.monotonic_ns())


class _UnprovedError(HubProtocolError):
    """The watchdog did not do what it was set to."""
