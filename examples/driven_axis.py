"""A driven axis: mass and friction from the force on it and its noisy position, in a closed loop."""

import numpy as np

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord, check_axis, identify_axis

PERIOD_S = 1e-3
MASS, VISCOUS, COULOMB = 2.0, 6.0, 3.0


def run(seed: int, reference: np.ndarray) -> TimeRecord:
    """Let a servo with a noisy encoder follow a reference, in steps of a fiftieth of its period."""
    rng = np.random.default_rng(seed)
    x = v = 0.0
    forces, seen = np.empty(len(reference)), np.empty(len(reference))
    for k, wanted in enumerate(reference):
        seen[k] = x + 2e-6 * rng.standard_normal()
        slope = (seen[k] - seen[k - 1]) / PERIOD_S if k else 0.0
        forces[k] = 4000.0 * (wanted - seen[k]) - 120.0 * slope
        for _ in range(50):
            push = forces[k] - VISCOUS * v
            if v == 0.0 and abs(push) <= COULOMB:
                break
            way = np.sign(v) if v else np.sign(push)
            new = v + (push - way * COULOMB) / MASS * PERIOD_S / 50
            new = 0.0 if v * new < 0.0 else new
            x, v = x + 0.5 * (v + new) * PERIOD_S / 50, new
    return TimeRecord(
        (InputSignal("force", "N", (0.0, PERIOD_S), forces),),
        (OutputSignal("position", "m", (0.0, PERIOD_S), seen),),
    )


t = PERIOD_S * np.arange(5000)
moves = 0.08 * np.sin(2.2 * t) * np.sin(0.7 * t) + 0.02 * np.sin(6.0 * t)
axis = identify_axis(run(1, moves))
print(axis.summary())

# A record that the axis has never seen.
print(check_axis(axis, run(2, moves[::-1] - moves[-1])).verdict)

# An axis that goes one way only does not tell friction from a constant force.
try:
    identify_axis(run(3, 0.05 * t[:2000]))
except EstimationError as err:
    print(f"refused: {err}")
