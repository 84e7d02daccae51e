"""Whether what is averaged repeats, as the average and its variance take it to.

A fade of the excitation, or a transient that has not settled, differs from period to period.  The scatter
between periods counts it as noise, so that it does not bias a model much but makes it look far too
uncertain.  Outputs are judged by how far their first period stands from their last; inputs, which
have little noise, by whether they differ at one place of the period more than elsewhere.

A gain that changes in mid-record, or a clock that runs apart, differs from stretch to stretch even where the input
is another one each time.  Stretches are therefore also held against the response times their own input.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc as f_sf
from scipy.special import stdtrit

from beam_ident.arrays import BoolArray, ComplexArray, FloatArray
from beam_ident.numerics.convolution import running_mean

_UNSTEADY = 1e-4  # chance that noise alone changes steady periods as much
_CHANGING = 1e-3  # chance that noise alone changes a response as much
_MUCH = 2.0  # times the power that noise explains: below this deviations grow little
_BLOCKS = 16  # of a period, in each of which the input's periods are compared
_UNLIKE = 10.0  # times the power of the usual block: what noise does not differ by
_MIN_STRETCHES = 2  # stretches of which one can be told from the others
_STRETCHES = 10  # of a record that is not periodic; into the first and last its ends leak
SHARED_BY_HANN = 35.0 / 18.0
"""Over how many lines an error reaches under a Hann window: ``n sum w^4 / (sum w^2)^2``."""

_FAINT = 1.0  # times the noise's power: lines with less of the signal are not looked at
_ENOUGH_FREEDOM = 40.0  # degrees of freedom to which the noise of neighbouring lines is averaged
_HARMLESS = 1e-6  # of the signal's power, for an input; of its amplitude, for an output


def drift_of_periods(spectra: ComplexArray) -> tuple[FloatArray, BoolArray]:
    """Return how far the first period stands from the last, and whether noise fails to explain it.

    Parameters
    ----------
    spectra : complex ndarray, shape (n_outputs, n_periods, n_bins)

    Returns
    -------
    drift : ndarray, shape (n_outputs,)
        Power of the change over what the scatter of the other periods explains; of three periods, the larger of their
        two changes over the smaller one; NaN for fewer.
    is_unsteady : ndarray of bool, shape (n_outputs,)

    Notes
    -----
    Under noise alone the drift follows an F distribution.  Coloured noise has as many degrees of freedom
    as lines that carry its power, ``(sum p)^2 / sum p^2``.
    """
    n_outputs, n_periods = spectra.shape[:2]
    if n_periods < 3:
        return np.full(n_outputs, np.nan), np.zeros(n_outputs, dtype=bool)
    # A slow decay scatters the middle too: the change over the first two periods against that over the last.
    pairs = np.abs(np.stack([spectra[:, 1] - spectra[:, 0], spectra[:, -1] - spectra[:, -2]])) ** 2 / 2.0
    sizes = np.sum(pairs, axis=2)
    quieter = np.take_along_axis(pairs, np.argmin(sizes, axis=0)[None, :, None], axis=0)[0]
    ratio = np.max(sizes, axis=0) / np.maximum(np.min(sizes, axis=0), 1e-300)
    freedom = _freedom(quieter)
    drift, is_unexplained = ratio, (ratio > _MUCH) & (2.0 * f_sf(freedom, freedom, ratio) < _UNSTEADY)
    if n_periods > 3:
        change = _power(spectra[:, -1] - spectra[:, 0]) / 2.0
        middle = spectra[:, 1:-1]
        by_line = np.sum(np.abs(middle - np.mean(middle, axis=1)[:, None]) ** 2, axis=1) / (n_periods - 3)
        drift = np.asarray(change / np.maximum(np.sum(by_line, axis=1), 1e-300))
        freedom = _freedom(by_line)
        is_unexplained |= (drift > _MUCH) & (f_sf(freedom, (n_periods - 3) * freedom, drift) < _UNSTEADY)
    harmless = _HARMLESS**2 * _power(np.mean(spectra, axis=1))
    return drift, np.asarray(is_unexplained & (np.max(sizes, axis=0) > harmless))


def changing_warnings(
    name: str,
    modelled: ComplexArray,
    answers: ComplexArray,
    omegas: FloatArray,
    shared_lines: float = 1.0,
    leaks: bool = False,
) -> list[str]:
    """Return whether an output's gain or delay changes from one stretch of a record to the next.

    Parameters
    ----------
    name : str -- of the output
    modelled, answers : complex ndarray, shape (n_stretches, n_lines)
        Spectra of what the common response makes of the input, and of the output.
    omegas : ndarray, shape (n_lines,) -- [rad/s]
    shared_lines : float -- over how many lines an error reaches
    leaks : bool
        Whether lines hold more than smooth noise beside the common response: what leaks, what passes the structure.

    Notes
    -----
    Over all lines each stretch gives one factor of the common response and one delay. What the stretches leave beside
    the response is their noise. The gain is tested for a step at every stretch, the delay for a step and a slope, at
    the level of ``_CHANGING`` for all of them together.
    """
    n = len(modelled)
    if n < _MIN_STRETCHES or not modelled.shape[1]:
        return []
    power = np.abs(modelled) ** 2
    both = np.conj(modelled) * answers
    width = min(math.ceil(_ENOUGH_FREEDOM / (n - 1)), modelled.shape[1])
    floor = _HARMLESS**2 * float(np.max(power))
    weights = np.ones(modelled.shape[1])
    left = answers - modelled
    for _ in range(2):  # the noise is what is left beside the changes as well
        noise = running_mean(np.sum(np.abs(left) ** 2, axis=0), width) / (n - 1)
        weights = 1.0 / shared_lines / np.maximum(noise, floor)
        weights *= np.sum(power, axis=0) > _FAINT * noise
        gains = _Factors.of(both.real, power, weights)
        delays = _Factors.of(-omegas * both.imag, omegas**2 * power, weights)
        left = answers - modelled * (gains.values[:, None] - 1j * omegas * delays.values[:, None])
    shares = weights * np.sum(power, axis=0)
    n_lines = float(np.sum(shares)) ** 2 / max(float(shares @ shares), 1e-300)
    # A response of leaking lines errs most at a resonance, where few of them speak; noise is told by all around.
    n_known = n_lines if leaks else max(n_lines, width)
    freedom = max(n_known / shared_lines, 1.0) * (n - 1.0)
    limit = float(stdtrit(freedom, 1.0 - 0.5 * _CHANGING / (3.0 * n)))
    (place, size), (late_place, late_size), (slope, steepness) = gains.step(), delays.step(), delays.slope()
    highest = max(size, late_size, steepness)
    if highest <= limit:
        return []
    if highest == size:
        before, after = gains.mean(slice(0, place)), gains.mean(slice(place, n))
        found = f"its gain changes by a factor of {after / before:.4g} after {place} of {n} stretches"
    elif highest == late_size:
        change = delays.mean(slice(late_place, n)) - delays.mean(slice(0, late_place))
        found = f"its delay changes by {change * 1e3:.3g} ms after {late_place} of {n} stretches"
    else:
        found = (
            f"its delay drifts by {slope * (n - 1) * 1e3:.3g} ms from the first of {n} stretches to the last"
        )
    return [
        f"output {name!r}: the response changes in mid-record: {found} ({highest:.0f} standard deviations), and what "
        "is given is a mean. A sensor that came loose, a clock that runs at another rate or was set, or motion from "
        "before the record does this. identify() finds which, and allows for the last two"
    ]


def stretches(values: FloatArray) -> ComplexArray:
    """Return the spectra of a signal's stretches under Hann windows, without the stretches at its ends.

    Parameters
    ----------
    values : ndarray, shape (n,) -- at regular stamps

    Returns
    -------
    complex ndarray, shape (n_stretches, n_lines) -- from the second line on: into the first the mean leaks
    """
    length = len(values) // _STRETCHES
    rows = values[: length * _STRETCHES].reshape(_STRETCHES, length)[1:-1]
    rows = (rows - np.mean(rows, axis=1)[:, None]) * np.hanning(length + 1)[:length]
    return np.asarray(np.fft.rfft(rows, axis=1)[:, 2 : (length + 1) // 2])


def stretch_omegas(n: int, period: float) -> FloatArray:
    """Return where the lines of ``stretches`` of ``n`` samples lie [rad/s]; ``period`` of the samples [s]."""
    length = n // _STRETCHES
    return np.asarray(2.0 * np.pi * np.arange(2, (length + 1) // 2) / (length * period), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class _Factors:
    """One number for every stretch, and what it weighs: the inverse of its variance."""

    values: FloatArray
    weights: FloatArray

    @staticmethod
    def of(products: FloatArray, powers: FloatArray, weights: FloatArray) -> _Factors:
        """Return the weighted mean of products over powers, along the lines."""
        total = np.maximum(powers @ weights, 1e-300)
        # E |error|^2 of a line is 1 / weights, half of it in the direction that counts.
        return _Factors(np.asarray((products @ weights) / total), np.asarray(2.0 * total))

    def mean(self, part: slice) -> float:
        return float(np.average(self.values[part], weights=self.weights[part]))

    def step(self) -> tuple[int, float]:
        """Return before which stretch the mean changes most, and by how many standard deviations."""
        best = (0, 0.0)
        for place in range(1, len(self.values)):
            before, after = slice(0, place), slice(place, len(self.values))
            spread = 1.0 / float(np.sum(self.weights[before])) + 1.0 / float(np.sum(self.weights[after]))
            size = abs(self.mean(after) - self.mean(before)) / math.sqrt(spread)
            best = max(best, (place, size), key=lambda own: own[1])
        return best

    def slope(self) -> tuple[float, float]:
        """Return the slope from stretch to stretch, and how many standard deviations it is."""
        late = np.arange(len(self.values)) - float(
            np.average(np.arange(len(self.values)), weights=self.weights)
        )
        information = float(self.weights @ late**2)
        slope = float(self.weights @ (late * self.values)) / max(information, 1e-300)
        return slope, abs(slope) * math.sqrt(information)


def _power(spectra: ComplexArray) -> FloatArray:
    return np.asarray(np.sum(np.abs(spectra) ** 2, axis=1))


def _freedom(by_line: FloatArray) -> FloatArray:
    """Return the degrees of freedom of the sum over lines, shape (n_outputs,)."""
    total = np.sum(by_line, axis=1)
    return np.asarray(2.0 * total**2 / np.maximum(np.sum(by_line**2, axis=1), 1e-300))


def input_changes(ticks: FloatArray) -> bool:
    """Return whether an input's periods differ at one place, as in a fade; noise differs everywhere.

    Parameters
    ----------
    ticks : ndarray, shape (n_periods, n) -- the input, period by period
    """
    own = ticks - np.mean(ticks, axis=1)[:, None]
    usual = np.median(own, axis=0) if len(own) > 2 else np.mean(own, axis=0)
    blocks = np.array_split((own - usual) ** 2, min(_BLOCKS, own.shape[1]), axis=1)
    powers = np.array([np.mean(block, axis=1) for block in blocks])
    floor = max(_UNLIKE * float(np.median(powers)), _HARMLESS * float(np.mean(own**2)))
    return bool(np.max(powers) > floor)


def unsteady_warnings(name: str, has_input_changed: bool, drifts: FloatArray) -> tuple[str, ...]:
    """Return what fits to the mean of periods must pass on, or nothing.

    Parameters
    ----------
    name : str -- of the record
    has_input_changed : bool
    drifts : ndarray -- of the outputs that are not steady
    """
    if not has_input_changed and not len(drifts):
        return ()
    found = "the input is not the same in every period" if has_input_changed else "the periods still change"
    if len(drifts):
        found += f" (drift {np.max(drifts):.3g}; about 1 where they are steady)"
    return (
        f"record {name!r}: {found}, which is counted as noise, so that deviations are too large. Leave out the "
        "fades of the excitation and the time that the structure takes to settle, by start_s and end_s",
    )
