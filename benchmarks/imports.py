"""What it costs to load an estimator, beside what NumPy and SciPy's linear algebra and optimisation cost.

    python -m benchmarks.imports [NAME ...] [--rounds N]

NAME is a public name of ``beam_ident``; each is loaded in a process of its own, in turns with one that loads NumPy,
``scipy.linalg`` and ``scipy.optimize`` alone. Times are processor seconds of the whole process, interpreter included.
The ratio is the median of the rounds', so that a machine that is busy for a while weighs on both.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys

import numpy as np

BASE = "import numpy, scipy.linalg, scipy.optimize"
NAMES = (
    "TimeRecord",
    "identify",
    "fit_free_decay",
    "fit_frequency_modes",
    "analyse_modes",
    "estimate_transfer_function",
    "select_transfer_function",
    "estimate_common_poles",
    "estimate_in_closed_loop",
    "fit_frequency_transfer_function",
    "subspace_model",
    "identify_axis",
    "best_linear_approximation",
    "periodic_response",
    "welch_response",
    "hammer_response",
    "linearity",
    "amplitude_curves",
    "design_experiment",
    "validate",
)


def seconds_of(code: str) -> float:
    """Return the processor time of an interpreter that runs some code [s]."""
    # Modules are compiled once and for all, as they are for everybody.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = os.times()
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    after = os.times()
    return sum(getattr(after, own) - getattr(before, own) for own in ("children_user", "children_system"))


def main() -> None:
    """Print a line for every name."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.imports", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    print("| name | with it [s] | base [s] | ratio, median (least to most) |\n|---|---|---|---|")
    for name in arguments.names:
        code = f"import beam_ident; beam_ident.{name}"
        seconds_of(code)
        rounds = np.array([[seconds_of(code), seconds_of(BASE)] for _ in range(arguments.rounds)])
        ratios = rounds[:, 0] / rounds[:, 1]
        here, base = np.median(rounds, axis=0)
        spread = f"{np.median(ratios):.2f} ({np.min(ratios):.2f} to {np.max(ratios):.2f})"
        print(f"| {name} | {here:.2f} | {base:.2f} | {spread} |", flush=True)


if __name__ == "__main__":
    main()
