"""A second-order and a two-mode plant under multisines, from rest, for the tests of the frequency domain."""

from __future__ import annotations

import functools

import numpy as np

from beam_ident import InputSignal, ModalModel, OutputSignal, TimeRecord
from beam_ident.transfer_function.model import TransferFunctionModel

LINE_PERIOD_S = 10.0
TICK_S = 0.01
LINES_HZ = np.arange(5, 450, 4) / 10.0
PLANT = TransferFunctionModel(
    np.array([900.0]), np.array([1.0, 3.0, 900.0]), 0.0, np.zeros((4, 4)), 0.0
)  # 5 % damping: 12 s after its start a transient is below 1e-7
OMEGAS, ZETAS = 2.0 * np.pi * np.array([4.4, 28.3]), np.array([0.03, 0.01])
RESIDUES = np.array([[1.1, -0.3], [0.2, 0.25]])
RESIDUAL_TERMS = np.array([2e-6, -1e-6])
NAMES = ("tip", "root")


def modal_plant(structure: str = "base_motion") -> ModalModel:
    size = 6 + 2 * 4
    return ModalModel(
        structure,  # type: ignore[arg-type]
        "u",
        NAMES,
        OMEGAS,
        ZETAS,
        RESIDUES,
        RESIDUAL_TERMS,
        np.zeros(2) if structure == "receptance" else np.ones(2),
        0.0,
        0.0,
        np.zeros((size, size)),
        np.ones(2),
    )


def multisine(
    n_periods: int, lines_hz: np.ndarray = LINES_HZ, tick_s: float = TICK_S, fall: float = 0.0
) -> np.ndarray:
    """Return ticks of a multisine, its lines falling as 1 / (1 + (fall f)^2)."""
    one = tick_s * np.arange(round(LINE_PERIOD_S / tick_s))
    phases = np.random.default_rng(4).uniform(0.0, 2.0 * np.pi, len(lines_hz))
    sizes = 1.0 / (1.0 + (fall * lines_hz) ** 2) / np.sqrt(len(lines_hz))
    period = sum(a * np.sin(2 * np.pi * f * one + p) for a, f, p in zip(sizes, lines_hz, phases, strict=True))
    return np.tile(period, n_periods)


@functools.lru_cache(maxsize=32)
def _siso(
    hold: str, step: int, offset: float, exposure: float, n_periods: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n = round(LINE_PERIOD_S / TICK_S)
    ticks = multisine(n_periods + 3)
    drive = InputSignal("u", "", (0.0, TICK_S), ticks, hold)  # type: ignore[arg-type]
    stamps = TICK_S * np.arange(2 * n, (n_periods + 2) * n, step) + offset
    return ticks, stamps, PLANT.simulate(drive, stamps, exposure)


@functools.lru_cache(maxsize=32)
def _modal(
    structure: str, step: int, hold: str, n_periods: int
) -> tuple[InputSignal, np.ndarray, np.ndarray]:
    tick_s = 1e-3
    n = round(LINE_PERIOD_S / tick_s)
    drive = InputSignal(
        "u", "", (0.0, tick_s), 1e-2 * multisine(n_periods + 3, tick_s=tick_s, fall=0.5), hold
    )  # type: ignore[arg-type]
    instants = tick_s * np.arange(2 * n, (n_periods + 2) * n, step) + 4e-4
    return drive, instants, modal_plant(structure).simulate(drive, instants, 5e-3)


def siso_record(
    noise: float = 0.0,
    hold: str = "zoh",
    step: int = 1,
    offset: float = 0.0,
    exposure: float = 0.0,
    n_periods: int = 4,
    seed: int = 0,
    input_noise: float = 0.0,
) -> TimeRecord:
    """Return steady periods of `PLANT`; the output is sampled every ``step`` ticks, ``offset`` late."""
    rng = np.random.default_rng(seed)
    ticks, stamps, clean = _siso(hold, step, offset, exposure, n_periods)
    output = clean + noise * rng.standard_normal(len(stamps))
    seen = InputSignal("u", "", (0.0, TICK_S), ticks + input_noise * rng.standard_normal(len(ticks)), hold)  # type: ignore[arg-type]
    return TimeRecord((seen,), (OutputSignal("y", "", stamps, output, exposure),))


def modal_record(
    structure: str = "base_motion",
    noise: float = 1e-5,
    seed: int = 0,
    latency: float = 0.0,
    step: int = 10,
    hold: str = "cubic",
    n_periods: int = 4,
) -> TimeRecord:
    """Return steady periods of `modal_plant`: ticks of 1 ms, frames every ``step`` ticks, 5 ms of exposure."""
    drive, instants, clean = _modal(structure, step, hold, n_periods)
    noisy = clean + noise * np.random.default_rng(seed).standard_normal(clean.shape)
    outputs = [OutputSignal(name, "", instants + latency, noisy[:, j], 5e-3) for j, name in enumerate(NAMES)]
    return TimeRecord((drive,), tuple(outputs))
