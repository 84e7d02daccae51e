"""A board that prints lines and takes no orders: the hub is measured, and somebody else moves it.

A thread reads the port. Where the board prints a clock, its readings are mapped to the host's clock by the times at
which they came; without one, a line's stamp is the time at which it came, with all its jitter.
"""

from __future__ import annotations

import threading
import time

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
from beam_ros.hub.host.answers import Answers
from beam_ros.hub.host.contact import Contact
from beam_ros.hub.host.motion_watch import Measuring
from beam_ros.hub.host.silence import Silence
from beam_ros.hub.host.supervisor import Supervisor
from beam_ros.hub.journal import Journal
from beam_ros.hub.line.transport import SerialTransport
from beam_ros.hub.link_parameters import CsvColumns
from beam_ros.hub.links.csv_measurements import CsvMeasurements
from beam_ros.hub.links.place import HubPlace
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
        self._link = link
        self._transport = SerialTransport(link.serial_port, link.serial_baud, FLOOD_BYTES)
        self._journal = Journal(["bad_lines", "unstamped_lines", "connections"])
        jitter = CLOCK_JITTER_S if columns.clock else RECEIPT_JITTER_S
        most = parameters.max_following_error
        self._supervisor = Supervisor(parameters, self._journal, Measuring(most, most, jitter))
        self._lines = CsvMeasurements(columns, self._supervisor.report)
        self._lock = threading.Lock()
        self._measured: list[SampleBatch] = []
        self._sequences: list[SequenceReport] = []
        self._answers = Answers()
        self._silence = Silence(SILENCE_NS)
        self._place = HubPlace()
        self._contact = Contact(self._journal, "no line has come yet")
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
            has_device_clock=self._lines.has_clock,
            has_watchdog=False,
            keeps_limits=False,
            shortcomings=_SHORTCOMINGS + (_CLOCK if self._lines.has_clock else _NO_CLOCK),
        )

    # The Hub protocol ---------------------------------------------------------------------------------

    def request(self, kind: RequestKind) -> int:
        """Clear a fault that was seen here; refuse the rest: the board takes no commands."""
        with self._lock:
            number, answer = self._answers.begin(), None
            if kind == "clear_fault":
                answer = self._supervisor.answer(kind, "identified")
            outcome = answer or Outcome(False, f"cannot {kind.replace('_', ' ')}: {REFUSAL}")
            self._answers.add(number, outcome.success, outcome.message)
            return number

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
            self._journal.watch_clock(self._lines.clock(now), now)
            self._journal.counters["bad_lines"] = self._lines.n_bad
            self._journal.counters["unstamped_lines"] = self._lines.n_unstamped
            self._look_for_silence(now.steady_ns)
            self._supervisor.look(now.steady_ns)
            self._supervisor.note_status("identified", "idle", 0)
            measured, self._measured = self._measured, []
            sequences, self._sequences = self._sequences, []
            return HubReport(
                applied=[],
                measured=measured,
                sequences=sequences,
                clock=[],
                completed=self._answers.take(),
                status=self._status(),
                events=self._journal.take_events(),
            )

    def close(self) -> None:
        """Let go of the port."""
        self._ending.set()
        self._thread.join(timeout=2.0)

    def _status(self) -> HubStatus:
        if not self._contact.is_made:
            return self._contact.status
        status = HubStatus(
            "identified", self._place.position, self._place.velocity, counters=dict(self._journal.counters)
        )
        return self._supervisor.seen(status)

    # The thread ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        patient_until = time.monotonic() + self._link.patience_s
        while not self._ending.is_set():
            try:
                self._transport.open()
                with self._lock:
                    self._lines.reset()
                    self._supervisor.forget_motion()
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

    def _lose(self, name: str, reason: str) -> None:
        self._silence.lose()
        self._contact.lose(name, reason)

    def _look_for_silence(self, now_ns: int) -> None:
        """Look whether nothing comes that can be read; a board that prints something else is not silent."""
        is_lost = self._silence.is_too_long(now_ns)
        if not is_lost and self._contact.is_made:
            return
        wanted = f"{self._lines.n_columns} numbers"
        # One line alone may be what a pulled cable has cut.
        if self._lines.n_bad_in_a_row > 1:
            self._lose(
                "status_unreadable",
                f"lines come, such as {self._lines.bad_line[:60]!r}: expected {wanted} in each; correct serial.baud "
                "and the csv.*_column parameters",
            )
        elif is_lost:
            self._lose("controller_silent", f"no line with {wanted} came for 1 s; check the board")

    def _take(self, data: bytes, came_ns: int) -> None:
        for line in self._lines.feed(data, came_ns):
            if not self._contact.is_made:
                self._contact.make(f"lines of {line.n_numbers} numbers on {self._link.serial_port}")
            self._silence.end()
            self._place = HubPlace(line.position, line.velocity or 0.0)
            if line.batch is not None:
                # Who moves it, and from where it counts, nobody says here: its travel is not judged.
                self._supervisor.note_measured(line.batch.stamp_ns * 1e-9, line.position, is_led=True)
                self._measured.append(line.batch)
