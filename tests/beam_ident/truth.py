"""A beam on a moved base, simulated independently of the library: matrix exponentials at half-tick steps."""

from __future__ import annotations

import functools

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from beam_ident import InputSignal, LogChirp, ModalModel, OutputSignal, Recipe, TimeRecord

OMEGAS = 2.0 * np.pi * np.array([4.384, 28.26, 79.36])
ZETAS = np.array([0.005, 0.005, 0.005])
RESIDUES = np.array([[0.011, -0.055, 0.1], [1.1, 0.12, -0.35], [1.5, -0.75, 0.33]])
RESIDUAL_TERMS = np.array([1e-7, -2e-7, 5e-7])
EXPOSURE_S = 5e-3
PERIOD_S = 1e-3
SHORT_CHIRP = LogChirp(duration=10.0, still=4.0)  # half the rig's own, to keep the tests quick


def _integrals(matrix: np.ndarray, accelerations: np.ndarray) -> np.ndarray:
    """Return the third state of x' = matrix x + (0, 1, 0) a after every half tick."""
    augmented = np.zeros((4, 4))
    augmented[:3, :3] = matrix
    augmented[1, 3] = 1.0
    step = expm(augmented * PERIOD_S / 2)
    a, b = step[:3, :3], step[:3, 3]
    states = np.zeros((len(accelerations) + 1, 3))
    for k, value in enumerate(accelerations):
        states[k + 1] = a @ states[k] + b * value
    return states[:, 2]


@functools.lru_cache(maxsize=4)
def displacements(recipe: Recipe, rate_hz: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps and exact outputs, averaged over the exposure, shape (3, n)."""
    excitation = recipe.sample(PERIOD_S)
    held = np.repeat(excitation.accelerations, 2)
    n_frames = int(excitation.duration_s * rate_hz) - 2
    centres = (np.arange(n_frames) + 1) * round(2.0 / rate_hz / PERIOD_S)
    width = round(EXPOSURE_S / PERIOD_S)

    def averaged(integral: np.ndarray) -> np.ndarray:
        return (integral[centres + width] - integral[centres - width]) / EXPOSURE_S

    rigid = averaged(_integrals(np.array([[0, 1, 0], [0, 0, 0], [1, 0, 0.0]]), held))
    acceleration = averaged(np.concatenate([[0.0], np.cumsum(held) * PERIOD_S / 2]))
    modes = [
        averaged(_integrals(np.array([[0, 1, 0], [-(w**2), -2 * z * w, 0], [1, 0, 0.0]]), held))
        for w, z in zip(OMEGAS, ZETAS, strict=True)
    ]
    outputs = rigid - RESIDUES @ np.array(modes) - RESIDUAL_TERMS[:, None] * acceleration
    return centres * PERIOD_S / 2, outputs


def beam_record(
    seed: int,
    recipe: Recipe | None = None,
    noise: float = 4e-6,
    encoder: float = 1e-7,
    latency: float = 0.0,
    quantity: str = "position",
) -> TimeRecord:
    """Return one noisy experiment: hub position (or the command) in, three points out."""
    recipe = recipe if recipe is not None else SHORT_CHIRP
    rng = np.random.default_rng(seed)
    excitation = recipe.sample(PERIOD_S)
    drive = excitation.input_signal(quantity, "hub")
    if quantity == "position" and encoder > 0.0:
        values = np.round(drive.values / encoder + rng.uniform(-0.5, 0.5)) * encoder
        drive = InputSignal("hub", "m", drive.times_s, values, "cubic")
    stamps, clean = displacements(recipe)
    noisy = clean + noise * rng.standard_normal(clean.shape)
    outputs = [
        OutputSignal(name, "m", stamps + latency, values, EXPOSURE_S)
        for name, values in zip(("z010", "z225", "z285"), noisy, strict=True)
    ]
    return TimeRecord((drive,), tuple(outputs), name="beam")


def averaged_cosine(times: np.ndarray, pole: complex, amplitude: complex, exposure_s: float) -> np.ndarray:
    """Return the mean of Re a e^(p t) over an exposure centred on every instant, from the integral table."""
    sigma, omega, phase = pole.real, pole.imag, np.angle(amplitude)

    def integral(t: np.ndarray) -> np.ndarray:
        turn = omega * t + phase
        return np.exp(sigma * t) * (sigma * np.cos(turn) + omega * np.sin(turn)) / (sigma**2 + omega**2)

    return (
        np.abs(amplitude) * (integral(times + exposure_s / 2) - integral(times - exposure_s / 2)) / exposure_s
    )


def coloured_record(seed: int) -> TimeRecord:
    """Return the beam's record with noise that remembers, 0.8 from sample to sample."""
    record = beam_record(seed, noise=1e-9)
    rng = np.random.default_rng(seed)
    outputs = []
    for output in record.outputs:
        noise = lfilter([1.0], [1.0, -0.8], 3e-6 * rng.standard_normal(len(output.values) + 100))[100:]
        outputs.append(
            OutputSignal(output.name, "m", output.times_s, output.values + noise, output.exposure_s)
        )
    return TimeRecord(record.inputs, tuple(outputs))


def z_scores(model: ModalModel) -> np.ndarray:
    """Return all modal parameters' errors over their stated standard deviations."""
    return np.concatenate(
        [
            (model.natural_frequencies - OMEGAS) / model.natural_frequency_sd,
            (model.damping_ratios - ZETAS) / model.damping_ratio_sd,
            ((model.residues - RESIDUES) / model.residue_sd).ravel(),
            (model.residual_terms - RESIDUAL_TERMS) / model.residual_term_sd,
            (model.gains - 1.0) / model.gain_sd,
        ]
    )
