"""A board that prints lines and takes no orders: the hub is measured, and somebody else moves it.

Where the board prints a clock, its readings are mapped to the host's clock by the times at which they came; without
one, a line's stamp is the time at which it came, with all its jitter.
"""

from __future__ import annotations

import dataclasses

from beam_ros.hub.contract import HostTime, HubCapabilities, HubReport, Outcome, RequestKind, SequenceChunk
from beam_ros.hub.errors import HubConnectionError
from beam_ros.hub.host.motion_watch import Measuring
from beam_ros.hub.line.transport import RECONNECT_S, SerialTransport
from beam_ros.hub.link_parameters import CsvColumns
from beam_ros.hub.links.csv_measurements import CsvMeasurements
from beam_ros.hub.links.host_axis import HostAxis
from beam_ros.hub.links.host_paced_hub import HostPacedHub
from beam_ros.hub.links.query_line import SteadyTime
from beam_ros.hub.parameters import AxisParameters, LinkParameters

READ_S = 0.05
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


class CsvHub(HostPacedHub):
    """A hub that a board measures; implements ``Hub`` by refusing every command.

    Parameters
    ----------
    parameters : AxisParameters
        The axis: by its limits a measurement is judged.
    link : LinkParameters
        The board's port.
    columns : CsvColumns
        What its lines mean.
    port : SerialTransport, optional
        An unopened port, in place of the one that ``link`` names.
    steady : SteadyTime, optional
        A clock of the caller's, who then calls ``turn`` again and again; else a thread does.
    """

    def __init__(
        self,
        parameters: AxisParameters,
        link: LinkParameters,
        columns: CsvColumns,
        *,
        port: SerialTransport | None = None,
        steady: SteadyTime | None = None,
    ) -> None:
        most = parameters.max_following_error
        axis = HostAxis(
            parameters,
            counters=("bad_lines", "unstamped_lines"),
            measuring=Measuring(most, most, CLOCK_JITTER_S if columns.clock else RECEIPT_JITTER_S),
            patience_ns=SILENCE_NS,
        )
        capabilities = HubCapabilities(
            name="csv",
            modes=(),
            is_buffered=False,
            has_device_clock=bool(columns.clock),
            has_watchdog=False,
            keeps_limits=False,
            shortcomings=_SHORTCOMINGS + (_CLOCK if columns.clock else _NO_CLOCK),
        )
        super().__init__(axis, capabilities, steady)
        self._link = link
        self._port = port or SerialTransport(link.serial_port, link.serial_baud, FLOOD_BYTES)
        self._lines = CsvMeasurements(columns, self._blame_clock)
        self._patient_until_ns = self.steady.now_ns() + round(link.patience_s * 1e9)
        self._begin(steady)

    # The Hub protocol ---------------------------------------------------------------------------------

    def request(self, kind: RequestKind) -> int:
        """Clear a fault that was seen here; refuse the rest: the board takes no commands."""
        with self.lock:
            if kind == "clear_fault" and self.axis.is_broken:
                return self.axis.request(kind, self.steady.now_ns())
            return self.axis.refuse(kind, REFUSAL)

    def setpoint(self, stamp_ns: int, value: float, now: HostTime) -> Outcome:
        """Refuse: the board takes no commands."""
        with self.lock:
            self.axis.journal.counters["setpoints_refused"] += 1
        return Outcome(False, f"set-point refused: {REFUSAL}")

    def load(self, chunk: SequenceChunk, now: HostTime) -> None:
        """Refuse: the board takes no commands."""
        super().load(dataclasses.replace(chunk, fault=REFUSAL), now)

    def poll(self, now: HostTime) -> HubReport:
        """Collect what the board printed."""
        with self.lock:
            self.axis.journal.counters["bad_lines"] = self._lines.n_bad
            self.axis.journal.counters["unstamped_lines"] = self._lines.n_unstamped
            self._look_for_silence(now.steady_ns)
            self.axis.step(now.steady_ns)
            return self.axis.poll(now)

    # Turns ---------------------------------------------------------------------------------------------

    def turn(self) -> None:
        """Take what the board prints; a port that is lost is opened again."""
        try:
            if not self._port.is_open:
                self._port.open()
                with self.lock:
                    self._lines.reset()
                    self.axis.contact.await_answer()
            data, came_ns = self._port.read(READ_S)
        except HubConnectionError as err:
            self._port.close()
            if err.fault.name != "port_unavailable" or self.steady.now_ns() > self._patient_until_ns:
                with self.lock:
                    self.axis.disconnect(err.fault.name, str(err))
            self.steady.wait(RECONNECT_S)
            return
        with self.lock:
            self._take(data, came_ns)

    def _let_go(self) -> None:
        self._port.dispose()

    def _blame_clock(self, name: str, reason: str) -> None:
        self.axis.fail(name, reason, self.steady.now_ns())

    def _look_for_silence(self, now_ns: int) -> None:
        """Look whether nothing comes that can be read; a board that prints something else is not silent."""
        is_lost = self.axis.contact.is_silent(now_ns)
        if not is_lost and self.axis.contact.is_made:
            return
        wanted = f"{self._lines.n_columns} numbers"
        # One line alone may be what a pulled cable has cut.
        if self._lines.n_bad_in_a_row > 1:
            self.axis.disconnect(
                "status_unreadable",
                f"lines come, such as {self._lines.bad_line[:60]!r}: expected {wanted} in each; correct serial.baud "
                "and the csv.*_column parameters",
            )
        elif is_lost:
            self.axis.disconnect("controller_silent", f"no line with {wanted} came for 1 s; check the board")

    def _take(self, data: bytes, came_ns: int) -> None:
        stamps = self.axis.stamps
        for line in self._lines.feed(data, came_ns):
            if not self.axis.contact.is_made:
                self.axis.connect(f"lines of {line.n_numbers} numbers on {self._link.serial_port}")
            self.axis.contact.hear()
            stamp_ns = None
            if stamps is not None and line.steady_ns is not None:
                stamp_ns = stamps.stamp_ns(line.steady_ns)
            # Who moves it, and from where it counts, nobody says here: its travel is not judged.
            self.axis.measure(
                line.position, line.velocity, stamp_ns, line.effort, epoch=line.epoch, is_led=True
            )
