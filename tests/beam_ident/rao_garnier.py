"""The Rao-Garnier benchmark (Rao and Garnier 2002): a fast and a slow mode, ZOH input from a maximal-length PRBS."""

from __future__ import annotations

import numpy as np
from scipy.signal import cont2discrete, lfilter, max_len_seq

from beam_ident import InputSignal, OutputSignal, TimeRecord

PERIOD_S = 0.01
PARAMETERS = np.array([5.0, 408.0, 416.0, 1600.0, -6400.0, 1600.0])  # a1 .. a4, b0, b1


def prbs(n_samples: int, n_stages: int = 10, width: int = 7) -> np.ndarray:
    return np.resize(np.repeat(2.0 * max_len_seq(n_stages)[0] - 1.0, width), n_samples)


def response(drive: np.ndarray, parameters: np.ndarray = PARAMETERS) -> np.ndarray:
    numerator, denominator, _ = cont2discrete(
        (parameters[4:], np.concatenate([[1.0], parameters[:4]])), PERIOD_S, "zoh"
    )
    return lfilter(numerator[0], denominator, drive)


def bound(drive: np.ndarray, sigma: float) -> np.ndarray:
    """Return the Cramer-Rao bound (standard deviations), by central differences."""
    columns = []
    for i, value in enumerate(PARAMETERS):
        step = np.zeros(6)
        step[i] = 1e-5 * abs(value)
        columns.append(
            (response(drive, PARAMETERS + step) - response(drive, PARAMETERS - step)) / (2 * step[i])
        )
    jacobian = np.stack(columns, axis=1)
    scale = np.linalg.norm(jacobian, axis=0)
    return sigma * np.sqrt(np.diag(np.linalg.inv((jacobian / scale).T @ (jacobian / scale)))) / scale


def noise_level(clean: np.ndarray, snr_db: float) -> float:
    return float(np.std(clean) / 10 ** (snr_db / 20))


def benchmark_record(seed: int, snr_db: float, n_samples: int = 2000) -> TimeRecord:
    drive = prbs(n_samples)
    clean = response(drive)
    noisy = clean + noise_level(clean, snr_db) * np.random.default_rng(seed).standard_normal(n_samples)
    return TimeRecord(
        (InputSignal("u", "", (0.0, PERIOD_S), drive, "zoh"),),
        (OutputSignal("y", "", (0.0, PERIOD_S), noisy),),
    )
