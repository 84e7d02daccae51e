"""Inputs that have nothing to do with the output: what passes for a model of them."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy.signal import lfilter

from beam_ident import (
    EstimationError,
    InputSignal,
    OutputSignal,
    TimeRecord,
    estimate_common_poles,
    estimate_transfer_function,
    identify,
    select_transfer_function,
    subspace_model,
)
from benchmarks.ident.study import Outcome, Study

PERIOD_S, N_SAMPLES = 0.01, 1500
COLOURS = {
    "white": np.array([1.0]),
    "AR(0.9)": np.array([1.0, -0.9]),
    "rings at 6 Hz, 7 %": np.array([1.0, -1.8, 0.95]),
    "rings at 6 Hz, 0.7 %": np.array([1.0, -1.8513, 0.9948]),
}


def unrelated_record(seed: int) -> TimeRecord:
    """Return a record of an input and noise; the colour of the noise and the kind of input change with the seed."""
    rng = np.random.default_rng([seed, 9])
    times = PERIOD_S * np.arange(N_SAMPLES)
    drives = (
        rng.standard_normal(N_SAMPLES),
        np.sin(2.0 * np.pi * (0.5 * times + 0.65 * times**2)),
        np.sign(rng.standard_normal(N_SAMPLES // 25)).repeat(25),
    )
    colour = list(COLOURS.values())[seed % len(COLOURS)]
    noise = lfilter([1.0], colour, rng.standard_normal(N_SAMPLES + 2000))[2000:]
    drive = InputSignal("u", "N", (0.0, PERIOD_S), drives[seed // len(COLOURS) % 3], "zoh")
    return TimeRecord((drive,), (OutputSignal("y", "m", (0.0, PERIOD_S), noise),))


def _are_believed(warnings: tuple[str, ...]) -> bool:
    return not any("no more than chance" in said for said in warnings)


def _identify(record: TimeRecord) -> bool:
    return _are_believed(identify(record, "receptance").warnings)


def _select(record: TimeRecord) -> bool:
    return _are_believed(select_transfer_function(record, range(1, 4)).chosen.warnings)


ESTIMATORS = {
    "identify": _identify,
    "select": _select,
    "transfer function": lambda record: _are_believed(estimate_transfer_function(record, 2, 1).warnings),
    "rivc": lambda record: _are_believed(estimate_transfer_function(record, 2, 1, method="rivc").warnings),
    "common poles": lambda record: _are_believed(estimate_common_poles(record, 2, 1).warnings),
    "subspace": lambda record: _are_believed(subspace_model(record, 2).warnings),
}


class UnrelatedInputCase:
    """Every estimator on one record; a model without an error and without the warning is a false one."""

    def run(self, seed: int) -> Outcome:
        """Note which estimators believe in a model."""
        record = unrelated_record(seed)
        start = time.perf_counter()
        figures = {}
        for name, is_accepted in ESTIMATORS.items():
            try:
                figures[name] = float(is_accepted(record))
            except EstimationError:
                figures[name] = 0.0
        return Outcome(time.perf_counter() - start, figures=figures)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the share of false models of every estimator [%]."""
        return {
            name: round(100.0 * float(np.mean([o.figures[name] for o in outcomes])), 2) for name in ESTIMATORS
        }


STUDIES = {
    "unrelated-input": Study(
        "false models of an unrelated input [%], noise white to ringing", 240, UnrelatedInputCase
    )
}
