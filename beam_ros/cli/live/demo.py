"""Run the whole experiment without hardware.

Separate processes over ROS 2, on a domain of their own that never leaves this machine: the rig is
simulated (or emulated behind a serial line), a chirp moves the hub, a camera films the beam, the tracker
measures the markers, everything is recorded to one bag, and the identifier fits a continuous-time model
whose natural frequencies and damping ratios are compared with the ones that the simulation was made from.

All this needs real time. Where this computer is too slow or too busy for it, the demo says so, tries again with a
longer start, and at last makes the same experiment with the simulator's core (`beam simulate`), so that there is a
report in any case. The exit status is 0 only if the nodes did it, and 1 if the core did.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from beam_ros.cli.options import add_rig_file, read_rig, run_folder
from beam_ros.interfaces.graph import RigKind
from beam_ros.process.executables import INTERRUPTED
from beam_ros.process.interruption import end_with, signals_taken
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.rig import Rig

BY_THE_CORE = 1
"""Exit status where the report is of the simulator's core, because the nodes could not do it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "--rig",
        choices=[RigKind.SIMULATED.value, RigKind.EMULATED.value],
        default=RigKind.SIMULATED.value,
        help="what stands in for the hardware: the simulator, or a motion controller on a pseudo-terminal",
    )
    add_rig_file(parser)
    parser.add_argument("--images", action="store_true", help="record the camera's frames too (30 MB/s)")
    parser.add_argument(
        "--out", type=Path, help="folder for bag, model and report (default: runs/<time>-demo-<rig>)"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON on stdout")


def by_the_core(rig: Rig, folder: Path) -> dict[str, Any]:
    """Make the experiment in the simulator's core, identify and report it: all of it but the nodes and real time."""
    from beam_ros.checks.bag_check import check_bag
    from beam_ros.offline.simulation import simulate
    from beam_ros.reporting.identification import identify_told

    with Progress("simulate", 1.0) as stage:
        count = simulate(
            rig, folder / "bag", on_progress=lambda done_s, total_s: stage.update(done_s / total_s)
        )
        stage.finish(f"{count} messages in {folder / 'bag'}")
    with Progress("identify", 1.0) as stage:
        result = identify_told(
            rig.identifier,
            progress=lambda phrase, share: stage.update(share, phrase),
            checked=lambda path, options: check_bag(path, None, options).looked,
        )
        stage.finish(f"{len(result['modes'])} modes from {', '.join(result['outputs'])}")
    return result


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    rig = read_rig(arguments)
    folder = run_folder(arguments.out, f"demo-{arguments.rig}")
    with signals_taken(end_with(INTERRUPTED)):
        from beam_ros.launching.demo import NOT_SHOWN, conduct_demo
        from beam_ros.offline.identification_summary import format_table
        from beam_ros.reporting.identification import format_files

    started = time.monotonic()
    kind = RigKind(arguments.rig)
    outcome = conduct_demo(rig, kind, folder, by_the_core, record_images=arguments.images)
    status = 0 if outcome.is_by_nodes else BY_THE_CORE
    result = outcome.result
    if arguments.json:
        made_by = "nodes" if outcome.is_by_nodes else "core"
        failures = [failure.reason for failure in outcome.failures]
        print(strict_json({**result, "made_by": made_by, "failed_attempts": failures}, indent=2))
        return status
    print(f"\n{format_table(result)}\n")
    for line in (*result["notes"], *result["warnings"]):
        print(f"note: {line}")
    print(f"{format_files(result)}\nbag      {result['bag']}")
    if not outcome.is_by_nodes:
        print(f"not shown: {NOT_SHOWN[kind]}")
    print(f"took     {time.monotonic() - started:.0f} s")
    return status
