"""Cost of the hub's command gate: a set-point's check beside a tick, a sequence's check beside its length.

    python benchmarks/hub_gate.py [--json FILE] [--minutes 30]

Every set-point of a stream at 1 kHz is checked with the default rig's beam, in each command mode, while the samples
of the axis come in every 20 ms. The figures are shares of the time that passes meanwhile: 0.1 is a tenth of a
processor.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from beam_ros.hub.contract import SampleBatch
from beam_ros.hub.gate.command_gate import CommandGate
from beam_ros.hub.gate.sequence_assembly import SequenceAssembler
from beam_ros.hub.gate.sequence_check import SequenceCheck
from beam_ros.messages import split_sequence
from beam_ros.rig.rig import Rig

START_NS = 1_700_000_000_000_000_000
BATCH = 20


def setpoint_share(mode: str, seconds: float, *, with_beam: bool) -> float:
    """Return the processor's share that checking 1000 set-points a second takes."""
    rig = Rig.from_file().with_values({"hub.command_mode": mode})
    gate = CommandGate(rig.axis_parameters(), rig.beam_guard() if with_beam else None)
    still = np.zeros(BATCH)
    begin = time.process_time()
    for k in range(round(seconds * 1000)):
        now_ns = START_NS + k * 1_000_000
        gate.check_setpoint(now_ns, 1e-4 * np.sin(0.03 * k), now_ns, "enabled", 0.0, 0.0)
        if k % BATCH == 0:
            batch = SampleBatch(now_ns - BATCH * 1_000_000, 1_000_000, 1, still, still, still, still)
            gate.follow([(batch, batch)])
    return (time.process_time() - begin) / seconds


def sequence_share(minutes: float) -> tuple[float, float]:
    """Return a sequence's check over the sequence's length, and the memory that it takes over that of the samples."""
    rig = Rig.from_file()
    # The mean of a cosine over each tick: whole periods of it end at rest.
    values = 0.05 * np.cos(2 * np.pi * (np.arange(round(minutes * 60) * 1000) + 0.5) * 1e-3)
    chunks = split_sequence("s", START_NS, 1_000_000, values)
    assembler = SequenceAssembler(chunks[0], rig.axis_parameters())
    for chunk in chunks:
        assert assembler.add(chunk) is None
    check = SequenceCheck(assembler, rig.axis_parameters(), 0.0, rig.beam_guard().sequence)
    tracemalloc.start()
    begin = time.process_time()
    check.begin(in_background=False)
    spent = time.process_time() - begin
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert check.objection is None, check.objection
    return spent / (minutes * 60.0), peak / values.nbytes


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--minutes", type=float, default=30.0)
    arguments = parser.parse_args()
    figures = {}
    print("set-points at 1 kHz, share of a processor      without beam   with beam")
    for mode in ("acceleration", "velocity", "position", "effort"):
        shares = [setpoint_share(mode, 3.0, with_beam=with_beam) for with_beam in (False, True)]
        figures[f"{mode}_share"], figures[f"{mode}_beam_share"] = shares
        print(f"  {mode:40s} {shares[0]:14.3f} {shares[1]:11.3f}")
    share, memory = sequence_share(arguments.minutes)
    figures |= {"sequence_share": share, "sequence_memory": memory}
    print(f"a sequence of {arguments.minutes:g} minutes: checked in {share:.5f} of its length,")
    print(f"  with {memory:.3f} times its samples' memory on top")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
