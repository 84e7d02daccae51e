"""The input shaper that printers' firmware would choose from a record: a peer for the moves of ``beam shape``.

Klipper's automatic calibration (``SHAPER_CALIBRATE``, https://www.klipper3d.org/Measuring_Resonances.html), which
Shake&Tune (https://github.com/Frix-x/klippain-shaketune) calls with a damping ratio of its own, in four steps:

1. the power spectral density of the acceleration in a sweep, over frequency;
2. for every shaper and frequency the share of vibrations that would remain, at assumed damping ratios;
3. of each shaper the frequency with the smallest score, among those that leave little more than the least;
4. of the shapers the one whose score is clearly the smallest.

It is written for printers, between 5 and 200 Hz. A beam is slower, so that time runs faster for it here by a factor:
all of the method but that has no unit of its own, lengths apart.

Three of its shapers are the library's. ZV's relative for printers and the three-hump shaper are written here, the
last by W. Singhose, L. Porter, T. Tuttle, N. Singer (1997), Vibration reduction using multi-hump input shapers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import get_window, welch

from beam_ident.shaping.shapers import TOLERATED, ei, two_hump_ei, zv

Impulses = tuple[np.ndarray, np.ndarray]

ASSUMED_DAMPING = 0.1
"""What Klipper takes for the shaper where nobody measured a damping ratio."""
TEST_DAMPING = (0.075, 0.1, 0.15)
"""Remaining vibrations are the largest over beams with these damping ratios."""
BAND_HZ = (5.0, 200.0)
LARGEST_SHAPER_HZ = 150.0
STEP_HZ = 0.2
WINDOW_S, WINDOW_BETA = 0.5, 6.0
VISIBLE = 1.0 / 20.0
"""Vibrations below this share of the largest spectral density do not count."""
ACCELERATION, CORNER_SPEED = 5.0, 5e-3
"""Of the print whose smoothing is scored [m/s^2, m/s]."""


def mzv(omega: float, zeta: float) -> Impulses:
    """Return times [s] and amplitudes of Klipper's modified ZV: three impulses, 3/8 of a period apart."""
    side = 1.0 - math.sqrt(0.5)
    return _spaced((side, 1.0 - 2.0 * side, side), 0.375, omega, zeta)


def three_hump_ei(omega: float, zeta: float) -> Impulses:
    """Return times [s] and amplitudes of the three-hump extra-insensitive shaper: five impulses."""
    v = TOLERATED
    outer = (1.0 + 3.0 * v + 2.0 * math.sqrt(2.0 * v * (1.0 + v))) / 16.0
    inner = 0.25 * (1.0 - v)
    return _spaced((outer, inner, 1.0 - 2.0 * (outer + inner), inner, outer), 0.5, omega, zeta)


def _spaced(weights: tuple[float, ...], periods: float, omega: float, zeta: float) -> Impulses:
    """Return impulses a share of a period apart, weighted down as the swing decays between them."""
    times = np.arange(len(weights)) * periods * 2.0 * math.pi / (omega * math.sqrt(1.0 - zeta**2))
    amplitudes = np.array(weights) * np.exp(-zeta * omega * times)
    return times, amplitudes / np.sum(amplitudes)


@dataclass(frozen=True)
class PrinterShaper:
    """A shaper and the lowest frequency at which the calibration tries it."""

    impulses: Callable[[float, float], Impulses]
    lowest_hz: float


SHAPERS = {
    "zv": PrinterShaper(zv, 21.0),
    "mzv": PrinterShaper(mzv, 23.0),
    "ei": PrinterShaper(ei, 29.0),
    "2hump_ei": PrinterShaper(two_hump_ei, 39.0),
    "3hump_ei": PrinterShaper(three_hump_ei, 48.0),
}


@dataclass(frozen=True)
class Fitted:
    """What the calibration says of a shaper.

    Attributes
    ----------
    name : str
    frequency_hz, damping_ratio : float -- of the shaper
    vibrations : float -- share that remains
    smoothing : float -- [m], at the printer's speed of time
    """

    name: str
    frequency_hz: float
    damping_ratio: float
    vibrations: float
    smoothing: float

    @property
    def score(self) -> float:
        """Smoothing, weighed against vibrations."""
        return self.smoothing * (self.vibrations**1.5 + 0.2 * self.vibrations + 0.01)

    @property
    def impulses(self) -> Impulses:
        """Times [s] and amplitudes."""
        return SHAPERS[self.name].impulses(2.0 * math.pi * self.frequency_hz, self.damping_ratio)


@dataclass(frozen=True)
class Spectrum:
    """Power spectral density of the acceleration in a sweep whose amplitude grows with frequency."""

    frequencies_hz: np.ndarray
    density: np.ndarray


def spectrum_of(places: np.ndarray, rate_hz: float, faster: float) -> Spectrum:
    """Return the spectrum that the calibration would be given, at the printer's speed of time.

    Parameters
    ----------
    places : ndarray, shape (n,)
        Of the end that vibrates, in a sweep of constant acceleration whose frequency grows by a share a second [m].
    rate_hz : float
    faster : float -- by which time runs faster for the method

    Notes
    -----
    The camera sees displacements: their density times f^4 is that of the acceleration, up to a constant that does not
    count. A printer is swept by so many hertz a second, with an acceleration that grows with frequency: a density as
    f^2, where this sweep has one as 1/f. That makes f^3 more. The method then divides by f, and fades out what lies
    below twice its lowest frequency.
    """
    rate = rate_hz * faster
    length = 1 << math.ceil(math.log2(WINDOW_S * rate))
    frequencies, density = welch(
        places, rate, window=get_window(("kaiser", WINDOW_BETA), length), nperseg=length, detrend="constant"
    )
    density = density * frequencies**6
    low = 2.0 * BAND_HZ[0]
    faded = (frequencies < low) & (frequencies > 0.0)
    density[faded] *= np.exp(1.0 - (low / frequencies[faded]) ** 2)
    seen = (frequencies >= BAND_HZ[0]) & (frequencies <= min(BAND_HZ[1], 0.5 * rate))
    return Spectrum(frequencies[seen], density[seen])


def half_power_damping(spectrum: Spectrum) -> float:
    """Return the damping ratio of the highest peak by its width at half its power, as Shake&Tune measures it."""
    peak = int(np.argmax(spectrum.density))
    half = 0.5 * spectrum.density[peak]
    below = np.flatnonzero(spectrum.density[:peak] < half)
    above = np.flatnonzero(spectrum.density[peak:] < half)
    if not (len(below) and len(above)):
        return ASSUMED_DAMPING

    def crossing(inside: int, outside: int) -> float:
        ends = spectrum.density[[outside, inside]]
        return float(np.interp(half, ends, spectrum.frequencies_hz[[outside, inside]]))

    low = crossing(below[-1] + 1, below[-1])
    high = crossing(peak + above[0] - 1, peak + above[0])
    return 0.5 * (high - low) / float(spectrum.frequencies_hz[peak])


def left_by(impulses: Impulses, frequencies_hz: np.ndarray, zeta: float) -> np.ndarray:
    """Return the share of the swing that impulses leave in modes of these frequencies and one damping ratio."""
    times, amplitudes = impulses
    omega = 2.0 * math.pi * frequencies_hz[:, None]
    poles = omega * (-zeta + 1j * math.sqrt(1.0 - zeta**2))
    return np.abs(np.exp(poles * (times[-1] - times)) @ amplitudes) / np.sum(amplitudes)


def _remaining(spectrum: Spectrum, impulses: Impulses) -> float:
    """Return the share of visible vibrations that remains behind a shaper."""
    threshold = VISIBLE * float(np.max(spectrum.density))

    def visible(density: np.ndarray) -> float:
        return float(np.sum(np.maximum(density - threshold, 0.0)))

    left = [left_by(impulses, spectrum.frequencies_hz, zeta) for zeta in TEST_DAMPING]
    return max(visible(own * spectrum.density) for own in left) / visible(spectrum.density)


def _smoothing(impulses: Impulses) -> float:
    """Return how far a shaped corner of 90 or 180 degrees misses the one that was drawn [m]."""
    times, amplitudes = impulses
    late = times - float(times @ amplitudes)
    quarter = (CORNER_SPEED + 0.5 * ACCELERATION * late) * late * (late >= 0.0)
    turn = 0.5 * ACCELERATION * late**2
    return max(math.sqrt(2.0) * float(amplitudes @ quarter), float(amplitudes @ turn))


def fitted(spectrum: Spectrum, name: str, damping_ratio: float) -> Fitted:
    """Return a shaper at the frequency that the calibration gives it."""
    shaper = SHAPERS[name]
    tried = []
    for frequency in np.arange(shaper.lowest_hz, LARGEST_SHAPER_HZ, STEP_HZ).tolist():
        impulses = shaper.impulses(2.0 * math.pi * frequency, damping_ratio)
        tried.append(
            Fitted(name, frequency, damping_ratio, _remaining(spectrum, impulses), _smoothing(impulses))
        )
    least = min(own.vibrations for own in tried)
    return min((own for own in tried if own.vibrations <= 1.1 * least), key=lambda own: own.score)


def published_choice(spectrum: Spectrum, damping_ratio: float) -> Fitted:
    """Return the shaper that the calibration recommends."""
    best: Fitted | None = None
    for name in SHAPERS:
        own = fitted(spectrum, name, damping_ratio)
        is_smoother = best is not None and 1.1 * own.smoothing < best.smoothing
        if best is None or 1.2 * own.score < best.score or (1.05 * own.score < best.score and is_smoother):
            best = own
    assert best is not None
    return best
