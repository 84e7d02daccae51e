"""What poles do on their own, averaged over an exposure."""

from __future__ import annotations

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray

_MAX_GROWTH = (
    150.0  # exponent: what was larger before it began is in no sample, and its square is still a number
)


def free_motions(
    poles: ComplexArray,
    elapsed: FloatArray,
    exposure_s: float,
    pole_slopes: tuple[ComplexArray, ...],
) -> tuple[ComplexArray, ...]:
    """Return decays averaged over the exposure, and their derivatives by what moves the poles and by time.

    Parameters
    ----------
    poles : ndarray, shape (n_poles, 1) -- [rad/s]
    elapsed : ndarray, shape (n,) -- since the first stamp [s]
    exposure_s : float -- box average centred on each instant [s]
    pole_slopes : tuple of ndarray, each (n_poles, 1)
        Derivatives of the poles by their parameters; without any, only the decays are returned.

    Notes
    -----
    Stamps before the beginning belong to samples that are left out: motion is larger there, and stays finite.
    """
    half = _bounded(0.5 * poles * exposure_s)
    is_small = np.abs(half) < 1e-4
    safe = np.where(is_small, 1.0, half)
    shape = np.where(is_small, 1.0 + half**2 / 6.0, np.sinh(safe) / safe)
    decay = np.exp(_bounded(poles * elapsed)) * shape
    if not pole_slopes:
        return (decay,)
    log_shape = 0.5 * exposure_s * np.where(is_small, half / 3.0, 1.0 / np.tanh(safe) - 1.0 / safe)
    slope = decay * (elapsed + log_shape)
    return (decay, *(slope * d for d in pole_slopes), poles * decay)


def _bounded(exponents: ComplexArray) -> ComplexArray:
    """Return exponents whose size does not overflow."""
    return np.asarray(np.clip(exponents.real, -_MAX_GROWTH, _MAX_GROWTH) + 1j * exponents.imag)
