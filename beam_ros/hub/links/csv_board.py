"""A board that prints lines and takes no orders: the hub is measured, and somebody else moves it.

A thread reads the port. Where the board prints a clock, its readings are mapped to the host's clock by the times at
which they came; without one, a line's stamp is the time at which it came, with all its jitter.
"""

from __future__ import annotations

import threading
import time

import numpy as np

from beam_ros.hub.contract import (
    HostTime,
    HubCapabilities,
    HubReport,
    HubStatus,
    Outcome,
    RequestKind,
    SampleBatch,
    SequenceChunk,
    SequenceReport,
)
from beam_ros.hub.errors import HubConnectionError
from beam_ros.hub.faults import NO_FAULT, Fault, fault
from beam_ros.hub.host.motion_watch import CertainMotion
from beam_ros.hub.host.receipt_clock import ReceiptClock
from beam_ros.hub.host.silence import Silence
from beam_ros.hub.host.supervisor import Supervisor
from beam_ros.hub.host_clock import HostClock
from beam_ros.hub.journal import Journal
from beam_ros.hub.line.transport import SerialTransport
from beam_ros.hub.link_parameters import CsvColumns
from beam_ros.hub.links.csv_lines import CsvReader
from beam_ros.hub.parameters import AxisParameters, LinkParameters

READ_S = 0.05
RECONNECT_S = 0.3
FLOOD_BYTES = 2_000_000
"""More bytes in a second than a board prints."""
SILENCE_NS = 1_000_000_000
"""A board that prints nothing that can be read for this long is lost [ns]."""
CLOCK_JITTER_S, RECEIPT_JITTER_S = 0.005, 0.05
"""By how much a stamp may be wrong that comes from the board's clock, and one that does not [s]."""
REFUSAL = (
    "the board behind axis.kind csv only prints lines: it takes no commands; move the hub by its own program"
)

_SHORTCOMINGS = (
    "it takes no commands: nothing here can stop it",
    "no limit is kept and no watchdog watches",
    "what was commanded is not known: identify with the measured position",
)
_CLOCK = (
    "the board's clock is mapped by the times at which its lines came: the shortest delay stays in the stamps",
)
_NO_CLOCK = ("a line's stamp is the time at which it came: its jitter is noise of the hub's position",)


class CsvHub:
    """A hub that a board measures; implements ``Hub`` by refusing every command.

    Parameters
    ----------
    parameters : AxisParameters
        The axis: by its limits a measurement is judged.
    link : LinkParameters
        The board's port.
    columns : CsvColumns
        What its lines mean.
    """

    def __init__(self, parameters: AxisParameters, link: LinkParameters, columns: CsvColumns) -> None:
        self._columns = columns
        self._link = link
        self._transport = SerialTransport(link.serial_port, link.serial_baud, FLOOD_BYTES)
        self._reader = CsvReader()
        self._journal = Journal(["bad_lines", "unstamped_lines", "connections"])
        self._supervisor = Supervisor(parameters, self._journal)
        jitter = CLOCK_JITTER_S if columns.clock else RECEIPT_JITTER_S
        self._motion = CertainMotion(parameters, parameters.max_following_error, jitter)
        self._lock = threading.Lock()
        self._stamps: HostClock | None = None
        self._device_clock = self._new_clock()
        self._measured: list[SampleBatch] = []
        self._sequences: list[SequenceReport] = []
        self._completed: list[tuple[int, Outcome]] = []
        self._n_requests = 0
        self._silence = Silence(SILENCE_NS)
        self._last_stamp_ns = 0
        self._position = self._velocity = 0.0
        self._fault: Fault = fault("no_answer")
        self._reason = "no line has come yet"
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="csv-board", daemon=True)
        self._thread.start()

    @property
    def capabilities(self) -> HubCapabilities:
        """What the board can promise, which is little."""
        return HubCapabilities(
            name="csv",
            modes=(),
            is_buffered=False,
            has_device_clock=bool(self._columns.clock),
            has_watchdog=False,
            keeps_limits=False,
            shortcomings=_SHORTCOMINGS + (_CLOCK if self._columns.clock else _NO_CLOCK),
        )

    # The Hub protocol ---------------------------------------------------------------------------------

    def request(self, kind: RequestKind) -> int:
        """Clear a fault that was seen here; refuse the rest: the board takes no commands."""
        with self._lock:
            self._n_requests += 1
            answer = None
            if kind == "clear_fault":
                answer = self._supervisor.answer(kind, "identified")
            outcome = answer or Outcome(False, f"cannot {kind.replace('_', ' ')}: {REFUSAL}")
            self._completed.append((self._n_requests, outcome))
            return self._n_requests

    def setpoint(self, stamp_ns: int, value: float, now: HostTime) -> Outcome:
        """Refuse: the board takes no commands."""
        with self._lock:
            self._journal.counters["setpoints_refused"] += 1
        return Outcome(False, f"set-point refused: {REFUSAL}")

    def load(self, chunk: SequenceChunk, now: HostTime) -> None:
        """Refuse: the board takes no commands."""
        if chunk.index == 1:
            with self._lock:
                self._sequences.append(
                    SequenceReport(chunk.sequence_id, "refused", len(chunk.values), REFUSAL)
                )

    def poll(self, now: HostTime) -> HubReport:
        """Collect what the board printed."""
        with self._lock:
            if self._stamps is None:
                self._stamps = HostClock(now)
            self._journal.watch_clock(self._stamps, now)
            self._journal.counters["bad_lines"] = self._reader.n_bad
            self._look_for_silence(now.steady_ns)
            self._supervisor.look(now.steady_ns)
            self._supervisor.note_status("identified", "idle", 0)
            measured, self._measured = self._measured, []
            sequences, self._sequences = self._sequences, []
            completed, self._completed = self._completed, []
            return HubReport(
                applied=[],
                measured=measured,
                sequences=sequences,
                clock=[],
                completed=completed,
                status=self._status(),
                events=self._journal.take_events(),
            )

    def close(self) -> None:
        """Let go of the port."""
        self._ending.set()
        self._thread.join(timeout=2.0)

    def _status(self) -> HubStatus:
        counters = dict(self._journal.counters)
        if self._fault is not NO_FAULT:
            return HubStatus("disconnected", fault=self._fault, reason=self._reason, counters=counters)
        status = HubStatus("identified", self._position, self._velocity, counters=counters)
        return self._supervisor.seen(status)

    # The thread ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        patient_until = time.monotonic() + self._link.patience_s
        while not self._ending.is_set():
            try:
                self._transport.open()
                with self._lock:
                    self._reader.reset()
                    self._device_clock = self._new_clock()
                    self._motion.forget()
                while not self._ending.is_set():
                    data, came_ns = self._transport.read(READ_S)
                    with self._lock:
                        self._take(data, came_ns)
            except HubConnectionError as err:
                self._transport.close()
                if err.fault.name != "port_unavailable" or time.monotonic() > patient_until:
                    with self._lock:
                        self._lose(err.fault.name, str(err))
                self._ending.wait(RECONNECT_S)
        self._transport.dispose()

    def _new_clock(self) -> ReceiptClock:
        columns = self._columns
        modulus = 1 << columns.clock_bits if columns.clock_bits else 0
        return ReceiptClock(columns.clock_tick * 1e9, modulus, self._supervisor.report)

    def _lose(self, name: str, reason: str) -> None:
        if self._silence.is_connected or self._fault.name != name:
            self._journal.tell("error", reason)
        self._silence.lose()
        self._fault, self._reason = fault(name), reason

    def _look_for_silence(self, now_ns: int) -> None:
        if self._silence.is_too_long(now_ns):
            self._lose(
                "controller_silent",
                f"no line with {self._columns.last} numbers came for 1 s; check the board",
            )

    def _take(self, data: bytes, came_ns: int) -> None:
        for row in self._reader.feed(data):
            if len(row) < self._columns.last:
                self._reader.n_bad += 1
                continue
            self._note_row(row, came_ns)

    def _note_row(self, row: tuple[float, ...], came_ns: int) -> None:
        columns = self._columns
        if not self._silence.is_connected:
            self._fault, self._reason = NO_FAULT, ""
            self._journal.counters["connections"] += 1
            self._journal.tell("info", f"connected: lines of {len(row)} numbers on {self._link.serial_port}")
        self._silence.end()
        scale = columns.position_scale
        self._position = row[columns.position - 1] * scale
        self._velocity = row[columns.velocity - 1] * scale if columns.velocity else 0.0
        stamp_ns = self._stamp_ns(row, came_ns)
        if stamp_ns is None or stamp_ns <= self._last_stamp_ns:
            self._journal.counters["unstamped_lines"] += 1
            return
        self._last_stamp_ns = stamp_ns
        # Who moves it, and from where it counts, nobody says here: its travel is not judged.
        time_s, position = np.array([stamp_ns * 1e-9]), np.array([self._position])
        found = self._motion.find(time_s, position, is_homed=False, is_enabled=True)
        if found is not None:
            self._supervisor.report(*found)
        effort = row[columns.effort - 1] * columns.effort_scale if columns.effort else None
        self._measured.append(
            SampleBatch(
                stamp_ns,
                0,
                self._device_clock.epoch,
                positions=np.array([self._position]),
                velocities=np.array([self._velocity]) if columns.velocity else None,
                efforts=None if effort is None else np.array([effort]),
            )
        )

    def _stamp_ns(self, row: tuple[float, ...], came_ns: int) -> int | None:
        if self._stamps is None:
            return None
        if not self._columns.clock:
            return self._stamps.stamp_ns(came_ns)
        device_ns = self._device_clock.add(round(row[self._columns.clock - 1]), came_ns)
        if device_ns is None or not self._device_clock.is_usable:
            return None
        return self._stamps.stamp_ns(self._device_clock.host_ns(device_ns))
