"""Time of ideal cases in one checkout of this project against another, in turns on one machine.

    python -m benchmarks.paired OTHER [--rounds N] [--tasks TASK ...] [--sizes N ...]

OTHER is the folder of another checkout, as of ``git worktree add --detach OTHER COMMIT``.  Both run in this
environment, one after the other in processes of their own, so that a busy machine slows down both; times are
processor seconds, and the ratio of each round is the best of three of here over the best of three of there.  The
tasks are those of ``benchmarks.ident_cost`` that both checkouts have.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

_HERE = Path(__file__).resolve().parents[1]
_RUN = """
import sys, time
from benchmarks.ident_cost import TASKS
make, work = TASKS[sys.argv[1]]
record, seconds = make(int(sys.argv[2])), []
for _ in range(4):
    start = time.process_time()
    work(record)
    seconds.append(time.process_time() - start)
print(min(seconds[1:]))
"""


def seconds_in(checkout: Path, task: str, n_samples: int) -> float:
    """Return the processor time of a task in a checkout [s]."""
    environment = {**os.environ, "PYTHONPATH": str(checkout), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-c", _RUN, task, str(n_samples)]
    said = subprocess.run(command, check=True, capture_output=True, text=True, cwd=checkout, env=environment)
    return float(said.stdout)


def main() -> None:
    """Print a line for every task and size."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.paired", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("other", type=Path, metavar="OTHER", help="folder of the other checkout")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--tasks", nargs="*", default=["estimate_transfer_function", "identify"])
    parser.add_argument("--sizes", nargs="*", type=int, default=[1_000, 3_000, 10_000])
    arguments = parser.parse_args()
    print("| task | samples | here [s] | there [s] | ratio, median (least to most) |\n|---|---|---|---|---|")
    for task in arguments.tasks:
        for n_samples in arguments.sizes:
            rounds = np.array(
                [
                    [seconds_in(checkout, task, n_samples) for checkout in (_HERE, arguments.other.resolve())]
                    for _ in range(arguments.rounds)
                ]
            )
            ratios = rounds[:, 0] / rounds[:, 1]
            here, there = np.min(rounds, axis=0)
            print(
                f"| {task} | {n_samples} | {here:.3g} | {there:.3g} | {np.median(ratios):.2f} "
                f"({np.min(ratios):.2f} to {np.max(ratios):.2f}) |",
                flush=True,
            )


if __name__ == "__main__":
    main()
