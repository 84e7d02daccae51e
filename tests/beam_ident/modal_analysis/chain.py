"""A chain of five masses with the poles of a published case, built backwards from its spectrum.

A tridiagonal matrix with given eigenvalues follows from Lanczos' recursion; it is the mass-normalised
stiffness of a chain, and its eigenvectors are the mode shapes.  Damping is modal.
"""

from __future__ import annotations

import numpy as np

from beam_ident.data.frequency_record import FrequencyRecord

FREQUENCIES_HZ = np.array([50.00134, 148.1459, 235.1298, 296.3074, 348.0209])
DAMPING = np.array([0.016783, 0.050974, 0.072025, 0.079588, 0.069204])
OMEGAS = 2.0 * np.pi * FREQUENCIES_HZ
LINES = 2.0 * np.pi * np.linspace(10.0, 1700.0, 5000)


def mode_shapes() -> np.ndarray:
    """Return mass-normalised mode shapes, one in each column, of the chain with this spectrum."""
    squares = OMEGAS**2
    vector = np.ones(5) / np.sqrt(5.0)
    basis = np.zeros((5, 5))
    for k in range(5):
        basis[:, k] = vector
        rest = squares * vector
        for _ in range(2):
            rest = rest - basis[:, : k + 1] @ (basis[:, : k + 1].T @ rest)
        vector = rest / max(np.linalg.norm(rest), 1e-300)
    return basis.T


SHAPES = mode_shapes()


def response(omegas: np.ndarray, inputs: tuple[int, ...] = (0,), differentiations: int = 0) -> np.ndarray:
    """Return receptance, mobility or accelerance, shape (n_lines, 5, n_inputs)."""
    s = 1j * omegas[:, None]
    modes = s**differentiations / (s**2 + 2.0 * DAMPING * OMEGAS * s + OMEGAS**2)
    return np.einsum("lm,om,im->loi", modes, SHAPES, SHAPES[list(inputs)])


def residues(inputs: tuple[int, ...] = (0,)) -> np.ndarray:
    """Return the residues A in A / (s - p), shape (5, n_inputs, 5)."""
    return np.einsum("om,im->oim", SHAPES, SHAPES[list(inputs)]) / (2j * OMEGAS * np.sqrt(1.0 - DAMPING**2))


def noisy_record(
    seed: int,
    noise: float = 0.01,
    inputs: tuple[int, ...] = (0,),
    differentiations: int = 0,
    is_relative: bool = True,
    has_variance: bool = True,
    omegas: np.ndarray = LINES,
) -> FrequencyRecord:
    """Return a record with noise of a share of every value, or of every response's root mean square."""
    clean = response(omegas, inputs, differentiations)
    size = (
        np.abs(clean) if is_relative else np.sqrt(np.mean(np.abs(clean) ** 2, axis=0)) * np.ones(clean.shape)
    )
    rng = np.random.default_rng(seed)
    error = rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape)
    variance = (noise * size) ** 2 if has_variance and noise > 0.0 else None
    return FrequencyRecord(omegas, clean + noise * np.sqrt(0.5) * size * error, variance)
