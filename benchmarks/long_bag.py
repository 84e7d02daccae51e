"""Time and memory of ``beam info`` and ``beam identify`` on a long bag, and what an interruption leaves.

    python -m benchmarks.long_bag [--seconds 3600] [--rate 200] [--interrupt SECONDS] [--folder DIR] [--live]

The bag is one that a recorder makes: a hub at 1 kHz whose encoder counts 0.1 um, three markers at 200 frames a
second with 5 um of noise, clock comparisons every 100 ms.  Looking at it, reading it and identifying from it run
in processes of their own; times are processor seconds, memory is the peak of the process.  With --interrupt, SIGINT
is sent so many seconds after the start, and what the command then says and writes is shown.  With --live the estimate
that grows hears the bag instead, quicker than it was recorded, and says what it took of every stretch.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from beam_ros import messages
from beam_ros.bags.writing import BagWriter
from beam_ros.excitation.plan import plan_excitation
from beam_ros.hub.contract import ClockSync, SampleBatch
from beam_ros.messages import BagTypes
from beam_ros.offline.recorded_estimates import estimates_of_bag
from beam_ros.rig.rig import Rig
from benchmarks.ident_cost import filmed_record

_START_NS = 1_700_000_000_000_000_000
_TICK_NS, _BATCH, _FRAME_TICKS = 1_000_000, 20, 5
_KIB = 1024.0 if sys.platform != "darwin" else 1.0
_READ = (
    "import sys; from pathlib import Path; from beam_ros.offline.loading.experiment import load_experiment; "
)


def write_bag(path: Path, seconds: float, rate: int) -> None:
    """Write a bag of a rig that runs its excitation over and over."""
    every = round(1e9 / (_TICK_NS * _FRAME_TICKS)) // rate
    n_frames = round(seconds * 1e9 / (_TICK_NS * _FRAME_TICKS))
    record = filmed_record(n_frames, is_known=False)
    rig = Rig.from_file().with_texts([f"camera.rate:={rate}.0", "camera.exposure:=0.004"])
    types, hub = BagTypes(), record.inputs[0].values
    names = record.output_names
    seen = np.stack([output.values for output in record.outputs], axis=1)
    stamps = _START_NS + np.round(record.outputs[0].times_s * 1e9).astype(np.int64)
    frame = 0
    with BagWriter(path) as bag:
        info = plan_excitation(rig).info(rig)
        bag.write_message("excitation/info", _START_NS, messages.json_text(types, info))
        for first in range(0, len(hub), _BATCH):
            begun = _START_NS + first * _TICK_NS
            now = begun + _BATCH * _TICK_NS
            batch = SampleBatch(begun, _TICK_NS, 1, positions=hub[first : first + _BATCH])
            bag.write_batch("hub/measured", now, batch)
            if first % (5 * _BATCH) == 0:
                sync = ClockSync(now, now - _START_NS, 1, 0)
                bag.write_message("hub/clock_sync", now, messages.clock_sync(types, sync))
            while frame < len(stamps) and stamps[frame] < now:
                told = messages.displacement(types, int(stamps[frame]), names, seen[frame])
                bag.write_message("beam/displacement", now, told)
                frame += every


def measured(command: list[str], interrupt_s: float | None = None) -> tuple[float, float, int, str]:
    """Run a command and return processor seconds, peak memory [MB], exit status and what it printed."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if interrupt_s is not None:
        time.sleep(interrupt_s)
        process.send_signal(signal.SIGINT)
    assert process.stdout is not None
    said = process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    seconds, peak_mb = used.ru_utime + used.ru_stime, used.ru_maxrss * _KIB / 1e6
    return seconds, peak_mb, process.returncode, said


def hear(bag: Path, stretch_s: float = 60.0) -> None:
    """Let the growing estimate hear a bag; print what it takes of the processor and of memory, stretch by stretch."""
    begun, after_s = time.process_time(), 0.0
    for at_s, live in estimates_of_bag(bag, Rig.from_file().live):
        if at_s >= after_s + stretch_s:
            now, resident = time.process_time(), int(Path("/proc/self/statm").read_text().split()[1])
            print(
                f"{at_s:6.0f} s: {100.0 * (now - begun) / (at_s - after_s):5.1f} ms for 0.1 s, "
                f"{resident * os.sysconf('SC_PAGE_SIZE') / 1e6:5.0f} MB, {len(live.modes)} modes from "
                f"{live.record_s:.0f} s, the last fit took {live.cost.seconds_of_last_fit:.1f} s",
                flush=True,
            )
            begun, after_s = now, at_s


def main() -> None:
    """Write the bag, read it, identify from it."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.long_bag", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--seconds", type=float, default=3600.0, help="length of the bag [s]")
    parser.add_argument(
        "--interrupt", type=float, metavar="SECONDS", help="send SIGINT so long after the start"
    )
    parser.add_argument("--folder", type=Path, help="where the bag is made, or stands already")
    parser.add_argument("--rate", type=int, choices=(100, 200), default=200, help="frames a second")
    parser.add_argument(
        "--live", action="store_true", help="let the estimate that grows hear it, and no more"
    )
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        bag = folder / f"long_{arguments.seconds:g}_{arguments.rate}"
        if not bag.exists():
            write_bag(bag, arguments.seconds, arguments.rate)
        if arguments.live:
            hear(bag)
            return
        report = Path(temporary) / "report"
        beam = str(Path(sys.executable).with_name("beam"))
        info = [beam, "info", str(bag)]
        identify = [beam, "identify", str(bag), "--report", str(report)]
        read = [sys.executable, "-c", f"{_READ}load_experiment(Path(sys.argv[1]))", str(bag)]
        for name, command in (("info", info), ("read", read), ("identify", identify)):
            interrupt = arguments.interrupt if name == "identify" else None
            seconds, peak_mb, status, said = measured(command, interrupt)
            print(f"{name}: {seconds:.1f} s of processor time, {peak_mb:.0f} MB, exit status {status}")
            if status or name == "identify":
                print(said)


if __name__ == "__main__":
    main()
