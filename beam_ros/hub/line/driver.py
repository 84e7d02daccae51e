"""The hub behind a serial port: ``HubClient`` with a port, a thread and the one place that reconnects."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from beam_ros.hub.contract import (
    HostTime,
    HubCapabilities,
    HubReport,
    Outcome,
    RequestKind,
    SequenceChunk,
)
from beam_ros.hub.errors import HubConnectionError, PortDeniedError
from beam_ros.hub.faults import fault
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.line.client import HubClient
from beam_ros.hub.line.transport import RECONNECT_S, SerialTransport
from beam_ros.hub.parameters import AxisParameters, LinkParameters

BUSY_S, CALM_S = 0.005, 0.02
"""Longest wait for bytes while something is under way, and else [s]; commands end it early."""
FLOOD_BYTES, FLOOD_BYTES_PER_TICK = 100_000, 240
"""More than this in a second is a flood: what waits after a pause, and ten times what telemetry needs."""
CLOSE_S = 1.0
"""Longest wait for the axis to have stopped on closing [s]; at 10 m/s^2 it stops from 0.5 m/s in 0.05 s."""


class DriverHub:
    """A real hub; implements ``Hub``.

    Parameters
    ----------
    parameters : AxisParameters
        The axis.
    link : LinkParameters
        Its port.
    guard : BeamGuard, optional
        The beam on the axis, and how far it may be loaded.

    Raises
    ------
    HubConnectionError
        The port is not named, or its URL is of an unknown kind. A port that is missing, denied or lost is not raised:
        the state is then ``disconnected``, and the port is tried again until it comes back.
    """

    def __init__(
        self, parameters: AxisParameters, link: LinkParameters, *, guard: BeamGuard | None = None
    ) -> None:
        most_bytes = FLOOD_BYTES + FLOOD_BYTES_PER_TICK * 1_000_000_000 // parameters.period_ns
        self._client = HubClient(parameters, link, guard, checks_in_background=True)
        self._transport = SerialTransport(link.serial_port, link.serial_baud, most_bytes)
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._patient_until = time.monotonic() + link.patience_s
        self._was_open = self._is_calm = False
        self._tell_news: Callable[[], None] = lambda: None
        self._thread = threading.Thread(target=self._run, name="hub-serial", daemon=True)
        self._thread.start()

    @property
    def capabilities(self) -> HubCapabilities:
        """What the protocol promises."""
        return self._client.capabilities

    def request(self, kind: RequestKind) -> int:
        """Ask for a change of state; its number appears in ``HubReport.completed`` when it is over."""
        with self._lock:
            request_id = self._client.request(kind)
        self._transport.wake()
        return request_id

    def setpoint(self, stamp_ns: int, value: float, now: HostTime) -> Outcome:
        """Hand over one set-point in the command mode's unit, stamped [ns, UNIX] by who made it."""
        with self._lock:
            outcome = self._client.setpoint(stamp_ns, value, now)
        self._transport.wake()
        return outcome

    def load(self, chunk: SequenceChunk, now: HostTime) -> None:
        """Hand over one chunk of a sequence; what became of it appears in ``HubReport.sequences``."""
        with self._lock:
            self._client.load(chunk, now)
        self._transport.wake()

    def poll(self, now: HostTime) -> HubReport:
        """Say that the host is alive, and collect what happened."""
        with self._lock:
            return self._client.poll(now)

    def call_on_news(self, callback: Callable[[], None]) -> None:
        """Have a callback called, in the serial thread, when samples or answers wait for ``poll``."""
        self._tell_news = callback

    def close(self) -> None:
        """Stop the axis, wait until it rests, and let go of the port."""
        if self._ending.is_set():
            return
        with self._lock:
            self._client.begin_close()
        self._transport.wake()
        end = time.monotonic() + CLOSE_S
        while time.monotonic() < end:
            with self._lock:
                if self._client.is_closed:
                    break
            time.sleep(0.005)
        self._ending.set()
        self._transport.wake()
        self._thread.join(timeout=2.0)

    def _run(self) -> None:
        """Keep the line alive: the only place where the port is opened."""
        while not self._ending.is_set():
            try:
                if not self._transport.is_open:
                    self._open()
                self._talk()
            except HubConnectionError as err:
                self._give_up(err)
            except Exception as err:  # noqa: BLE001 - whatever it is, the axis must not lose its host for good
                text = f"the line was closed after {type(err).__name__}: {err}; expected no such error; report it"
                self._give_up(HubConnectionError(text, fault("port_lost")))
        try:
            if self._transport.is_open:
                with self._lock:
                    words = self._client.goodbye()
                self._transport.write(words)
        except HubConnectionError:
            return  # Nobody to say it to; the device's watchdog knows what to do.
        finally:
            self._transport.dispose()

    def _open(self) -> None:
        self._transport.open()
        self._was_open = True
        with self._lock:
            self._client.line_opened(time.monotonic_ns())

    def _give_up(self, err: HubConnectionError) -> None:
        """Close the port, say why where that is news, and wait before it is tried again."""
        is_missing = err.fault is fault("port_unavailable") and not isinstance(err, PortDeniedError)
        # A port that was lost and is not back yet is no second fault, one that is waited for not yet the first.
        is_news = not is_missing or not (self._was_open or time.monotonic() < self._patient_until)
        self._transport.close()
        if is_news:
            with self._lock:
                self._client.line_lost(err.fault, str(err))
        self._ending.wait(RECONNECT_S)

    def _talk(self) -> None:
        with self._lock:
            # Silence is judged by this time, too: what comes while the process is frozen after it is read first.
            now_ns = time.monotonic_ns()
            output = self._client.transmit(now_ns)
        self._transport.write(output)
        with self._lock:
            query = self._client.clock_query(time.monotonic_ns())
        self._transport.write(query)
        data, arrived_ns = self._transport.read(CALM_S if self._is_calm else BUSY_S)
        with self._lock:
            self._client.receive(data, arrived_ns)
            has_news, self._is_calm = self._client.has_news, self._client.is_calm(now_ns)
            is_silent = self._client.is_silent(now_ns)
        if has_news:
            self._tell_news()
        if is_silent:
            raise HubConnectionError(
                "the controller fell silent: expected samples every few milliseconds; check its power and cable",
                fault("controller_silent"),
            )
