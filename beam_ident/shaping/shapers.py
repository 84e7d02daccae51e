"""Input shapers: trains of impulses that cancel the swing which their own parts begin, and filters beside them.

A command that is convolved with a shaper leaves no swing in the shaper's mode, whatever the command is. How much
is left where the mode lies elsewhere than the shaper thinks is what tells shapers apart.

References
----------
N. C. Singer, W. P. Seering (1990), Preshaping command inputs to reduce system vibration, Journal of Dynamic
Systems, Measurement, and Control 112, 76-82: ZV and ZVD, equations (9) to (13).
W. Singhose, W. Seering, N. Singer (1994), Residual vibration reduction using vector diagrams to generate shaped
inputs, Journal of Mechanical Design 116, 654-659: EI; with damping and two humps W. Singhose, L. Porter,
T. Tuttle, N. Singer (1997), Vibration reduction using multi-hump input shapers, Journal of Dynamic Systems,
Measurement, and Control 119, 320-326.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.errors import ExcitationError
from beam_ident.excitation.sampled import AxisLimits
from beam_ident.shaping.command import Move, convolved, s_curve

TOLERATED = 0.05
"""Share of the unshaped swing that an extra-insensitive shaper leaves at its own frequency."""


def _geometric(weights: tuple[float, ...], omega: float, zeta: float) -> tuple[FloatArray, FloatArray]:
    """Return impulses half a period apart whose weights fall as the swing decays between them."""
    root = math.sqrt(1.0 - zeta**2)
    decay = math.exp(-zeta * math.pi / root)
    amplitudes = np.array([weight * decay**k for k, weight in enumerate(weights)], dtype=np.float64)
    times = np.arange(len(weights), dtype=np.float64) * (math.pi / (omega * root))
    return times, np.asarray(amplitudes / np.sum(amplitudes), dtype=np.float64)


def zv(omega: float, zeta: float) -> tuple[FloatArray, FloatArray]:
    """Return times [s] and amplitudes of the zero-vibration shaper: two impulses."""
    return _geometric((1.0, 1.0), omega, zeta)


def zvd(omega: float, zeta: float) -> tuple[FloatArray, FloatArray]:
    """Return times [s] and amplitudes of the zero-vibration-and-derivative shaper: three impulses."""
    return _geometric((1.0, 2.0, 1.0), omega, zeta)


def ei(omega: float, zeta: float) -> tuple[FloatArray, FloatArray]:
    """Return times [s] and amplitudes of the extra-insensitive shaper: three impulses.

    At the mode's frequency ``TOLERATED`` is left, and nothing on either side of it. The weights are those of an
    undamped mode, in the ratios that damping asks for.
    """
    v = TOLERATED
    return _geometric((0.25 * (1.0 + v), 0.5 * (1.0 - v), 0.25 * (1.0 + v)), omega, zeta)


def two_hump_ei(omega: float, zeta: float) -> tuple[FloatArray, FloatArray]:
    """Return times [s] and amplitudes of the two-hump extra-insensitive shaper: four impulses."""
    v = TOLERATED
    x = (v**2 * (math.sqrt(1.0 - v**2) + 1.0)) ** (1.0 / 3.0)
    outer = (3.0 * x**2 + 2.0 * x + 3.0 * v**2) / (16.0 * x)
    return _geometric((outer, 0.5 - outer, 0.5 - outer, outer), omega, zeta)


SHAPERS: dict[str, Callable[[float, float], tuple[FloatArray, FloatArray]]] = {
    "ZV": zv,
    "ZVD": zvd,
    "EI": ei,
    "two-hump EI": two_hump_ei,
}
"""Every shaper by its name: called with natural frequency [rad/s] and damping ratio of one mode."""


def shaped(base: Move, shaper: str, omegas: FloatArray, zetas: FloatArray, name: str = "") -> Move:
    """Return a move behind one shaper for each of several modes, one convolved with the other.

    Parameters
    ----------
    base : Move
    shaper : str -- a name of ``SHAPERS``
    omegas, zetas : ndarray, shape (n_modes,) -- natural frequencies [rad/s] and damping ratios below 1
    name : str -- of the move; by default the shaper's

    Raises
    ------
    ExcitationError
        Modes that do not oscillate, or an unknown shaper.
    """
    if shaper not in SHAPERS:
        raise ExcitationError(f"no shaper {shaper!r}; expected one of {', '.join(SHAPERS)}")
    if not (np.all(np.isfinite(omegas)) and np.all(omegas > 0.0) and np.all(np.abs(zetas) < 1.0)):
        raise ExcitationError(
            f"a shaper for natural frequencies {omegas} rad/s and damping ratios {zetas}; expected frequencies > 0 "
            "and damping ratios below 1: leave modes out that do not oscillate"
        )
    move = base
    for omega, zeta in zip(omegas.tolist(), zetas.tolist(), strict=True):
        move = convolved(move, *SHAPERS[shaper](omega, zeta), base.name)
    return replace(move, name=name or shaper)


def smoothed(base: Move, omega: float) -> Move:
    """Return a move behind a raised cosine two periods long, which is zero at a frequency [rad/s]."""
    n = max(2, round(4.0 * math.pi / omega / base.period_s))
    window = 1.0 - np.cos(2.0 * np.pi * (np.arange(n) + 0.5) / n)
    return convolved(
        base,
        np.arange(n, dtype=np.float64) * base.period_s,
        np.asarray(window / np.sum(window)),
        "smooth filter",
    )


def notched(base: Move, omega: float, zeta: float) -> Move:
    """Return a move behind a notch at a mode: its zeros are the mode's poles, its own poles are real.

    Notes
    -----
    ``(s^2 + 2 zeta omega s + omega^2) / (s + omega)^2`` sampled with matched zeros and poles. Its answer never ends;
    what comes after it has fallen to a millionth is cut off.
    """
    period, root = base.period_s, math.sqrt(1.0 - zeta**2)
    decay = math.exp(-zeta * omega * period)
    zeros = np.array([1.0, -2.0 * decay * math.cos(omega * root * period), decay**2])
    own = math.exp(-omega * period)
    n = math.ceil(20.0 / (omega * period))
    k = np.arange(n, dtype=np.float64)
    taps = np.convolve(zeros, (k + 1.0) * own**k)[:n]
    return convolved(base, k * period, np.asarray(taps / np.sum(taps)), "notch filter")


def stretched(distance: float, limits: AxisLimits, move: Move, name: str = "unshaped, as long") -> Move:
    """Return the S-curve over a distance that takes as long as another move."""
    longest = s_curve(
        distance, limits, move.period_s, quantity=move.quantity, duration_s=move.duration_s - move.period_s
    )
    return replace(longest, name=name)
