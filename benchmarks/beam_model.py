"""Speed of the beam model beside SciPy's own integrators, in one run on one machine.

    python benchmarks/beam_model.py [--json FILE] [--seconds 60]

A record of a hub acceleration held at 1 kHz drives the default rig; every method gives the same states, and the error
against this package's steps is printed beside the time. Times are the best of several.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from scipy import signal
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from beam_model import (
    AirDrag,
    AxisStepper,
    BeamModel,
    BeamParameters,
    Damping,
    EndStops,
    HubFriction,
    NonlinearTerms,
)
from beam_model.galerkin import stepping
from beam_model.galerkin.compiled import compiled_pairs

PERIOD = 1e-3


def default_rig() -> BeamParameters:
    """The default rig: an upright spring-steel strip."""
    return BeamParameters.from_section(
        0.30, 0.025, 0.0005, 7850.0, 200e9, hub_mass=0.8, gravity="upright", damping=Damping(ratios=(0.005,))
    )


def best_time(action: Callable[[], Any], repetitions: int) -> tuple[float, Any]:
    """Return the shortest time of several runs [s] and the last result."""
    best, result = float("inf"), None
    for _ in range(repetitions):
        start = time.perf_counter()
        result = action()
        best = min(best, time.perf_counter() - start)
    return best, result


def step_time(n_modes: int) -> float:
    """Return the time of one simulator step [s]."""
    stepper = BeamModel(default_rig(), n_modes).motion_stepper(PERIOD)

    def steps() -> None:
        for _ in range(5000):
            stepper.step(0.5)

    return best_time(steps, 5)[0] / 5000


def axis_step_times() -> dict[str, float]:
    """Return the mean time of a step of the hub on its guide [s], 5 modes, by what resists it."""
    model = BeamModel(default_rig(), 5)
    friction, stops = HubFriction(coulomb=1.5, static=2.0, viscous=4.0), EndStops(-0.005, 0.005, 0.3)
    terms = NonlinearTerms(model, AirDrag(0.025, 6.0))
    kinds: dict[str, dict[str, Any]] = {
        "free": {},
        "friction": {"friction": friction},
        "friction and stops": {"friction": friction, "stops": stops},
        "friction, stops, drag, large deflections": {"friction": friction, "stops": stops, "terms": terms},
    }
    # Some 3 N, another one every 10 ms: the hub sticks, breaks loose and strikes stops all the time.
    forces = np.repeat(3.0 * np.random.default_rng(1).standard_normal(300), 10).tolist()

    def steps(options: dict[str, Any]) -> None:
        axis = AxisStepper(model, PERIOD, **options)
        for force in forces:
            axis.step(force)

    return {
        kind: best_time(lambda options=options: steps(options), 3)[0] / 3000
        for kind, options in kinds.items()
    }


def record(n_samples: int) -> np.ndarray:
    """Return a hub acceleration [m/s^2]."""
    return np.random.default_rng(1).standard_normal(n_samples)


def batch_time(n_modes: int, n_samples: int, drive: str = "motion") -> tuple[float, np.ndarray]:
    """Return the time of a whole record [s] and its states."""
    model = BeamModel(default_rig(), n_modes)
    stepper = model.motion_stepper(PERIOD) if drive == "motion" else model.force_stepper(PERIOD)
    values = record(n_samples)

    def run() -> np.ndarray:
        stepper.reset()
        return stepper.run(values)

    return best_time(run, 5)


def state_matrices(n_modes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return A and B over [q, q'] under a hub acceleration."""
    model = BeamModel(default_rig(), n_modes)
    n, omega, zeta = n_modes, model.natural_frequencies, model.damping_ratios
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n], A[n:, n:] = -np.diag(omega**2), -np.diag(2.0 * zeta * omega)
    return A, np.concatenate([np.zeros(n), -model.participation_factors])


def lfilter_time(n_modes: int, n_samples: int) -> tuple[float, np.ndarray]:
    """Return the time of ten lines of `scipy.signal.lfilter` for the same record [s] and its states."""
    transition, held = BeamModel(default_rig(), n_modes).motion_stepper(PERIOD).tick_matrices
    values = record(n_samples)

    def run() -> np.ndarray:
        states = np.zeros((n_samples + 1, 2 * n_modes))
        for mode in range(n_modes):
            own = [mode, n_modes + mode]
            F, (g, h) = transition[np.ix_(own, own)], held[own]
            denominator = [1.0, -np.trace(F), np.linalg.det(F)]
            states[1:, own[0]] = signal.lfilter([g, F[0, 1] * h - F[1, 1] * g], denominator, values)
            states[1:, own[1]] = signal.lfilter([h, F[1, 0] * g - F[0, 0] * h], denominator, values)
        return states

    return best_time(run, 5)


def compiled_time(n_modes: int, n_samples: int, is_used: bool) -> float:
    """Return the time of a whole record [s], with compiled code where it is installed, or without."""
    known, stepping._COMPILED_FROM = stepping._COMPILED_FROM, 0 if is_used else n_samples + 1
    try:
        batch_time(n_modes, 1000)  # compiles
        return batch_time(n_modes, n_samples)[0]
    finally:
        stepping._COMPILED_FROM = known


def lsim_time(n_modes: int, n_samples: int) -> tuple[float, np.ndarray]:
    """Return the time of `scipy.signal.lsim` for the same record [s] and its states."""
    A, B = state_matrices(n_modes)
    system = signal.StateSpace(A, B[:, None], np.eye(2 * n_modes), np.zeros((2 * n_modes, 1)))
    t = np.arange(n_samples) * PERIOD
    values = record(n_samples)
    seconds, result = best_time(lambda: signal.lsim(system, values, t, interp=False), 2)
    return seconds, result[2]


def solve_ivp_time(n_modes: int, n_samples: int) -> tuple[float, np.ndarray]:
    """Return the time of `solve_ivp`, restarted at every tick, for the same record [s] and its last state."""
    A, B = state_matrices(n_modes)
    values = record(n_samples)
    start = time.perf_counter()
    state = np.zeros(2 * n_modes)
    for value in values:
        drive = B * value
        solution = solve_ivp(
            lambda _, x, drive=drive: A @ x + drive, (0.0, PERIOD), state, "DOP853", rtol=1e-10, atol=1e-14
        )
        state = solution.y[:, -1]
    return time.perf_counter() - start, state


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path, help="write the figures here, too")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the record [s]")
    arguments = parser.parse_args()
    n_samples = round(arguments.seconds / PERIOD)
    print(
        f"Python {platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}, {platform.machine()}"
    )

    figures: dict[str, Any] = {"samples": n_samples}
    print("\none step of the simulator")
    for n in (1, 5, 10, 20, 40):
        figures[f"step_{n}_modes_s"] = step_time(n)
        print(f"  {n:3d} modes {1e6 * figures[f'step_{n}_modes_s']:8.2f} us")

    print("\none step of a hub on its guide, 5 modes")
    for kind, seconds in axis_step_times().items():
        figures[f"axis_step_{kind}_s"] = seconds
        print(f"  {1e6 * seconds:8.1f} us   {kind}")

    print(f"\na record of {arguments.seconds:g} s at 1 kHz, 5 modes")
    ours, states = batch_time(5, n_samples)
    theirs, lsim_states = lsim_time(5, n_samples)
    error = np.abs(lsim_states - states[:-1]).max() / np.abs(states).max()
    n_short = min(n_samples, 1000)
    short, last = solve_ivp_time(5, n_short)
    ivp = short * n_samples / n_short
    ivp_error = np.abs(last - states[n_short]).max() / np.abs(states[n_short]).max()
    figures |= {"batch_s": ours, "lsim_s": theirs, "solve_ivp_s": ivp}
    figures |= {"lsim_over_batch": theirs / ours, "solve_ivp_over_batch": ivp / ours}
    print(f"  beam_model      {1e3 * ours:10.1f} ms")
    print(
        f"  lsim            {1e3 * theirs:10.1f} ms   {theirs / ours:8.1f} times ours, differs by {error:.1e}"
    )
    print(
        f"  solve_ivp 1e-10 {1e3 * ivp:10.1f} ms   {ivp / ours:8.1f} times ours, differs by {ivp_error:.1e}"
    )
    print(f"    (from {n_short} ticks; its cost is proportional to them)")

    print("\nbeside lfilter, and a copy of the states; `compiled` needs the extra of that name")
    for n, ticks in ((1, 1_000_000), (2, 1_000_000), (5, n_samples), (5, 1_000_000), (20, 1_000_000)):
        plain = compiled_time(n, ticks, is_used=False)
        theirs, states = lfilter_time(n, ticks)
        copied = best_time(states.copy, 5)[0]
        name = f"{n}_modes_{ticks}_ticks"
        figures |= {f"lfilter_over_batch_{name}": theirs / plain, f"batch_over_copy_{name}": plain / copied}
        line = f"lfilter {theirs / plain:5.2f} times ours; ours {plain / copied:5.1f} copies"
        if compiled_pairs() is not None:
            ratio = figures[f"compiled_over_copy_{name}"] = compiled_time(n, ticks, is_used=True) / copied
            line += f", compiled {ratio:4.2f} copies"
        print(f"  {n:3d} modes {ticks:8d} ticks  {line}")

    print("\nwhole records against the number of modes and length")
    for drive in ("motion", "force"):
        for n in (1, 5, 10, 20, 40):
            seconds = batch_time(n, n_samples, drive)[0]
            figures[f"batch_{drive}_{n}_modes_s"] = seconds
            print(f"  {drive:6s} {n:3d} modes {n_samples:8d} ticks {1e3 * seconds:10.1f} ms")
    for length in (1_000, 10_000, 100_000, 1_000_000):
        seconds = batch_time(5, length)[0]
        figures[f"batch_{length}_ticks_s"] = seconds
        print(f"  motion   5 modes {length:8d} ticks {1e3 * seconds:10.1f} ms")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
