"""Whether the node `hub` keeps its memory and its descriptors, however long it is connected.

    python -m benchmarks.hub_soak [--minutes M] [--kind KIND] [--json FILE]

Real processes on a domain of their own: the emulated controller on a pseudo-terminal, its driver, and this process,
which listens and commands. First the axis rests, connected and not enabled, which nothing ends and nothing clears;
then it runs one sequence after another. The slope of the memory is that of the straight line through what the kernel
says every few seconds, without the first fifth of the time, in which buffers fill; beside the driver stands a bare
rclpy publisher of as many messages to as many readers.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from beam_ros.launching.processes import PrivateDomain, stay_on_this_machine
from benchmarks.hub_driver import Desk, Pair, quiet_sequence

EVERY_S = 5.0
STARTING_S = 10.0
SEQUENCE_S = 30.0
FILLING = 0.2
"""Share of the time in which buffers fill."""
PHASES = ("at rest", "in sequences")


def held(pid: int) -> tuple[float, int]:
    """Return a process's memory [MB] and the number of its descriptors."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6, len(os.listdir(f"/proc/{pid}/fd"))


def watch(desk: Desk, pids: dict[str, int], minutes: float, *, moves: bool) -> dict[str, dict[str, float]]:
    """Return what became of memory and descriptors of some processes in the minutes that come."""
    samples: dict[str, list[tuple[float, float, int]]] = {name: [] for name in pids}
    n_ticks = n_moving = 0
    begun = time.monotonic()
    rested = begun
    while (now := time.monotonic()) < begun + 60.0 * minutes:
        if moves and now >= rested:
            # A busy computer may have lost the axis: the memory is looked at, and not that.
            for service in ("hub/clear_fault", "hub/home"):
                desk.call(service, must=False)
            desk.call("hub/enable", must=False, data=True)
            desk.send_sequence(quiet_sequence(SEQUENCE_S), 1.0)
            rested = now + SEQUENCE_S + 3.0
        desk.spin(EVERY_S)
        for batch in desk.applied:
            n_ticks += len(batch)
            n_moving += int(np.count_nonzero(batch.accelerations))
        desk.applied.clear()
        desk.lateness_ns.clear()
        for name, pid in pids.items():
            samples[name].append(((time.monotonic() - begun) / 60.0, *held(pid)))
    found = {}
    for name, rows in samples.items():
        times, memory, descriptors = np.array(rows).T
        kept = times >= FILLING * minutes
        slope, _ = np.polyfit(times[kept], memory[kept], 1)
        found[name] = {
            "minutes": float(times[-1]),
            "moving": n_moving / max(n_ticks, 1),
            "memory_mb": float(memory[-1]),
            "slope_mb_per_minute": float(slope),
            "fewest_descriptors": float(descriptors[kept].min()),
            "most_descriptors": float(descriptors[kept].max()),
        }
    return found


def main(argv: list[str] | None = None) -> None:
    """Watch, and print a line for each phase and process."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="of each phase")
    parser.add_argument("--kind", default="beam", help="axis.kind, with a serial line")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(argv)
    found = {}
    domain = PrivateDomain()
    with tempfile.TemporaryDirectory() as folder:
        stay_on_this_machine(os.environ, domain.number, Path(folder))
        desk = Desk()
        # An emulated axis may move without limits and watchdog of its own.
        accepted = [f"axis.accept_no_device_{what}:=true" for what in ("limits", "watchdog")]
        with Pair(shared=(f"axis.kind:={options.kind}", *accepted)) as rig:
            pids = {"driver": rig.driver.pid, "bare": rig.start_own("--bare", "objects").pid}
            desk.spin(STARTING_S)
            print("phase         process  minutes  in motion  memory [MB]  slope [MB/min]  descriptors")
            for phase in PHASES:
                found[phase] = watch(desk, pids, options.minutes, moves=phase != PHASES[0])
                for name, row in found[phase].items():
                    print(
                        f"{phase:12}  {name:7}  {row['minutes']:7.1f}  {row['moving']:9.0%}"
                        f"  {row['memory_mb']:11.1f}  {row['slope_mb_per_minute']:14.3f}"
                        f"  {row['fewest_descriptors']:.0f} to {row['most_descriptors']:.0f}",
                        flush=True,
                    )
        desk.close()
    domain.release()
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
