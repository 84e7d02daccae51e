"""A flexible robot arm: real data, estimated on one half, predicted on the other; see docs/robot-arm.md."""

import os
import sys

import numpy as np

from beam_ident import (
    InputSignal,
    OutputSignal,
    TimeRecord,
    assess_repeatability,
    estimate_transfer_function,
    validate,
)

PERIOD_S = 0.008  # not stated with the data; frequencies scale with it
path = sys.argv[1] if len(sys.argv) > 1 else os.environ.get("ROBOT_ARM_DATA", "robot_arm.dat")
if not os.path.isfile(path):
    sys.exit(
        f"skipped, no {path}: get 96-009 of https://homes.esat.kuleuven.be/~smc/daisy; set ROBOT_ARM_DATA"
    )
torque, acceleration = np.loadtxt(path, unpack=True)


def part(samples: slice) -> TimeRecord:
    """Return some of the samples as a record that begins at 0 s."""
    drive = InputSignal("torque", "", (0.0, PERIOD_S), torque[samples], "zoh")
    return TimeRecord((drive,), (OutputSignal("acceleration", "", (0.0, PERIOD_S), acceleration[samples]),))


halves = part(slice(0, 512)), part(slice(512, 1024))
for n_poles, n_zeros in ((4, 4), (6, 5)):
    first, second = (estimate_transfer_function(h, n_poles, n_zeros, has_free_response=True) for h in halves)
    there = validate(first.model, halves[1]).outputs[0].scores.fit_percent
    print(
        f"{n_poles} poles, {n_zeros} zeros: FIT {first.scores.fit_percent:.2f} %, on the second half {there:.2f} %"
    )
    for half in (first.model, second.model):
        for omega, zeta, omega_sd, zeta_sd in zip(*half.modes(), strict=True):
            hertz = f"{omega / 2 / np.pi:.4f} +- {omega_sd / 2 / np.pi:.4f} Hz"
            print(f"  {hertz}, {100 * zeta:.3f} +- {100 * zeta_sd:.3f} %", end=";")
        print()
    print(f"  {assess_repeatability([first.model, second.model]).verdict}")
