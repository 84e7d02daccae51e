"""Frames a second that the node `tracker` takes from a topic, and how late its displacements are.

    python -m benchmarks.vision_node [--seconds S] [--sizes vga hd] [--rates HZ ...] [--transports shared small udp]
                                     [--best-effort] [--busy] [--json FILE]

Three real processes on a domain of their own that does not leave the machine: the tracker on one processor core, and
on the other a camera, which publishes rendered frames as ready-made CDR, and this process, which counts what comes
back. The transport `shared` is the shared memory that the suite's own cameras have (beam_ros.shell.large_messages),
`small` what Fast DDS gives a camera driver that has not been told, and `udp` the loopback with the usual buffers.

A rate of 0 sends as fast as the camera's process can. The latency runs from the frame's stamp, which the camera takes
as it hands the frame to DDS, to the moment at which the tracker hands its displacement to DDS. Processor times are
those that the kernel counts for a process with all its threads: the process that is busy for all of the time is the
limit, and frames over the tracker's processor time is what one core to itself would take. On a machine with other
work only the latter means something.

"waits" is the share of the time in which the tracker's thread was ready to run and its core was held by others, and
"stolen" the share that the machine below a virtual one took from that core: where their sum with the tracker's own
share comes near 100 %, the core is what frames are lost for. `--busy` keeps both cores busy with other programs.

Every row is measured once more with a process in the tracker's place that does nothing but subscribe to the frames as
bytes and answer each with its stamp: what this machine, its transport and the publishing side allow at all. The last
two columns are the tracker's rate and median latency over those of this bare subscriber.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros import messages
from beam_ros.interfaces.graph import TOPICS, QualityOfService
from beam_ros.launching.processes import PrivateDomain, stay_on_this_machine
from beam_ros.process.environment import child_environment
from beam_ros.process.executables import command
from beam_ros.rig.rig import Rig
from beam_ros.shell.large_messages import PROFILE_VARIABLE

SIZES = {
    "vga": {"camera.width": 640, "camera.height": 480},
    "hd": {
        "camera.width": 1920,
        "camera.height": 1080,
        "camera.pixels_per_metre": 3300.0,
        "camera.origin_u": 960.0,
        "camera.origin_v": 1050.0,
        "markers.diameter": 12.0 / 3300.0,
    },
}
RATES = {"vga": (100, 400, 600, 0), "hd": (50, 100, 150, 0)}
# No exposure: the stamps of a frame and of its displacements are then the same instant.
COMMON = {"camera.stamp": "start", "camera.exposure": 0.0}
TRANSPORTS = ("shared", "small", "udp")
LOOPBACK_UDP = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>loopback</transport_id>
      <type>UDPv4</type>
      <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="loopback only" is_default_profile="true">
    <rtps>
      <userTransports><transport_id>loopback</transport_id></userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
    </rtps>
  </participant>
</profiles>
"""
_CORES = tuple(sorted(os.sched_getaffinity(0)))
DISTINCT_FRAMES = 40
DEPTH = 5


@dataclass(frozen=True)
class Throughput:
    """One rate: frames sent and answered, latency and processor time.

    Attributes
    ----------
    asked_hz, sent_hz, answered_hz : float -- frames a second asked for (0: as many as go), sent, answered
    lost : int -- frames sent and not answered
    latency_ms : (float, float, float) -- median, 99th percentile and largest
    tracker_load, camera_load : float -- processor time per time, 1 is a core
    tracker_ms : float -- processor time of the tracker per frame that it answered [ms]
    core_hz : float -- frames a second that this makes on a core of its own
    waits, stolen : float -- share of the time in which the tracker was ready and others had its core, and in which a
        hypervisor did
    """

    size: str
    transport: str
    is_reliable: bool
    asked_hz: float
    sent_hz: float
    answered_hz: float
    lost: int
    latency_ms: tuple[float, float, float]
    tracker_load: float
    camera_load: float
    tracker_ms: float
    core_hz: float
    waits: float
    stolen: float
    is_bare: bool = False


def rig_of(size: str) -> Rig:
    """The packaged rig with a camera of this size."""
    return Rig.from_file().with_values({**COMMON, **SIZES[size]})


def frames_of(rig: Rig) -> list[bytes]:
    """Rendered frames as CDR, a moving beam, stamps left at zero."""
    from rclpy.serialization import serialize_message

    from beam_ros.vision.rendering.frames import SceneRenderer

    renderer = SceneRenderer(rig.camera_parameters(), rig.markers.heights)
    rng = np.random.default_rng(1)
    types = messages.RosTypes()
    frames = []
    for k in range(DISTINCT_FRAMES):
        x = 2e-3 * np.sin(2 * np.pi * k / DISTINCT_FRAMES + np.arange(3))
        frames.append(bytes(serialize_message(messages.image(types, 0, renderer.render(x, rng)))))
    return frames


def publish_frames(size: str, transport: str, rate: float, seconds: float, *, is_reliable: bool) -> None:
    """The camera's process: wait for the tracker, publish, say how it went."""
    import rclpy
    from rclpy.node import Node

    from beam_ros.shell.large_messages import widen_shared_memory
    from beam_ros.shell.node import qos_profile

    if transport == "shared":
        widen_shared_memory(os.environ)
    frames = frames_of(rig_of(size))
    rclpy.init(args=[])
    node = Node("camera")
    row = TOPICS["camera/image_raw"]
    publisher = node.create_publisher(
        messages.RosTypes().message_class(row.type_name),
        row.name,
        qos_profile(QualityOfService(DEPTH, is_reliable)),
    )
    deadline = time.monotonic() + 20.0
    while publisher.get_subscription_count() == 0:
        if time.monotonic() > deadline:
            raise SystemExit("the tracker did not subscribe within 20 s")
        time.sleep(0.05)
    time.sleep(1.0)

    def send(k: int) -> None:
        seconds_part, nanoseconds = divmod(time.time_ns(), messages.SECOND_NS)
        frame = frames[k % len(frames)]
        publisher.publish(frame[:4] + struct.pack("<iI", seconds_part, nanoseconds) + frame[12:])

    deadline = time.monotonic() + 20.0
    # Until the first answer has come back: who counts has found the tracker then, and the markers are found too.
    introduction = 0
    while introduction < 30 or not select.select([sys.stdin], [], [], 0.0)[0]:
        if time.monotonic() > deadline:
            raise SystemExit("no answer of the tracker came back within 20 s")
        send(introduction)
        introduction += 1
        time.sleep(0.02)
    cpu_before, start = time.process_time(), time.monotonic()
    count = 0
    first_ns = time.time_ns()
    while (now := time.monotonic()) - start < seconds:
        if rate and now - start < count / rate:
            time.sleep(max(0.0, count / rate - (now - start)))
            continue
        send(count)
        count += 1
    elapsed = time.monotonic() - start
    load = (time.process_time() - cpu_before) / elapsed
    print(json.dumps({"first_ns": first_ns, "count": count, "elapsed": elapsed, "load": load}), flush=True)
    time.sleep(1.0)
    node.destroy_node()
    rclpy.try_shutdown()


def answer_frames(*, is_reliable: bool) -> None:
    """The bare process in the tracker's place: answer every frame with its stamp, until it is interrupted."""
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.node import Node
    from rclpy.serialization import serialize_message

    from beam_ros.shell.frame_sources import WAITING_FRAMES
    from beam_ros.shell.node import qos_profile

    rclpy.init(args=[])
    node = Node("bare")
    types = messages.RosTypes()
    frames, answers = TOPICS["camera/image_raw"], TOPICS["beam/displacement"]
    publisher = node.create_publisher(
        types.message_class(answers.type_name), answers.name, qos_profile(answers.qos)
    )
    empty = bytes(serialize_message(types.message_class(answers.type_name)()))
    node.create_subscription(
        types.message_class(frames.type_name),
        frames.name,
        lambda data: publisher.publish(empty[:4] + bytes(data[4:12]) + empty[12:]),
        qos_profile(QualityOfService(WAITING_FRAMES, is_reliable)),
        raw=True,
    )
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


def processor_seconds(pid: int) -> float:
    """Processor time of a process with all its threads, to the nanosecond, unlike the ticks of /proc."""
    return time.clock_gettime((~pid << 3) | 2)  # what clock_getcpuclockid(3) returns on Linux


def _waited_seconds(pid: int) -> float:
    """Time in which a process's main thread was ready and did not run, as the kernel's scheduler counts it."""
    return int(Path(f"/proc/{pid}/task/{pid}/schedstat").read_text().split()[1]) * 1e-9


def _stolen_seconds(number: int) -> float:
    """Time that a hypervisor took from a core."""
    name = f"cpu{_CORES[number % len(_CORES)]} "
    row = next(line for line in Path("/proc/stat").read_text().splitlines() if line.startswith(name))
    return int(row.split()[8]) / os.sysconf("SC_CLK_TCK")


@contextmanager
def busy_cores(*, are_busy: bool) -> Iterator[None]:
    """Keep both cores busy with a program each that does nothing else."""
    programs = [
        subprocess.Popen([sys.executable, "-S", "-c", "while True: pass"], preexec_fn=_core(number))
        for number in (range(2) if are_busy else ())
    ]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def _core(number: int) -> Any:
    """Function for a child before exec that keeps it on one processor core."""
    return lambda: os.sched_setaffinity(0, {_CORES[number % len(_CORES)]})


class Answers:
    """Listens to `beam/displacement` as bytes: stamps and the times at which they were sent."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.node import Node

        from beam_ros.shell.node import qos_profile

        rclpy.init(args=[])
        self._node = Node("listener")
        row = TOPICS["beam/displacement"]
        self.seen: list[tuple[int, int]] = []
        self._node.create_subscription(
            messages.RosTypes().message_class(row.type_name),
            row.name,
            self._note,
            qos_profile(row.qos),
            raw=True,
        )

    def _note(self, data: bytes, info: dict[str, int]) -> None:
        seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
        self.seen.append((seconds * messages.SECOND_NS + nanoseconds, info["source_timestamp"]))

    def spin(self, seconds: float) -> None:
        """Listen for a while."""
        import rclpy

        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rclpy.spin_once(self._node, timeout_sec=0.01)

    def close(self) -> None:
        """Leave the graph."""
        import rclpy

        self._node.destroy_node()
        rclpy.try_shutdown()


def measure(
    answers: Answers,
    size: str,
    transport: str,
    rate: float,
    seconds: float,
    *,
    is_reliable: bool,
    is_bare: bool = False,
) -> Throughput:
    """One rate with fresh processes, of the tracker or of a bare subscriber in its place."""
    words = [f"{name}:={value}" for name, value in {**COMMON, **SIZES[size]}.items()]
    environment = child_environment({"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})
    with ExitStack() as stack, tempfile.TemporaryFile() as log:

        def start(arguments: Sequence[str], core: int, output: Any) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(
                arguments,
                cwd=Path(__file__).parents[1],
                env=environment,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=log,
                preexec_fn=_core(core),
            )
            stack.callback(process.wait, 15.0)
            stack.callback(process.send_signal, signal.SIGINT)
            return process

        reliability = [] if is_reliable else ["--best-effort"]
        node = [*command("vision_tracker"), "--ros-args", *[word for w in words for word in ("-p", w)]]
        bare = [sys.executable, "-m", "benchmarks.vision_node", "--bare", *reliability]
        tracker = start(bare if is_bare else node, 0, log)
        options = ["--camera", size, transport, str(rate), str(seconds), *reliability]
        camera = start([sys.executable, "-m", "benchmarks.vision_node", *options], 1, subprocess.PIPE)
        answers.seen.clear()
        limit = time.monotonic() + seconds + 60.0
        while not answers.seen and time.monotonic() < limit and camera.poll() is None:
            answers.spin(0.1)
        assert camera.stdin is not None
        camera.stdin.write(b"counting\n")
        camera.stdin.flush()
        answers.spin(0.6)
        before, begun = processor_seconds(tracker.pid), time.monotonic()
        waited, stolen = _waited_seconds(tracker.pid), _stolen_seconds(0)
        while camera.poll() is None and time.monotonic() - begun < seconds:
            answers.spin(0.05)
        elapsed = time.monotonic() - begun
        spent = (processor_seconds(tracker.pid) - before) / elapsed
        waited = (_waited_seconds(tracker.pid) - waited) / elapsed
        stolen = (_stolen_seconds(0) - stolen) / elapsed
        while camera.poll() is None and time.monotonic() < limit:
            answers.spin(0.1)
        assert camera.stdout is not None
        said = camera.stdout.read()
        if camera.poll() != 0 or not said:
            log.seek(0)
            raise SystemExit(f"the camera's process ended with {camera.poll()}:\n{log.read().decode()}")
    report = json.loads(said)
    answered = [(stamp, sent) for stamp, sent in answers.seen if stamp >= report["first_ns"]]
    latency = np.array([sent - stamp for stamp, sent in answered]) * 1e-6
    rate_answered = len(answered) / report["elapsed"]
    return Throughput(
        size,
        transport,
        is_reliable,
        rate,
        report["count"] / report["elapsed"],
        rate_answered,
        report["count"] - len(answered),
        tuple(float(np.round(value, 3)) for value in (*np.percentile(latency, (50, 99)), latency.max())),
        spent,
        report["load"],
        1e3 * spent / rate_answered,
        rate_answered / spent,
        waited,
        stolen,
        is_bare,
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Measure every rate and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--camera", nargs=4, metavar=("SIZE", "TRANSPORT", "HZ", "SECONDS"), help=argparse.SUPPRESS
    )
    parser.add_argument("--bare", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each rate")
    parser.add_argument("--sizes", nargs="+", default=list(SIZES), choices=SIZES)
    parser.add_argument("--rates", nargs="+", type=float, help="frames a second; 0: as many as go")
    parser.add_argument("--transports", nargs="+", default=["shared"], choices=TRANSPORTS)
    parser.add_argument("--best-effort", action="store_true")
    parser.add_argument("--busy", action="store_true", help="keep both cores busy with other programs")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(argv)
    if options.camera:
        size, transport, rate, seconds = options.camera
        publish_frames(size, transport, float(rate), float(seconds), is_reliable=not options.best_effort)
        return 0
    if options.bare:
        answer_frames(is_reliable=not options.best_effort)
        return 0
    results = []
    print(
        "size transport   asked     sent  answered  lost  latency ms: median    p99    max  tracker  camera"
        "  waits  stolen  ms/frame  a core  rate, latency over bare"
    )
    domain = PrivateDomain()
    for transport in options.transports:
        with tempfile.TemporaryDirectory() as folder:
            stay_on_this_machine(os.environ, domain.number, Path(folder))
            if transport == "udp":
                profile = Path(folder) / "loopback.xml"
                profile.write_text(LOOPBACK_UDP)
                os.environ[PROFILE_VARIABLE] = str(profile)
                os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
            answers = Answers()
            _core(1)()
            for size in options.sizes:
                for rate in options.rates or RATES[size]:
                    with busy_cores(are_busy=options.busy):
                        r, bare = (
                            measure(
                                answers,
                                size,
                                transport,
                                rate,
                                options.seconds,
                                is_reliable=not options.best_effort,
                                is_bare=is_bare,
                            )
                            for is_bare in (False, True)
                        )
                    results += [r, bare]
                    print(
                        f"{r.size:4} {r.transport:9} {r.asked_hz:7.0f}  {r.sent_hz:7.1f}  {r.answered_hz:8.1f}"
                        f"  {r.lost:4d}              {r.latency_ms[0]:6.2f} {r.latency_ms[1]:6.2f}"
                        f" {r.latency_ms[2]:6.2f}  {r.tracker_load:6.0%}  {r.camera_load:6.0%}"
                        f"  {r.waits:5.0%}  {r.stolen:6.0%}  {r.tracker_ms:8.2f}"
                        f"  {r.core_hz:6.0f}  {r.answered_hz / bare.answered_hz:5.2f}"
                        f" {r.latency_ms[0] / bare.latency_ms[0]:5.2f}",
                        flush=True,
                    )
            answers.close()
    domain.release()
    if options.json:
        options.json.write_text(json.dumps([asdict(result) for result in results], indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
