"""A sequence on its way to the device: announced when the clock is known, streamed as the buffer takes it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from beam_ros.arrays import FloatArray
from beam_ros.hub.contract import AxisEventKind
from beam_ros.hub.gate.command_gate import CommandGate
from beam_ros.hub.gate.sequence_assembly import Sequence
from beam_ros.hub.host.sample_stamping import DeviceClock
from beam_ros.hub.host.sample_window import SampleWindow
from beam_ros.hub.journal import Journal

LAST_ARM_NS = 80_000_000
"""A complete sequence waits for the clock map to be good enough until this long before its start."""
ARM_AGAIN_NS = 100_000_000
FRAMES_PER_TURN = 4

_ENDS: dict[str, AxisEventKind] = {
    "done": "sequence_done",
    "aborted": "sequence_aborted",
    "underrun": "sequence_underrun",
}


@dataclass
class _Transfer:
    sequence: Sequence
    number: int
    start_steady_ns: int
    window: SampleWindow
    start_device_ns: int | None = None
    last_arm_ns: int = 0
    is_accepted: bool = False
    is_running: bool = False
    edge: int = 0


class SequenceStream:
    """The one sequence that is on its way or running.

    Parameters
    ----------
    gate : CommandGate
        Is told of the sequence's fate.
    device_clock : DeviceClock
        Gives the start in device time.
    journal : Journal
        Counts what was sent again.
    period_ns : int
        Of the device's ticks, each of which needs a sample [ns].
    """

    def __init__(
        self, gate: CommandGate, device_clock: DeviceClock, journal: Journal, period_ns: int
    ) -> None:
        self._gate = gate
        self._device_clock = device_clock
        self._journal = journal
        self._needed_rate = 1e9 / period_ns
        self._number = 0
        self._transfer: _Transfer | None = None

    @property
    def is_accepted(self) -> bool:
        """Whether the device awaits or runs it."""
        return self._transfer is not None and self._transfer.is_accepted

    def begin(self, sequence: Sequence, start_steady_ns: int) -> None:
        """Take a checked sequence that is to start at a steady time [ns]."""
        self._number = self._number % 0xFFFF + 1
        window = SampleWindow(sequence.n_ticks, self._device_clock.mapping.shortest_rtt_ns)
        self._transfer = _Transfer(sequence, self._number, start_steady_ns, window)

    def lose(self, reason: str) -> None:
        """Unload the sequence, because the device cannot be reached any more."""
        self._end_early("aborted", reason)

    def announcement(self, now_ns: int) -> tuple[int, int, int] | None:
        """Return number, start [ns of device time] and samples, where they are to be announced now."""
        transfer = self._transfer
        if transfer is None or transfer.is_accepted:
            return None
        if transfer.start_device_ns is None:
            sd_ns, limit_ns = self._device_clock.sd_ns(now_ns), self._device_clock.max_sd_ns
            if sd_ns < limit_ns:
                transfer.start_device_ns = self._device_clock.device_says_ns(transfer.start_steady_ns)
            elif now_ns > transfer.start_steady_ns - LAST_ARM_NS:
                self._end_early(
                    "refused",
                    f"the clock map's standard deviation is {sd_ns / 1000:.0f} us: expected below "
                    f"{limit_ns / 1000:g} us; look for a slow USB hub or a busy computer",
                    is_late=True,
                )
        if transfer.start_device_ns is None or now_ns - transfer.last_arm_ns < ARM_AGAIN_NS:
            return None
        transfer.last_arm_ns = now_ns
        return transfer.number, transfer.start_device_ns, transfer.sequence.n_ticks

    def is_line_taken(self, now_ns: int) -> bool:
        """Whether samples are under way behind which a question for the clock would wait."""
        return self._transfer is not None and self._transfer.window.is_line_taken(now_ns)

    def samples(self, now_ns: int) -> Iterator[tuple[int, int, FloatArray]]:
        """Yield what is to be sent now: the sequence's number, the first sample's, and the samples."""
        transfer = self._transfer
        if transfer is None or not transfer.is_accepted:
            return
        for _ in range(FRAMES_PER_TURN):
            frame = transfer.window.next_frame(transfer.edge, now_ns)
            if frame is None:
                break
            self._journal.counters["resent_samples"] += transfer.window.send(*frame, now_ns)
            yield transfer.number, frame[0], transfer.sequence.ticks(*frame)

    def note_answer(self, number: int, is_accepted: bool, text: str, received_ns: int) -> None:
        """Take the device's answer to the announcement, which came at a steady time [ns]."""
        transfer = self._transfer
        if transfer is None or number != transfer.number or transfer.is_accepted:
            return
        if is_accepted:
            transfer.is_accepted = True
        else:
            self._end_early("refused", text, is_late=received_ns > transfer.start_steady_ns)

    def follow(
        self, number: int, state: str, received: int, free: int, reason: str, received_ns: int
    ) -> None:
        """Take note of where the device says that the sequence stands.

        Parameters
        ----------
        number : int
            The sequence that the device speaks of.
        state : str
            armed, running, done, aborted or underrun.
        received, free : int
            Samples that have come without a gap, and room for more.
        reason : str
            Why it ended early.
        received_ns : int
            Steady time at which this came [ns].
        """
        transfer = self._transfer
        if transfer is None or number != transfer.number:
            return
        transfer.window.receive(received, received_ns)
        transfer.edge = max(transfer.edge, received + free)
        if state in ("running", "done", "underrun") and not transfer.is_running:
            transfer.is_running = True
            self._gate.note("sequence_running", "")
        if state in _ENDS:
            self._gate.note(_ENDS[state], reason + self._slowness(transfer.window, state))
            self._transfer = None

    def _slowness(self, window: SampleWindow, state: str) -> str:
        """Say what the line carried, where that is why samples were missing."""
        if state != "underrun" or window.rate >= self._needed_rate:
            return ""
        return (
            f"; the line carried {window.rate:.0f} samples/s, expected more than {self._needed_rate:g}: free the "
            "processors at both ends, or use a faster line or a longer hub.period"
        )

    def _end_early(self, state: Literal["refused", "aborted"], reason: str, *, is_late: bool = False) -> None:
        self._transfer = None
        self._gate.finish(state, reason, is_late=is_late)
