"""Hubs, moves and host clocks that the tests of this room share."""

from __future__ import annotations

import dataclasses
import random
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from beam_ros.hub.contract import HostTime, Hub, HubReport, Outcome, RequestKind, SequenceChunk
from beam_ros.hub.emulated.controller import DelayingFirmware, EmulatedController, Firmware
from beam_ros.hub.emulated.emulator import EmulatedFirmware
from beam_ros.hub.errors import HubConnectionError
from beam_ros.hub.faults import fault
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.line import protocol
from beam_ros.hub.line.client import HubClient
from beam_ros.hub.line.driver import DriverHub
from beam_ros.hub.line.framing import FrameDecoder, encode_frame
from beam_ros.hub.links.host_paced_hub import HostPacedHub
from beam_ros.hub.links.query_line import SteadyTime
from beam_ros.hub.parameters import AxisParameters, LinkParameters, SimulatedDevice
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.plant import RigidPlant
from beam_ros.hub.simulated.simulated_hub import SimulatedHub

Change = Callable[[protocol.Message], "protocol.Message | bytes | None"]

UNIX_START = 1_700_000_000_000_000_000
STEADY_START = 5_000_000_000
DRIFTING = SimulatedDevice(clock_drift_ppm=35.0, clock_start_ns=777_000_000_000)


def rest_to_rest(n_ticks: int, amplitude: float = 0.5) -> np.ndarray:
    """Accelerations of a move that ends at rest (second differences of a position that does)."""
    s = np.arange(n_ticks + 2) / (n_ticks + 1)
    a = np.diff(np.sin(np.pi * s) ** 4 * np.sin(4 * np.pi * s), n=2)
    return a * (amplitude / np.max(np.abs(a)))


def chunks_of(
    values: np.ndarray,
    start_ns: int,
    sequence_id: str = "move",
    size: int = 500,
    period_ns: int = 1_000_000,
) -> list[SequenceChunk]:
    count = -(-len(values) // size)
    return [
        SequenceChunk(
            sequence_id, k + 1, count, start_ns, period_ns, k * size, values[k * size : (k + 1) * size]
        )
        for k in range(count)
    ]


def altered(change: Change) -> Callable[[bytes], bytes]:
    """Return a line on which every message is changed, replaced by a payload, or dropped."""

    def line(data: bytes) -> bytes:
        out = b""
        for payload in FrameDecoder().feed(data):
            changed = change(protocol.decode(payload))
            if isinstance(changed, bytes):
                out += encode_frame(changed)
            elif changed is not None:
                out += protocol.encode(changed)
        return out

    return line


def only(kind: type, change: Change) -> Callable[[bytes], bytes]:
    return altered(lambda message: change(message) if isinstance(message, kind) else message)


def frozen() -> Change:
    stuck: list[np.ndarray] = []

    def change(message: protocol.Telemetry) -> protocol.Telemetry:
        ticks = message.ticks
        stuck.append(ticks.position_counts)
        return protocol.Telemetry(
            dataclasses.replace(ticks, position_counts=np.full(len(ticks), stuck[0][0], dtype=np.int64))
        )

    return change


def enabled_axis(parameters: AxisParameters, plant: object = None, **options: int) -> VirtualAxis:
    axis = VirtualAxis(parameters, plant or RigidPlant(0.8, parameters.period), **options)
    axis.request(1, "home")
    while axis.state != "homed":
        axis.feed()
        axis.advance(axis.device_ns + 10_000_000)
    axis.request(2, "enable")
    axis.take_completed()
    axis.take_events()
    assert axis.state == "enabled"
    return axis


class Rig:
    """A hub and the host that polls it."""

    hub: Hub
    reports: list[HubReport]

    @property
    def now(self) -> HostTime:
        """Given by the scene's own kind of time."""

    def run(self, seconds: float) -> list[HubReport]:
        """Given by the scene's own kind of time."""

    def ask(self, kind: RequestKind, timeout_s: float = 15.0) -> Outcome:
        """Make a request and return how it ended."""
        request_id = self.hub.request(kind)
        for _ in range(round(timeout_s * 100)):
            completed = {number: outcome for r in self.run(0.01) for number, outcome in r.completed}
            if request_id in completed:
                return completed[request_id]
        raise AssertionError(f"{kind} did not end")

    def enable(self) -> None:
        for kind in ("home", "enable"):
            outcome = self.ask(kind)
            assert outcome.success, outcome.message

    def until(self, condition: Callable[[HubReport], bool], timeout_s: float = 15.0) -> list[HubReport]:
        """Poll until a report fulfils a condition; return all reports until then."""
        new: list[HubReport] = []
        for _ in range(round(timeout_s * 100)):
            new += self.run(0.01)
            if condition(new[-1]):
                return new
        sequences = [s for r in new for s in r.sequences]
        events = [e.text for r in new for e in r.events]
        raise AssertionError(f"not within {timeout_s} s: {new[-1].status} {sequences} {events}")


class SimulatedRig(Rig):
    """A simulated hub with a host clock that the test moves."""

    def __init__(
        self,
        parameters: AxisParameters,
        plant: object = None,
        device: SimulatedDevice | None = None,
        **options: object,
    ) -> None:
        load = plant or RigidPlant(0.8, parameters.period)
        self.hub = SimulatedHub(VirtualAxis(parameters, load, device), **options)
        self.steady_ns = STEADY_START
        self.reports = []
        self.hub.poll(self.now)

    @property
    def now(self) -> HostTime:
        return HostTime(self.steady_ns, self.steady_ns - STEADY_START + UNIX_START)

    def run(self, seconds: float, step_ns: int = 10_000_000) -> list[HubReport]:
        end = self.steady_ns + round(seconds * 1e9)
        new = []
        while self.steady_ns < end:
            self.steady_ns += min(step_ns, end - self.steady_ns)
            new.append(self.hub.poll(self.now))
        self.reports += new
        return new


class LoopbackRig(Rig):
    """The driver's client and the emulated firmware on a line without a port, in virtual time.

    `to_device` and `to_host` may change what the line carries: bytes in, bytes out.
    """

    STEP_NS = 1_000_000

    def __init__(
        self,
        parameters: AxisParameters,
        device: SimulatedDevice = DRIFTING,
        device_parameters: AxisParameters | None = None,
        link: LinkParameters | None = None,
    ) -> None:
        self.parameters = parameters
        self.device = device
        self.device_parameters = device_parameters or parameters
        self.plant = RigidPlant(0.8, parameters.period)
        self.hub = self.client = HubClient(parameters, link or LinkParameters())
        self.steady_ns = STEADY_START
        self.reports = []
        self.to_device: Callable[[bytes], bytes] = lambda data: data
        self.to_host: Callable[[bytes], bytes] = lambda data: data
        self.is_polled = True
        self.rng = random.Random(1)
        self.start_device(1)
        self.client.line_opened(self.steady_ns)

    def start_device(self, boot_id: int) -> None:
        self.firmware = EmulatedFirmware(self.device_parameters, self.plant, self.device, boot_id=boot_id)
        self.boot_ns = self.steady_ns

    @property
    def now(self) -> HostTime:
        return HostTime(self.steady_ns, self.steady_ns - STEADY_START + UNIX_START)

    def device_ns(self, steady_ns: int) -> int:
        rate = 1 + self.device.clock_drift_ppm * 1e-6
        return self.device.clock_start_ns + round((steady_ns - self.boot_ns) * rate)

    def run(self, seconds: float) -> list[HubReport]:
        new = []
        steps = round(seconds * 1e9) // self.STEP_NS
        for k in range(steps):
            out = self.client.transmit(self.steady_ns) + self.client.clock_query(self.steady_ns)
            there = self.steady_ns + 50_000 + self.rng.randint(0, 100_000)
            back = there + 50_000 + self.rng.randint(0, 100_000)
            answer = self.firmware.exchange(self.to_device(out), self.device_ns(there))
            self.client.receive(self.to_host(answer), back)
            self.steady_ns += self.STEP_NS
            if self.client.is_silent(self.steady_ns):
                self.client.line_lost(fault("controller_silent"), "silence")
                self.client.line_opened(self.steady_ns)
            if self.is_polled and (k + 1) % 10 == 0:
                new.append(self.client.poll(self.now))
        self.reports += new
        return new

    def connect(self) -> None:
        self.until(lambda r: r.status.state != "disconnected")
        self.until(lambda r: bool(r.measured) and r.status.counters["clock_sd_ns"] < 20_000)


class VirtualTime(SteadyTime):
    """Time that passes where somebody waits."""

    def __init__(self) -> None:
        super().__init__()
        self.ns = STEADY_START

    def now_ns(self) -> int:
        return self.ns

    def wait(self, seconds: float) -> None:
        self.ns += round(seconds * 1e9)


class VirtualPort:
    """A port whose bytes take their time, with an emulated device at its end.

    ``latency_ns`` is that of the adapter: it hands over what has come only at multiples of it.
    """

    def __init__(self, steady: VirtualTime, firmware: Firmware, device: SimulatedDevice) -> None:
        self.steady, self.firmware, self._device = steady, firmware, device
        self.is_open, self.is_plugged = False, True
        self.latency_ns = 0
        self.written: list[bytes] = []
        self._rng = random.Random(1)
        self._coming: list[tuple[int, bytes]] = []

    def open(self) -> None:
        if not self.is_plugged:
            raise HubConnectionError("no such port")
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def device_ns(self, steady_ns: int) -> int:
        rate = 1.0 + self._device.clock_drift_ppm * 1e-6
        return self._device.clock_start_ns + round((steady_ns - STEADY_START) * rate)

    def write(self, data: bytes) -> None:
        self._check()
        self.written.append(data)
        self.steady.ns += self._rng.randint(20_000, 60_000)
        self._pass(data)

    def read(self, timeout_s: float) -> tuple[bytes, int]:
        self._check()
        end_ns = self.steady.ns + round(timeout_s * 1e9)
        self._pass(b"")
        while not self._coming and self.steady.ns < end_ns:
            self.steady.ns = min(end_ns, self.steady.ns + 250_000)
            self._pass(b"")
        came_ns = self._coming[0][0] if self._coming else end_ns + 1
        self.steady.ns = max(self.steady.ns, min(came_ns, end_ns))
        return (self._coming.pop(0)[1] if came_ns <= end_ns else b""), self.steady.ns

    def inject(self, data: bytes) -> None:
        self._coming.append((self.steady.ns, data))

    def _check(self) -> None:
        if not self.is_plugged:
            raise HubConnectionError("the port vanished", fault("port_lost"))

    def _pass(self, data: bytes) -> None:
        now_ns, device = self.steady.ns, self.firmware
        out = device.exchange(data, self.device_ns(now_ns))
        if isinstance(device, DelayingFirmware) and device.due_ns is not None:
            now_ns += device.due_ns - self.device_ns(now_ns)
            out += device.exchange(b"", device.due_ns)
        if out:
            now_ns += self._rng.randint(20_000, 60_000)
            if self.latency_ns:
                now_ns += -now_ns % self.latency_ns
            self._coming.append((now_ns, out))


class PacedRig(Rig):
    """A hub that the host leads, in virtual time; whoever polls does it every 10 ms, and after what took longer."""

    POLL_NS = 10_000_000

    def __init__(self, hub: HostPacedHub, steady: VirtualTime) -> None:
        self.hub, self.steady = hub, steady
        self.reports = []
        self.is_polled = True
        self._polled_ns = 0

    @property
    def now(self) -> HostTime:
        return HostTime(self.steady.ns, self.steady.ns - STEADY_START + UNIX_START)

    def turn(self) -> None:
        """Let the hub do what is due."""
        self.hub.turn()

    def run(self, seconds: float) -> list[HubReport]:
        end_ns = self.steady.ns + round(seconds * 1e9)
        new = []
        while self.steady.ns < end_ns or (self.is_polled and not new):
            self.turn()
            if self.is_polled and self.steady.ns - self._polled_ns >= self.POLL_NS:
                self._polled_ns = self.steady.ns
                new.append(self.hub.poll(self.now))
        self.reports += new
        return new

    def connected(self) -> PacedRig:
        self.until(lambda r: r.status.state == "identified")
        return self

    def drive(self, value: float, seconds: float) -> None:
        end_ns = self.steady.ns + round(seconds * 1e9)
        while self.steady.ns < end_ns:
            assert self.hub.setpoint(self.now.unix_ns, value, self.now).success
            self.run(0.05)

    def clear(self) -> None:
        # The cause is gone a quarter of a second after it was seen last.
        self.run(0.4)
        outcome = self.ask("clear_fault")
        assert outcome.success, outcome.message

    def events(self, words: str) -> list[str]:
        return [e.text for r in self.reports for e in r.events if words in e.text]


class LiveRig(Rig):
    """A hub in real time, polled every 10 ms."""

    def __init__(self, hub: Hub) -> None:
        self.hub = hub
        self.reports = []

    @property
    def now(self) -> HostTime:
        return HostTime(time.monotonic_ns(), time.time_ns())

    def until(self, condition: Callable[[HubReport], bool], timeout_s: float = 60.0) -> list[HubReport]:
        """Poll until a report fulfils a condition; the limit only ends what hangs."""
        return super().until(condition, timeout_s)

    def run(self, seconds: float) -> list[HubReport]:
        end = time.monotonic() + seconds
        new = []
        while not new or time.monotonic() < end:
            time.sleep(0.01)
            new.append(self.hub.poll(self.now))
        self.reports += new
        return new


def busy_link(port: str, **options: object) -> LinkParameters:
    """Return a link on a computer that may be busy: its sequences start to half a tick, not to 50 us."""
    return LinkParameters(port, max_clock_sd_ns=500_000, **options)


class PortRig(LiveRig):
    """The driver on a port."""

    def __init__(
        self, parameters: AxisParameters, link: LinkParameters, guard: BeamGuard | None = None
    ) -> None:
        super().__init__(DriverHub(parameters, link, guard=guard))

    def connect(self) -> None:
        # These limits only end what hangs.
        self.until(lambda r: r.status.state != "disconnected", 30.0)
        self.until(lambda r: bool(r.measured), 60.0)


class DriverRig(PortRig):
    """The driver with the emulated controller on a pseudo-terminal."""

    def __init__(
        self,
        parameters: AxisParameters,
        folder: Path,
        plant: object = None,
        device: SimulatedDevice = DRIFTING,
        guard: BeamGuard | None = None,
        **options: object,
    ) -> None:
        load = plant or RigidPlant(0.8, parameters.period)
        self.emulator = EmulatedController(parameters, load, device, link=folder / "hub", **options)
        super().__init__(parameters, busy_link(self.emulator.port), guard)

    def close(self) -> None:
        self.hub.close()
        self.emulator.close()
