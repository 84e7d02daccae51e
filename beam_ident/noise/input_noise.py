"""What noise on a measured input does, and what can be done about it.

White noise of standard deviation sigma on the samples of an input of period T passes
through the model like the input itself: it adds ``2 sigma^2 T int |H|^2 df`` over the
sampled band to the variance of an output.  Where that is no longer small against
the output's own noise, residuals may still look white while the intervals are wrong;
and noise far above the excited band, differentiated twice, drowns the columns of the
static terms and biases what is estimated beside them.  A linear-phase low-pass at the
end of the excited band takes away the second evil; the first is weighed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.gaps import POOR_BRIDGE
from beam_ident.data.records import InputSignal
from beam_ident.numerics.convolution import inner_convolution
from beam_ident.numerics.trapezoid_rule import trapezoid_rule

_PASS, _STOP = 1.08, 1.4  # edges of the low-pass, in multiples of the excited band's end
# The ripple in the pass band is an error of the input, and must stay below the gains' 1e-5.
_ATTENUATION_DB = 120.0


@dataclass(frozen=True)
class Smoothing:
    """A low-pass without delay for a noisy input.

    Parameters
    ----------
    high_hz : float -- end of the excited band; what lies above 1.4 times it is removed
    """

    high_hz: float

    def cutoff_hz(self, period_s: float) -> float:
        """Return where the noise of an input of this period ends."""
        return min(0.5 * (_PASS + _STOP) * self.high_hz, 0.5 / period_s)

    def of(self, drive: InputSignal) -> InputSignal:
        """Return the input without its noise above the band; an irregular or slow one as it is."""
        period = drive.period_s
        if period is None or _STOP * self.high_hz * period >= 0.5:
            return drive
        nyquist = 0.5 / period
        taps = _low_pass(
            0.5 * (_PASS + _STOP) * self.high_hz / nyquist, (_STOP - _PASS) * self.high_hz / nyquist
        )
        # A symmetric filter of odd length delays by half of it, which the padding takes back: no phase is
        # added.
        smooth = drive.values.copy()
        for piece in _trusted_pieces(drive):
            smooth[piece] = _filtered(drive.values[piece], taps, piece.start == 0, piece.stop == len(smooth))
        return replace(drive, values=smooth)


def _low_pass(cutoff: float, width: float) -> FloatArray:
    """Return the taps of a symmetric low-pass of odd length, of one at zero, by Kaiser's window.

    Parameters
    ----------
    cutoff, width : float -- middle and width of the transition, in shares of half the rate

    Notes
    -----
    Length and shape of the window: Oppenheim and Schafer, Discrete-Time Signal Processing (2010), (7.75) and (7.76),
    of an attenuation above 50 dB.
    """
    n_taps = math.ceil((_ATTENUATION_DB - 7.95) / (2.285 * np.pi * width) + 1.0) | 1
    places = np.arange(n_taps) - n_taps // 2
    taps = np.sinc(cutoff * places) * np.kaiser(n_taps, 0.1102 * (_ATTENUATION_DB - 8.7))
    return np.asarray(taps / np.sum(taps))


def _trusted_pieces(drive: InputSignal) -> list[slice]:
    """Return the samples between gaps whose bridges are poor: a filter would carry their errors out of the gaps."""
    least = POOR_BRIDGE * float(np.std(drive.values))
    ends = [0, len(drive.values)]
    for gap in drive.gaps:
        if not gap.sigma < least:
            first, last = np.searchsorted(drive.times_s, [gap.start_s, gap.end_s])
            ends[-1:] = [int(first) + 1, int(last), len(drive.values)]
    return [slice(*pair) for pair in zip(ends[::2], ends[1::2], strict=True) if pair[1] > pair[0]]


def _filtered(values: FloatArray, taps: FloatArray, is_first: bool, is_last: bool) -> FloatArray:
    """Return a piece behind a filter: at rest before and after all of them, mirrored about its ends elsewhere."""
    half = len(taps) // 2
    edge = min(max(half // 4, 1), len(values))
    # Mirrored about its last sample, a motion goes on with its speed.
    mirrored = np.pad(values, half, "reflect", reflect_type="odd")
    before = np.full(half, np.mean(values[:edge])) if is_first else mirrored[:half]
    after = np.full(half, np.mean(values[-edge:])) if is_last else mirrored[len(mirrored) - half :]
    return inner_convolution(np.concatenate([before, values, after]), taps)


def input_noise_share(
    response: ComplexArray, omegas: FloatArray, drive: InputSignal, noise_sd: FloatArray
) -> FloatArray:
    """Return the share of every output's noise variance that the input's noise makes up, shape (n_outputs,).

    Parameters
    ----------
    response : ndarray, shape (n_frequencies, n_outputs) -- from the input to the outputs
    omegas : ndarray, shape (n_frequencies,) -- up to half the input's rate [rad/s]
    drive : InputSignal -- with its ``sigma``
    noise_sd : ndarray, shape (n_outputs,) -- of the residuals
    """
    period = float(np.median(np.diff(drive.times_s)))
    density = np.abs(response) ** 2
    # 2 sigma^2 T is the one-sided density of white samples.
    passed = 2.0 * period * drive.sigma**2 * trapezoid_rule(density, omegas / (2.0 * np.pi))
    return np.asarray(passed / np.maximum(passed + noise_sd**2, 1e-300))


def noise_grid(
    frequencies_hz: FloatArray,
    damping_ratios: FloatArray,
    drive: InputSignal,
    smoothing: Smoothing | None = None,
) -> FloatArray:
    """Return frequencies [rad/s] up to half the input's rate, or the end of a low-pass, dense at the resonances."""
    period = float(np.median(np.diff(drive.times_s)))
    nyquist = 0.5 / period if smoothing is None else smoothing.cutoff_hz(period)
    coarse = np.linspace(0.0, nyquist, 400)[1:]
    near = [
        # Points in units of the half-power width, closest at the peak: |H|^2 is integrated there.
        frequency * (1.0 + max(zeta, 1e-4) * np.sinh(np.linspace(-6.0, 6.0, 161)))
        for frequency, zeta in zip(frequencies_hz, damping_ratios, strict=True)
    ]
    grid = np.unique(np.concatenate([coarse, *near]))
    return np.asarray(2.0 * np.pi * grid[(grid > coarse[0] * 0.01) & (grid <= nyquist)])
