"""One small result of every estimator, made once, for the tests that hold for all of them."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from beam_ident import (
    ESTIMATORS,
    BestLinearApproximation,
    EstimatorSettings,
    FrequencyRecord,
    InputSignal,
    OutputSignal,
    SampledController,
    TimeRecord,
    TransferFunctionModel,
    analyse_modes,
    best_linear_approximation,
    estimate_common_poles,
    estimate_in_closed_loop,
    estimate_transfer_function,
    fit_free_decay,
    fit_frequency_modes,
    fit_frequency_transfer_function,
    identify,
    periodic_response,
    run_estimator,
    stabilisation_chart,
    subspace_model,
)

PERIOD_S = 0.01
PLANT = TransferFunctionModel(
    np.array([400.0]), np.array([1.0, 4.0, 400.0]), 0.0, np.zeros((4, 4)), 0.0
)  # 3.2 Hz, 10 % damping


def record(n_periods: int = 4) -> TimeRecord:
    """Return a plant under a periodic input, seen with a little noise."""
    rng = np.random.default_rng(1)
    period = np.convolve(rng.standard_normal(256), np.ones(3), mode="same")
    drive = InputSignal("u", "N", (0.0, PERIOD_S), np.tile(period, n_periods), "zoh")
    stamps = PERIOD_S * np.arange(1, 256 * n_periods)
    clean = PLANT.simulate(drive, stamps)
    outputs = [
        OutputSignal(name, "m", stamps, gain * clean + 0.01 * rng.standard_normal(len(stamps)))
        for name, gain in (("y", 1.0), ("z", -0.5))
    ]
    return TimeRecord((drive,), tuple(outputs))


def decay() -> OutputSignal:
    """Return a decay of the same plant."""
    times = PERIOD_S * np.arange(400)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(len(times))
    return OutputSignal("y", "m", times, np.exp(-2.0 * times) * np.cos(19.9 * times) + noise)


def lines() -> FrequencyRecord:
    """Return the same record's response, line by line."""
    return periodic_response(record(6).select(("y",)), 2.56, start_s=5.12).response


def best_linear() -> BestLinearApproximation:
    """Return the best linear approximation of the same plant under three periodic inputs."""
    realisations = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        drive = InputSignal("u", "N", (0.0, PERIOD_S), np.tile(rng.standard_normal(64), 6), "zoh")
        stamps = PERIOD_S * np.arange(64, 384)
        clean = PLANT.simulate(drive, stamps) + 1e-3 * rng.standard_normal(len(stamps))
        realisations.append(TimeRecord((drive,), (OutputSignal("y", "m", stamps, clean),)))
    return best_linear_approximation(realisations, 64 * PERIOD_S, np.arange(1, 20) / (64 * PERIOD_S))


def looped() -> TimeRecord:
    """Return the plant under a slow integrator, with its reference."""
    rng = np.random.default_rng(3)
    reference = np.repeat(rng.choice([-1.0, 1.0], 128), 8)
    drive, seen = np.zeros(len(reference)), np.zeros(len(reference))
    # One sample of the plant under a held input, by its own simulation.
    pulse = InputSignal("u", "", (0.0, PERIOD_S), np.eye(1, len(reference))[0], "zoh")
    weights = PLANT.simulate(pulse, PERIOD_S * np.arange(len(reference)))
    for k in range(len(reference)):
        seen[k] = weights[1 : k + 1] @ drive[:k][::-1] if k else 0.0
        drive[k] = 0.2 * (reference[k] - seen[k])
    noisy = seen + 1e-3 * rng.standard_normal(len(seen))
    stamps = PERIOD_S * np.arange(len(seen))
    inputs = (
        InputSignal("r", "", (0.0, PERIOD_S), reference, "zoh"),
        InputSignal("u", "", (0.0, PERIOD_S), drive, "zoh"),
    )
    return TimeRecord(inputs, (OutputSignal("y", "", stamps, noisy),))


@functools.cache
def result(name: str) -> Any:
    """Return the result of an estimator, by its name or by that of the table."""
    if name in ESTIMATORS:
        return run_estimator(name, record(), EstimatorSettings("receptance", 1))
    one = record().select(("y",))
    if name == "identify":
        return identify(record(), "receptance", n_modes=1)
    if name == "estimate_transfer_function":
        return estimate_transfer_function(one, 2, 0)
    if name == "several inputs":
        return estimate_transfer_function(one, 2, [0])
    if name == "estimate_common_poles":
        return estimate_common_poles(record(), 2, 0)
    if name == "common poles of several inputs":
        return estimate_common_poles(record(), 2, [[0]] * len(record().outputs))
    if name == "estimate_in_closed_loop":
        return estimate_in_closed_loop(looped(), SampledController([0.2], [1.0], PERIOD_S), 2, 0, "r", "u")
    if name == "subspace_model":
        return subspace_model(record(), 2)
    if name == "fit_free_decay":
        return fit_free_decay(decay(), 1)
    if name == "fit_frequency_modes":
        return fit_frequency_modes(lines(), "receptance", n_modes=1)
    if name == "fit_frequency_transfer_function":
        return fit_frequency_transfer_function(lines(), 2, 0)
    chart = stabilisation_chart(lines(), max_order=6)
    return analyse_modes(chart, [3.2])


BY_NAME = tuple(ESTIMATORS)
OVER_SEVERAL_OUTPUTS = (
    "identify",
    "estimate_common_poles",
    "common poles of several inputs",
    "subspace_model",
    "fit_free_decay",
    *(name for name in BY_NAME if name != "local_polynomial"),
)
OVER_ONE_OUTPUT = ("estimate_transfer_function", "several inputs", "estimate_in_closed_loop")
OVER_RECORDS = ("fit_frequency_modes", "local_polynomial")
OVER_LINES = (*OVER_RECORDS, "fit_frequency_transfer_function", "analyse_modes")
ALL = OVER_SEVERAL_OUTPUTS + OVER_ONE_OUTPUT + OVER_LINES
