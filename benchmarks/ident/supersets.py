"""Structures that hold others: they can do whatever those do, and must not end in a worse optimum.

Hard records on purpose: the order is mostly too low or too high, the plant bends, noise is loud or has a colour,
the record begins in motion and drifts.  A violation is a fit whose squares exceed those of a fit inside it.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
from scipy.signal import lfilter

from beam_ident import (
    InputSignal,
    ModalStructure,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_common_poles,
    estimate_transfer_function,
    identify,
)
from beam_ident.errors import EstimationError
from benchmarks.ident.study import Outcome, Study

PERIOD_S, N_SAMPLES = 0.02, 400
_ROUNDING = 1e-4  # of -2 log-likelihood for each sample
DEGREES = ((1, 0), (2, 0), (2, 1), (3, 1), (3, 2), (4, 3))
NUISANCES = ((), ("offset",), ("offset", "ramp"), ("free_response",), ("offset", "ramp", "free_response"))

Found = dict[Hashable, tuple[tuple[int, ...], float]]
"""Of every structure: samples of outputs, and -2 log-likelihood."""


def _passed(numerator: float, denominator: list[float], drive: InputSignal) -> np.ndarray:
    n = len(denominator)
    plant = TransferFunctionModel(
        np.array([numerator]), np.array(denominator), 0.0, np.zeros((n + 1, n + 1)), 1.0, "u", "y"
    )
    return np.asarray(plant.simulate(drive, PERIOD_S * np.arange(N_SAMPLES)))


def hard_record(seed: int, n_outputs: int = 1) -> TimeRecord:
    """Return a record that an estimator may lose its way in."""
    rng = np.random.default_rng([seed, 77])
    n, times = N_SAMPLES, PERIOD_S * np.arange(N_SAMPLES)
    noise, signs = rng.standard_normal(n), np.sign(rng.standard_normal(n // 20 + 1)).repeat(20)[:n]
    sweep = np.sin(2.0 * np.pi * (0.3 * times + 0.6 * times**2))
    drive = InputSignal("u", "N", (0.0, PERIOD_S), (noise, signs, sweep)[seed % 3], "zoh")
    count = rng.integers(1, 4)
    omegas = np.sort(np.exp(rng.uniform(np.log(2.0), np.log(90.0), count)))
    zetas = rng.uniform(0.003, 0.3, count)
    outputs = []
    for j in range(n_outputs):
        seen = np.zeros(n)
        for omega, zeta in zip(omegas, zetas, strict=True):
            gain = rng.standard_normal() * omega**1.5
            seen += _passed(gain, [1.0, 2.0 * zeta * omega, omega**2], drive)
        if rng.random() < 0.5:
            pole = rng.uniform(0.5, 20.0)
            seen += _passed(rng.standard_normal() * pole, [1.0, pole], drive)
        size = float(np.std(seen))
        if rng.random() < 0.5:
            rate = zetas[0] * omegas[0]
            ringing = omegas[0] * np.sqrt(1.0 - zetas[0] ** 2) * times
            seen += (
                size * rng.uniform(0.3, 3.0) * np.exp(-rate * times) * np.cos(ringing + rng.uniform(0.0, 6.0))
            )
        if rng.random() < 0.5:
            seen += size * rng.uniform(-3.0, 3.0)
        if rng.random() < 0.5:
            seen += size * rng.uniform(-3.0, 3.0) * times / times[-1]
        if rng.random() < 0.3:
            seen = np.tanh(seen / size) * size
        colour = ([1.0], [1.0, -0.9], [1.0, -1.8, 0.95])[rng.integers(3)]
        error = lfilter([1.0], colour, rng.standard_normal(n + 500))[500:]
        seen += error / np.std(error) * size * 10.0 ** rng.uniform(-2.5, 0.0)
        if rng.random() < 0.3:
            seen += size * 3.0 * (rng.random(n) < 0.01) * rng.standard_normal(n)
        outputs.append(OutputSignal(f"y{j}", "m", (0.0, PERIOD_S), seen))
    return TimeRecord((drive,), tuple(outputs))


def _terms(present: tuple[str, ...]) -> dict[str, bool]:
    return {f"has_{name}": name in present for name in ("offset", "ramp", "free_response")}


def _log_squares(residuals: list[np.ndarray]) -> tuple[tuple[int, ...], float]:
    total = sum(len(left) * float(np.log(left @ left)) for left in residuals)
    return tuple(map(len, residuals)), total


def transfer_functions(seed: int) -> Found:
    """Return what structures of transfer functions end at: degrees with one set of nuisances, and all of those."""
    record, found = hard_record(seed), {}
    few = NUISANCES[seed % len(NUISANCES)]
    wanted = [(d, few) for d in DEGREES] + [(DEGREES[2 + seed % 4], terms) for terms in NUISANCES]
    for (n, m), terms in dict.fromkeys(wanted):
        try:
            fit = estimate_transfer_function(record, n, m, method="white", **_terms(terms))
        except EstimationError:
            continue
        found[n, m, terms] = _log_squares([own.residuals for own in fit.records])
    return found


def delays(seed: int) -> Found:
    """Return what a structure ends at without a delay, and with one that is estimated."""
    record, found = hard_record(seed), {}
    n, m = DEGREES[seed % len(DEGREES)]
    for terms in (("offset",), ("offset", "delay")):
        delay: Any = "estimate" if "delay" in terms else 0.0
        try:
            fit = estimate_transfer_function(record, n, m, method="white", delay=delay, **_terms(terms))
        except EstimationError:
            continue
        found[n, m, terms] = _log_squares([own.residuals for own in fit.records])
    return found


def common_poles(seed: int) -> Found:
    """Return what structures with common poles end at; equal weights are compared, colours have none."""
    record, found = hard_record(seed, 2), {}
    wanted = [(d, ("offset",)) for d in DEGREES[:4]] + [(DEGREES[2 + seed % 2], t) for t in NUISANCES]
    for (n, m), terms in dict.fromkeys(wanted):
        try:
            fit = estimate_common_poles(record, n, m, **_terms(terms))
        except EstimationError:
            continue
        if not any(own.noise for parts in fit.records for own in parts):
            found[n, m, terms] = _log_squares(list(fit.residuals))
    return found


def modes(seed: int) -> Found:
    """Return what structures of modes end at, before the noise weighs."""
    record, found = hard_record(seed, 1 + seed % 2), {}
    for n, terms in itertools.product((1, 2, 3), (("offset", "ramp"), ("offset", "ramp", "free_response"))):
        try:
            fit = identify(record, ModalStructure("receptance", **_terms(terms)), n_modes=n)
        except EstimationError:
            continue
        sizes = tuple(len(own.residuals) for own in fit.outputs)
        entry = next(own for own in fit.orders if own.is_chosen)
        # What is seen through a low-pass, late by itself, or behind noise of a colour has a term more.
        seen = (*fit.model.low_passes, *(f"clock of {name}" for name in fit.model.own_clocks))
        seen += (entry.weighed_by,) if entry.weighed_by else ()
        found[n, n, (*terms, *seen)] = sizes, entry.bic - entry.n_parameters * float(np.log(sum(sizes)))
    return found


class Supersets:
    """Pairs of structures on one record, one inside the other, and how many of them are the wrong way round."""

    def __init__(self, estimate: Callable[[int], Found]) -> None:
        self.estimate = estimate

    def run(self, seed: int) -> Outcome:
        """Count the pairs of one seed."""
        start = time.perf_counter()
        found: dict[Any, tuple[tuple[int, ...], float]] = self.estimate(seed)
        pairs = worse = 0
        for small, large in itertools.permutations(found, 2):
            is_inside = small[0] <= large[0] and small[1] <= large[1] and set(small[2]) <= set(large[2])
            (sizes, less), (own, more) = found[small], found[large]
            if is_inside and sizes == own:  # samples that were left out make another record
                pairs += 1
                worse += more > less + _ROUNDING * sum(sizes)
        return Outcome(time.perf_counter() - start, figures={"pairs": pairs, "worse": worse})

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return pairs, and violations among them."""
        return {
            "pairs": int(sum(own.figures["pairs"] for own in outcomes)),
            "violations": int(sum(own.figures["worse"] for own in outcomes)),
            "failed seeds": [seed for seed, own in enumerate(outcomes) if own.figures["worse"]],
        }


STUDIES = {
    f"supersets-{name}": Study(f"structures inside others: {title}", 100, lambda own=own: Supersets(own))
    for name, title, own in (
        ("transfer-functions", "transfer functions", transfer_functions),
        ("delays", "with a delay", delays),
        ("common-poles", "common poles", common_poles),
        ("modes", "modes", modes),
    )
}
