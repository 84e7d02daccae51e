"""What the node `hub` with hardware costs beside a bare rclpy publisher, how fast it can be, and how late it is.

    python -m benchmarks.hub_driver [--seconds S] [--rounds N] [--periods S ...] [--json FILE]

Real processes on a domain of their own that does not leave the machine: the emulated controller on a pseudo-terminal,
its driver, and this process, which commands and listens.

- *load*: processor time of the driver over time, 1 is a core, while telemetry flows and while a sequence is streamed
  besides. In the same seconds two bare nodes publish as many messages of the same kind and length from a timer, to as
  many readers: one ready-made bytes, which is the least that rclpy can do, the other messages made of Python objects.
- *rates*: shorter and shorter ticks of a device that carries a stiff load and is not filmed, which costs little. A
  rate is free of losses where every tick's sample arrives here.
- *latencies*: this process sits between driver and controller and notes when a frame passes. A set-point runs from
  its publication here to its frame on the line, a request from the call here to its frame and to its answer here, a
  sample from the end of its batch to its arrival here.

On a machine with other work only processor times, and their ratios to those of the bare nodes, mean something.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros import messages
from beam_ros.bags.batches import decode_batch, encode_batch
from beam_ros.hub.contract import ClockSync, SampleBatch
from beam_ros.hub.emulated.controller import EmulatedController
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.simulated.plant import RigidPlant
from beam_ros.interfaces.graph import SERVICES, TOPICS
from beam_ros.launching.processes import PrivateDomain, stay_on_this_machine
from beam_ros.process.environment import child_environment
from beam_ros.process.executables import command
from beam_ros.rig.rig import Rig
from benchmarks.vision_node import processor_seconds

BARE = ("bytes", "objects")
PERIODS = (0.001, 0.0005, 0.00025, 0.0002, 0.000125, 0.0001)
SETTLING_S = 4.0
"""Start, handshake, proof of the watchdog and the clock's fast phase are over after this time."""
PATIENT = ("hub.watchdog:=1.0",)
"""A busy computer is not what is measured."""


# The bare nodes -------------------------------------------------------------------------------------------


def publish_barely(kind: str) -> None:
    """Publish what the driver does at 1 kHz, from a timer, and do nothing else."""
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.node import Node
    from rclpy.serialization import serialize_message

    from beam_ros.shell.node import qos_profile

    rclpy.init(args=[])
    node = Node("bare", namespace=f"/{kind}")
    types = messages.RosTypes()
    publish = {
        name: node.create_publisher(
            types.message_class(TOPICS[name].type_name), name.lstrip("/"), qos_profile(TOPICS[name].qos)
        ).publish
        for name in ("hub/applied", "hub/measured", "hub/state", "hub/clock_sync", "/diagnostics")
    }
    parameters = AxisParameters()
    columns = np.random.default_rng(1).standard_normal((4, parameters.batch_ticks))
    sync = ClockSync(time.time_ns(), time.monotonic_ns(), 1, 100_000)
    counters = dict.fromkeys(map(str, range(12)), 1_000_000)

    def batches(stamp_ns: int) -> tuple[SampleBatch, SampleBatch]:
        a, x, v, f = columns
        period_ns = parameters.period_ns
        applied = SampleBatch(stamp_ns, period_ns, 1, accelerations=a)
        return applied, SampleBatch(stamp_ns, period_ns, 1, positions=x, velocities=v, efforts=f)

    def state(stamp_ns: int) -> Any:
        return messages.hub_state(types, messages.HubSample(stamp_ns, *map(float, columns[1:, -1])))

    def rare(stamp_ns: int) -> tuple[Any, Any]:
        health = messages.Health("bare", "OK", "running", "bare", counters)
        return messages.clock_sync(types, sync), messages.diagnostics(types, stamp_ns, [health])

    ready = [encode_batch(batch) for batch in batches(time.time_ns())]
    ready += [bytes(serialize_message(message)) for message in (state(0), *rare(0))]
    count = 0

    def publish_turn() -> None:
        nonlocal count
        count += 1
        now_ns = time.time_ns()
        if kind == "bytes":
            turn: list[Any] = ready
        else:
            turn = [messages.trajectory_batch(types, batch) for batch in batches(now_ns)] + [state(now_ns)]
            turn += rare(now_ns) if count % 10 == 0 else ()
        publish["hub/applied"](turn[0])
        publish["hub/measured"](turn[1])
        publish["hub/state"](turn[2])
        if count % 10 == 0:
            publish["hub/clock_sync"](turn[3])
        if count % 50 == 0:
            publish["/diagnostics"](turn[4])

    node.create_timer(1e-9 * parameters.batch_ns, publish_turn)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


def emulate_barely(port: str, period: float) -> None:
    """Be a controller with a stiff load and no camera, which costs little."""
    parameters = Rig.from_file().with_values({"hub.period": period, "hub.watchdog": 1.0}).axis_parameters()
    controller = EmulatedController(parameters, RigidPlant(0.8, parameters.period), link=port)
    try:
        signal.pause()
    except KeyboardInterrupt:
        controller.close()


# What commands and listens --------------------------------------------------------------------------------


class Desk:
    """Commands and listens on the graph, for this process."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.node import Node

        rclpy.init(args=[])
        self._spin_once = rclpy.spin_once
        self._node = Node("desk")
        self._types = messages.RosTypes()
        self.applied: list[SampleBatch] = []
        self.lateness_ns: list[int] = []
        self.counters: dict[str, Any] = {}
        for space in ("", *(f"/{kind}/" for kind in BARE)):
            self._listen("hub/applied", self._note_batch if not space else lambda _: None, space)
            for name in ("hub/measured", "hub/state", "hub/clock_sync"):
                self._listen(name, lambda _: None, space)
            self._listen("/diagnostics" if not space else "diagnostics", self._note_health, space)
        self._setpoint = self._publisher("hub/setpoint")
        self._sequence = self._publisher("hub/sequence")

    def _listen(self, topic: str, callback: Callable[[bytes], None], space: str) -> None:
        from beam_ros.shell.node import qos_profile

        row = TOPICS["/diagnostics" if topic == "diagnostics" else topic]
        kind = self._types.message_class(row.type_name)
        self._node.create_subscription(kind, space + topic, callback, qos_profile(row.qos), raw=True)

    def _publisher(self, topic: str) -> Any:
        from beam_ros.shell.node import qos_profile

        row = TOPICS[topic]
        return self._node.create_publisher(
            self._types.message_class(row.type_name), topic, qos_profile(row.qos)
        )

    def _note_batch(self, data: bytes) -> None:
        batch = decode_batch(data)
        self.lateness_ns.append(time.time_ns() - batch.stamp_ns - len(batch) * batch.period_ns)
        self.applied.append(batch)

    def _note_health(self, data: bytes) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.serialization import deserialize_message

        for health in messages.read_diagnostics(deserialize_message(data, DiagnosticArray)):
            if health.name.endswith("hub_driver"):
                self.counters = dict(health.values)

    def spin(self, seconds: float) -> None:
        """Listen for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._spin_once(self._node, timeout_sec=0.01)

    def wait(self, condition: Callable[[], bool], what: str, timeout_s: float = 30.0) -> None:
        """Listen until something holds."""
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end:
                raise SystemExit(f"{what} did not come within {timeout_s:g} s")
            self._spin_once(self._node, timeout_sec=0.01)

    def call(self, service: str, *, must: bool = True, **fields: object) -> tuple[int, int]:
        """Call a service that ``must`` succeed; return when it was called and when it was answered [ns]."""
        kind = self._types.service_class(SERVICES[service].type_name)
        client = self._node.create_client(kind, service)
        self.wait(client.service_is_ready, service)
        begun_ns = time.monotonic_ns()
        future = client.call_async(kind.Request(**fields))
        self.wait(future.done, f"an answer of {service}")
        ended_ns = time.monotonic_ns()
        self._node.destroy_client(client)
        if must and not future.result().success:
            raise SystemExit(f"{service}: {future.result().message}")
        return begun_ns, ended_ns

    def set_point(self, value: float) -> int:
        """Publish a set-point; return when [ns]."""
        point = messages.StampedSetpoint(time.time_ns(), "acceleration", value)
        message = messages.setpoint(self._types, point)
        begun_ns = time.monotonic_ns()
        self._setpoint.publish(message)
        return begun_ns

    def send_sequence(self, values: np.ndarray, lead_s: float) -> None:
        """Send a sequence for the default tick."""
        self.wait(lambda: self._sequence.get_subscription_count() > 0, "a hub that listens")
        start_ns = time.time_ns() + round(lead_s * 1e9)
        for chunk in messages.split_sequence("load", start_ns, AxisParameters().period_ns, values):
            self._sequence.publish(messages.sequence_chunk(self._types, chunk, "acceleration"))

    def ready(self) -> None:
        """Wait for telemetry of a freshly started hub, and until its start is over."""
        self.spin(1.0)  # What an earlier hub said last.
        self.applied.clear()
        self.wait(lambda: bool(self.applied), "telemetry")
        self.spin(SETTLING_S)

    def close(self) -> None:
        """Leave the graph."""
        import rclpy

        self._node.destroy_node()
        rclpy.try_shutdown()


class Tap(threading.Thread):
    """Sits between driver and controller, hands everything on, and notes when commands pass.

    Attributes
    ----------
    port : str
        For the driver.
    setpoints : dict of float to int
        When a value passed first [ns].
    requests : list of int
        When each new request passed first [ns].
    """

    def __init__(self, device: str) -> None:
        super().__init__(daemon=True)
        self._driver, self._slave = os.openpty()
        self._device = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        for end in (self._slave, self._device):
            tty.setraw(end)
        self.port = os.ttyname(self._slave)
        self.setpoints: dict[float, int] = {}
        self.requests: list[int] = []
        self._numbers: set[int] = set()
        self._decoder = FrameDecoder()
        self._is_ending = False

    def run(self) -> None:
        """Hand on."""
        while not self._is_ending:
            ready, _, _ = select.select([self._driver, self._device], [], [], 0.1)
            now_ns = time.monotonic_ns()
            if self._driver in ready:
                data = os.read(self._driver, 65536)
                os.write(self._device, data)
                self._note(data, now_ns)
            if self._device in ready:
                os.write(self._driver, os.read(self._device, 65536))

    def close(self) -> None:
        """End."""
        self._is_ending = True
        self.join()
        for end in (self._driver, self._slave, self._device):
            os.close(end)

    def _note(self, data: bytes, now_ns: int) -> None:
        for message in map(protocol.decode, self._decoder.feed(data)):
            if isinstance(message, protocol.Setpoint):
                self.setpoints.setdefault(message.value, now_ns)
            elif isinstance(message, protocol.Request) and message.number not in self._numbers:
                self._numbers.add(message.number)
                self.requests.append(now_ns)


class Pair(ExitStack):
    """Controller and driver as processes, ended together with whatever else was started.

    Parameters
    ----------
    bare_period : float, optional
        Tick [s] of a controller without beam and camera; by default the rig's own, with both.
    taps : bool, optional
        This process sits between the two.
    shared : sequence of str, optional
        Parameters of both.
    """

    def __init__(
        self, bare_period: float | None = None, *, taps: bool = False, shared: Sequence[str] = ()
    ) -> None:
        super().__init__()
        folder = Path(self.enter_context(tempfile.TemporaryDirectory()))
        port = folder / "controller"
        parameters = () if bare_period is None else (f"hub.period:={bare_period}",)
        if bare_period is None:
            self.emulator = self.start_node("firmware_emulator", f"emulator.port_link:={port}", *shared)
        else:
            self.emulator = self.start_own("--device", str(port), str(bare_period))
        end = time.monotonic() + 30.0
        while not port.exists():
            if time.monotonic() > end or self.emulator.poll() is not None:
                raise SystemExit("the emulated controller did not start")
            time.sleep(0.05)
        self.tap = Tap(str(port)) if taps else None
        if self.tap is not None:
            self.tap.start()
            self.callback(self.tap.close)
        name = str(port) if self.tap is None else self.tap.port
        self.driver = self.start_node("hub_driver", f"serial.port:={name}", *parameters, *shared)

    def start_node(self, executable: str, *parameters: str) -> subprocess.Popen[bytes]:
        """Start one of the suite's nodes."""
        given = [word for parameter in (*PATIENT, *parameters) for word in ("-p", parameter)]
        return self.start([*command(executable), "--ros-args", *given])

    def start_own(self, *words: str) -> subprocess.Popen[bytes]:
        """Start a part of this module."""
        return self.start([sys.executable, "-m", "benchmarks.hub_driver", *words])

    def start(self, words: Sequence[str]) -> subprocess.Popen[bytes]:
        """Start a process."""
        process = subprocess.Popen(
            words,
            cwd=Path(__file__).parents[1],
            env=child_environment({"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}),
            stdin=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self.callback(process.wait, 15.0)
        self.callback(process.send_signal, signal.SIGINT)
        return process


def loads(desk: Desk, processes: Sequence[subprocess.Popen[bytes]], seconds: float) -> list[float]:
    """Return the processes' processor time over time [cores] in the seconds that come."""
    before = [processor_seconds(process.pid) for process in processes]
    begun = time.monotonic()
    desk.spin(seconds)
    elapsed = time.monotonic() - begun
    return [
        (processor_seconds(process.pid) - spent) / elapsed
        for process, spent in zip(processes, before, strict=True)
    ]


def quiet_sequence(seconds: float) -> np.ndarray:
    """Accelerations [m/s^2] of a small move of 3 Hz that begins and ends at rest."""
    period = AxisParameters().period
    times = np.arange(0.0, seconds + 2 * period, period)
    way = np.sin(np.pi * times / times[-1]) ** 4 * np.sin(2 * np.pi * 3.0 * times)
    accelerations = np.diff(way, n=2)
    return np.asarray(0.2 * accelerations / np.max(np.abs(accelerations)))


# What is measured -----------------------------------------------------------------------------------------


def measure_load(desk: Desk, seconds: float) -> dict[str, list[float]]:
    """Return loads [cores] of driver and bare nodes: while telemetry flows, and in a sequence."""
    found = {}
    with Pair() as rig:
        processes = [rig.driver, *(rig.start_own("--bare", kind) for kind in BARE)]
        desk.ready()
        found["telemetry"] = loads(desk, processes, seconds)
        desk.call("hub/home")
        desk.call("hub/enable", data=True)
        desk.send_sequence(quiet_sequence(seconds + 1.0), 1.0)
        desk.spin(1.5)
        found["sequence"] = loads(desk, processes, seconds)
    return found


def measure_rate(desk: Desk, period: float, seconds: float) -> dict[str, float]:
    """Return what arrived here at a tick of the device, and what was lost on the way."""
    with Pair(period) as rig:
        desk.ready()
        before = dict(desk.counters)
        desk.applied.clear()
        driver, emulator = loads(desk, [rig.driver, rig.emulator], seconds)
        batches = list(desk.applied)
        desk.spin(1.2)
    stamps = np.array([batch.stamp_ns for batch in batches])
    ends = np.array([batch.stamp_ns + len(batch) * batch.period_ns for batch in batches])
    period_ns = round(period * 1e9)
    missing = np.maximum(np.round((stamps[1:] - ends[:-1]) / period_ns), 0.0)
    # The proof of the watchdog at the start costs ticks by design.
    counted = {
        name: int(desk.counters.get(name, 0)) - int(before.get(name, 0))
        for name in ("lost_ticks", "bad_frames")
    }
    arrived = sum(map(len, batches)) / (1e-9 * (ends[-1] - stamps[0]))
    return {
        "rate": 1.0 / period,
        "arrived": arrived,
        "missing": float(missing.sum()),
        **counted,
        "driver": driver,
        "emulator": emulator,
    }


def measure_latencies(desk: Desk, seconds: float) -> dict[str, list[float]]:
    """Return least, median, 99th percentile and largest of each latency [ms]."""
    with Pair(taps=True) as rig:
        assert rig.tap is not None
        desk.ready()
        desk.call("hub/home")
        desk.call("hub/enable", data=True)
        desk.lateness_ns.clear()
        published: dict[float, int] = {}
        for k in range(round(seconds / 0.05)):
            value = (1e-3 + 1e-7 * k) * (-1) ** k
            published[value] = desk.set_point(value)
            desk.spin(0.05)
        asked, answered = [], []
        rig.tap.requests.clear()
        for k in range(round(seconds / 0.1)):
            begun_ns, ended_ns = desk.call("hub/enable", data=bool(k % 2))
            asked.append(begun_ns)
            answered.append(ended_ns)
        passed = dict(rig.tap.setpoints)
        framed = list(rig.tap.requests)
    latencies = {
        "set-point published -> frame at the device": [
            passed[v] - ns for v, ns in published.items() if v in passed
        ],
        "service called -> frame at the device": [f - ns for f, ns in zip(framed, asked, strict=True)],
        "service called -> answer": [e - ns for e, ns in zip(answered, asked, strict=True)],
        "end of a batch -> sample here": desk.lateness_ns,
    }
    return {
        name: [float(x) * 1e-6 for x in np.percentile(ns, (0, 50, 99, 100))] for name, ns in latencies.items()
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--device", nargs=2, metavar=("PORT", "S"), help=argparse.SUPPRESS)
    parser.add_argument("--bare", choices=BARE, help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    parser.add_argument("--rounds", type=int, default=3, help="of the load")
    parser.add_argument("--periods", nargs="*", type=float, default=PERIODS, help="of the device [s]")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(argv)
    if options.device:
        emulate_barely(options.device[0], float(options.device[1]))
        return 0
    if options.bare:
        publish_barely(options.bare)
        return 0
    domain = PrivateDomain()
    with tempfile.TemporaryDirectory() as folder:
        stay_on_this_machine(os.environ, domain.number, Path(folder))
        desk = Desk()
        found: dict[str, Any] = {"load": [], "rates": []}
        print("load of a core          driver   bare, bytes   bare, objects   driver/bytes  driver/objects")
        for _ in range(options.rounds):
            found["load"].append(measure_load(desk, options.seconds))
            for name, (driver, raw, objects) in found["load"][-1].items():
                print(
                    f"{name:22} {driver:7.1%}  {raw:11.1%}  {objects:13.1%}   {driver / raw:12.2f}"
                    f"  {driver / objects:14.2f}",
                    flush=True,
                )
        print("ticks a second  arrived  missing here  lost on the line  bad frames  driver  emulator")
        for period in options.periods:
            row = measure_rate(desk, period, options.seconds)
            found["rates"].append(row)
            print(
                f"{row['rate']:14.0f}  {row['arrived']:7.0f}  {row['missing']:12.0f}  {row['lost_ticks']:16.0f}"
                f"  {row['bad_frames']:10.0f}  {row['driver']:6.0%}  {row['emulator']:8.0%}",
                flush=True,
            )
        found["latencies"] = measure_latencies(desk, options.seconds)
        print("latencies [ms]                                 least    median      99 %   largest")
        for name, latencies in found["latencies"].items():
            print(f"{name:42} " + " ".join(f"{latency:9.2f}" for latency in latencies))
        desk.close()
    domain.release()
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
