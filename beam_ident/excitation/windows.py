"""Smooth ramps, windows and the rounded corner between two limits of amplitude.

All of them have three continuous derivatives, so that a windowed displacement has a
continuous jerk and excites nothing above its band.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from beam_ident.arrays import FloatArray


def smooth_rise(fraction: ArrayLike) -> FloatArray:
    """Return the septic 0 -> 1 whose first three derivatives vanish at both ends.

    Notes
    -----
    Its slope peaks at 35/16, its second derivative at 7.513 and its third at 52.5 (in the middle, downwards).
    """
    s = np.clip(fraction, 0.0, 1.0)
    return np.asarray(s**4 * (35.0 - s * (84.0 - s * (70.0 - 20.0 * s))))


def smooth_rise_integral(fraction: ArrayLike) -> FloatArray:
    """Return the integral of ``smooth_rise`` from 0, which goes on with slope 1 after 1."""
    s = np.clip(fraction, 0.0, 1.0)
    inside = s**5 * (7.0 - s * (14.0 - s * (10.0 - 2.5 * s)))
    return np.asarray(inside + np.maximum(np.asarray(fraction, dtype=np.float64) - 1.0, 0.0))


def window(times_s: FloatArray, duration_s: float, fade_in_s: float, fade_out_s: float) -> FloatArray:
    """Return the window that rises over ``fade_in_s``, stays at 1 and falls over ``fade_out_s``.

    Parameters
    ----------
    times_s : ndarray -- any times [s]; the window is 0 outside 0 to ``duration_s``
    duration_s, fade_in_s, fade_out_s : float -- [s], fades above 0
    """
    rise = smooth_rise(times_s / fade_in_s)
    fall = smooth_rise((duration_s - times_s) / fade_out_s)
    return np.asarray(rise * fall)


def soft_minimum(first: FloatArray | float, second: FloatArray) -> FloatArray:
    """Return a smooth function just below the smaller of two positive ones."""
    return np.asarray((np.power(first, -8.0) + np.power(second, -8.0)) ** -0.125)


def displacement_amplitude(
    omega: FloatArray,
    acceleration: float,
    max_velocity: float,
    max_displacement: float | FloatArray,
) -> FloatArray:
    """Return the amplitude of displacement of constant acceleration under ceilings [m].

    Parameters
    ----------
    omega : ndarray -- [rad/s]
    acceleration : float -- amplitude of the acceleration [m/s^2]
    max_velocity : float -- largest amplitude of the velocity [m/s]; 0: no ceiling
    max_displacement : float or ndarray -- largest amplitude of the displacement [m]

    Notes
    -----
    ``min(displacement, velocity / omega, acceleration / omega^2)``, the corners rounded: flat in
    acceleration above, in velocity between, in displacement below.
    """
    amplitude = soft_minimum(max_displacement, acceleration / omega**2)
    return soft_minimum(max_velocity / omega, amplitude) if max_velocity else amplitude
